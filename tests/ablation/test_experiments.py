"""conf/experiment: every file composes, selects what its table needs, and yields to the command line."""

from dataclasses import replace
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import create_config_search_path
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from rf_exp.ablation import paper
from rf_exp.command import CONF, register_all_tasks
from rf_exp.policy.config import KeypointsConfig
from tests.conftest import experiment

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
ROWS = set(paper().ablation_success)


def composed(*overrides: str) -> dict[str, Any]:
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base=None):
        node = compose("config", list(overrides), return_hydra_config=True)
    values: Any = OmegaConf.to_container(node)  # unresolved: some values exist only in a run
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
def test_ablation_renders_nothing_and_counts_seeds() -> None:
    values = composed("experiment=ablation")
    assert set(values["constraints"]) == ROWS
    assert values["stages"] == ["generate", "report"]
    assert not values["render"]
    assert values["episodes"] >= 100
    assert values["out"] != composed()["out"]  # scenes with heavy objects never mix with the usual ones
    assert values["randomisation"]["mass_scale"] > 0


@pytest.mark.slow
def test_every_recipe_of_the_ablation_differs_from_fast_and_says_so() -> None:
    """Either in training, and then not in name alone, or in how the same policies act."""
    swept = composed("experiment=policy_ablation")["hydra"]["sweeper"]["params"]["policy"].split(",")
    chosen = [choice.strip() for choice in swept]
    of_fast = {
        f"ablation/{path.stem}"
        for path in (CONF / "policy" / "ablation").iterdir()
        if "defaults: [/policy/fast," in path.read_text()
    }
    assert {*chosen[1:]} == of_fast
    fast, *others = (experiment(f"recipe={each.rpartition('/')[2]}", f"policy={each}") for each in chosen)
    for other in others:
        differs = other.policy != fast.policy
        learned = other.policy.training_values != fast.policy.training_values
        learned = learned or other.training != fast.training or other.name != "fast"
        assert differs or learned
        assert other.learned_as == (other.recipe if learned else "fast")


def test_each_ablation_of_robust_is_without_one_of_its_steps() -> None:
    robust = experiment("recipe=robust", "policy=robust")
    unrefined = experiment("policy=ablation/without_crop_refinement")
    no_homing = experiment("recipe=without_homing", "policy=ablation/without_homing")
    no_search = experiment("recipe=without_search", "policy=ablation/without_search")
    searchless = replace(robust.policy.acting, regrasp_step_m=0.0)
    assert robust.policy.acting != searchless and no_search.policy == replace(
        robust.policy, acting=searchless
    )
    assert (no_search.name, no_search.learned_as, no_search.pictures) == ("robust", "robust", robust.pictures)
    acting = replace(searchless, homing=False)
    assert robust.policy.acting != acting and no_homing.policy == replace(robust.policy, acting=acting)
    assert (no_homing.name, no_homing.learned_as, no_homing.pictures) == ("robust", "robust", robust.pictures)
    assert unrefined.policy.acting == acting
    without_offset, fast = experiment("policy=ablation/without_start_offset"), experiment("policy=fast")
    assert unrefined.policy != without_offset.policy == replace(unrefined.policy, start_offset_rad=0.0)
    assert (unrefined.training, unrefined.name) == (without_offset.training, without_offset.name)
    ours, theirs, of_fast = (each.policy.encoder for each in (robust, unrefined, fast))
    assert isinstance(ours, KeypointsConfig)
    picture_values = {key: getattr(of_fast, key) for key in ("downsample", "crop_refinement", "shift_px")}
    assert theirs == replace(ours, **picture_values) != ours
    assert (unrefined.pictures, unrefined.training) == (fast.pictures, robust.training)


def test_benchmark_sweeps_over_the_paper_s_demonstrations() -> None:
    values = composed("experiment=benchmark")
    assert set(values["task"]) == {path.stem for path in (CONF / "task").glob("*.yaml")} - {"all"}
    assert list(values["arch"]) == ["separate_local"]
    swept = [int(count) for count in values["hydra"]["sweeper"]["params"]["demos"].split(",")]
    assert swept == list(paper().demos)


@pytest.mark.slow
def test_robustness_sweeps_over_every_choice_of_variation_for_policies_of_both_kinds() -> None:
    values = composed("experiment=robustness")
    swept = values["hydra"]["sweeper"]["params"]
    assert list(values["task"]) == ["lift_barrier", "two_robots_stack_cube"]
    assert values["out"] == composed("experiment=benchmark")["out"]  # its policies are those of `none`
    jobs = BasicSweeper.split_arguments(
        OverridesParser.create(config_loader()).parse_overrides([f"{key}={of}" for key, of in swept.items()]),
        None,
    )[0]
    chosen = {tuple(override.partition("=")[2] for override in job) for job in jobs}
    names = {path.stem for path in (CONF / "variation").glob("*.yaml")}
    assert chosen == {(learned, acted) for learned in ("fast", "robust") for acted in names}
    learned, acted = experiment("variation=full"), experiment("variation=none", "variation@evaluated=full")
    assert (learned.method, learned.evaluated.name) == ("test+full", "full")
    assert (acted.method, acted.evaluated.name) == ("test", "full")


@pytest.mark.slow
def test_a_recipe_sets_its_variation_and_the_command_line_overrides_it() -> None:
    for overrides, expected in (((), "full"), (("variation=light",), "light")):
        values = composed("policy=robust", *overrides)
        assert (values["variation"]["name"], values["evaluated"]["name"]) == (expected, expected)
    assert composed("policy=robust", "variation@evaluated=none")["evaluated"]["name"] == "none"
    assert composed("policy=fast")["variation"]["name"] == "none"


def config_loader() -> ConfigLoaderImpl:
    """Hydra's loader, which finds the choices of each group."""
    return ConfigLoaderImpl(create_config_search_path(str(CONF)))
