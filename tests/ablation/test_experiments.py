"""conf/experiment: every file composes, selects what its table needs, and yields to the command line."""

from dataclasses import asdict
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.ablation import paper
from rf_exp.command import CONF, register_all_tasks
from rf_exp.policy.config import ACTING
from tests.conftest import experiment

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
ROWS = set(paper().ablation_success)


def composed(*overrides: str) -> dict[str, Any]:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base=None):
        node = compose("config", list(overrides), return_hydra_config=True)
    values: Any = OmegaConf.to_container(node)  # unresolved: some values name what only a run knows
    return values


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiment_composes_and_yields_to_the_command_line(experiment: str) -> None:
    values = composed(
        f"experiment={experiment}", "profile=quick", "task=place_food", "seed=7", "stages=[report]"
    )
    assert list(values["task"]) == ["place_food"]
    assert (values["seed"], values["stages"]) == (7, ["report"])
    assert values["scenes"] == 20  # of the quick profile


def test_architectures() -> None:
    values = composed("experiment=architectures")
    assert set(values["arch"]) == set(paper().architectures)
    assert set(values["task"]) > set(paper().architectures["shared_global"])
    assert (values["demos"], values["scenes"]) == (150, 100)


@pytest.mark.slow
def test_ablation_draws_nothing_and_counts_seeds() -> None:
    values = composed("experiment=ablation")
    assert set(values["constraints"]) == ROWS
    assert values["stages"] == ["generate", "report"]
    assert not values["render"]
    assert values["episodes"] >= 100
    assert values["out"] != composed()["out"]  # scenes with heavy things never mix with the usual ones
    assert values["randomisation"]["mass_scale"] > 0


@pytest.mark.slow
def test_every_rung_of_the_ladder_differs_from_fast_and_says_so() -> None:
    """In what is learned, and then not in name alone; or in how the same policies act."""
    swept = composed("experiment=ladder")["hydra"]["sweeper"]["params"]["policy"].split(",")
    fast, *rungs = (experiment(f"recipe={name}", f"policy={name}") for name in map(str.strip, swept))
    for rung in rungs:
        differs = {key for key, value in asdict(rung.policy).items() if value != getattr(fast.policy, key)}
        learned = bool(differs - {*ACTING}) or rung.training != fast.training or rung.name != "fast"
        assert differs or learned
        assert rung.learned_as == (rung.recipe if learned else "fast")


def test_benchmark_sweeps_over_the_paper_s_demonstrations() -> None:
    values = composed("experiment=benchmark")
    assert set(values["task"]) == {path.stem for path in (CONF / "task").glob("*.yaml")} - {"all"}
    assert list(values["arch"]) == ["separate_local"]
    swept = [int(count) for count in values["hydra"]["sweeper"]["params"]["demos"].split(",")]
    assert swept == list(paper().demos)
