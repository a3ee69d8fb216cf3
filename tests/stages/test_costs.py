"""What is told before long work begins: hours of what is missing, from measured costs."""

from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.ablation import rows
from rf_exp.command import register_all_tasks
from rf_exp.experiment import Experiment, read_experiment
from rf_exp.stages.artifacts import evaluation_path
from rf_exp.stages.costs import foretold
from tests.ablation.conftest import evaluation
from tests.conftest import CONF


def experiment(out: Path, *overrides: str) -> Experiment:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        node: Any = compose("config", ["recipe=fast", f"out={out}", *overrides])
    return read_experiment(OmegaConf.to_container(node, resolve=True))  # pyright: ignore[reportArgumentType]


def minutes(said: str) -> float:
    number, unit = said.removeprefix("about ").split()[:2]
    return float(number) * (60 if unit == "h" else 1)


def test_the_published_table_is_foretold(tmp_path: Path) -> None:
    laptop = "profile=laptop", "task=all"
    one, two = (foretold(experiment(tmp_path, *laptop, f"workers={n}")) for n in (1, 2))
    assert minutes(one) == pytest.approx(2 * minutes(two), rel=0.1)
    assert all(f"{stage} " in one for stage in ("generate", "train", "evaluate"))
    only = foretold(experiment(tmp_path, *laptop, "workers=1", "stages=[evaluate]"))
    assert "generate" not in only and minutes(only) < minutes(one)


def test_what_is_there_is_not_foretold(tmp_path: Path) -> None:
    asked = "profile=laptop", "task=two_robots_stack_cube", "workers=1"
    whole = experiment(tmp_path, *asked)
    path = evaluation_path(whole, whole.tasks[0], whole.rows[0], whole.archs[0])
    before = minutes(foretold(experiment(tmp_path, *asked, "stages=[evaluate]", "scenes=1000")))
    for row in evaluation("two_robots_stack_cube", "separate_local", 150, 100, 0, recipe="fast"):
        rows.append(path, row)
    after = minutes(foretold(experiment(tmp_path, *asked, "stages=[evaluate]", "scenes=1000")))
    assert after == pytest.approx(0.9 * before, abs=1.1)


@pytest.mark.parametrize("overrides", [("profile=paper", "recipe=paper"), ("stages=[report]",)])
def test_nothing_is_said_where_nobody_has_measured_or_nothing_is_left(
    tmp_path: Path, overrides: tuple[str, ...]
) -> None:
    assert foretold(experiment(tmp_path, *overrides)) == ""
