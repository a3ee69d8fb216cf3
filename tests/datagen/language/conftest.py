"""Fixtures: language model server and real simulator."""

import pytest

from rf_exp.sim import Simulator
from tests.conftest import read_task
from tests.datagen.language.asking import KEY
from tests.datagen.language_server import LanguageServer


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("TEST_KEY", KEY)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with LanguageServer() as running:
        yield running


@pytest.fixture(scope="package")
def lift_sim():
    with Simulator(read_task("lift_barrier"), render=False) as world:
        yield world
