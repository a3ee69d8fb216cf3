"""Path of the recordings of these tests."""

from pathlib import Path

import pytest


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "recordings" / "lift_barrier" / "full" / "generate-7.rrd"
