"""docs/policies.md and the tables of other documents say what the rows in results/ say."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
def test_the_page_of_policies_is_what_its_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    written = runpy.run_path(str(DOCS / "policies.py"))["document"]()
    assert (DOCS / "policies.md").read_text("utf-8") == written, "run: python docs/policies.py"


@pytest.mark.slow
def test_tables_are_what_their_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    for path, written in runpy.run_path(str(DOCS / "tables.py"))["documents"]().items():
        assert path.read_text("utf-8") == written, "run: python docs/tables.py"
