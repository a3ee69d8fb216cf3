"""The face of LeRobot: its keys over our episodes, and the plug-in, with LeRobot where it is installed."""

import importlib.util
import sys
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from rf_exp.datagen import Settings, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs import LEROBOT_ID, LeRobotEnv, Observations, lerobot_spaces
from rf_exp.errors import ArgumentError
from rf_exp.types import NO_PICTURES, ConstraintSet, Episode
from tests.conftest import read_task

PLUGIN = Path(__file__).parents[2] / "plugins/lerobot_env_rf_exp"
SEED = 3
Keyed = dict[str, Any]


@pytest.fixture(scope="module")
def demonstrated() -> Episode:
    """What the expert does in the scene of the seed."""
    settings = Settings.configured(read_task("lift_barrier"), ConstraintSet("full"), ScriptedSpec())
    episode = make_episode(settings, NO_PICTURES, SEED).episode
    assert episode is not None
    return episode


def blind(**options: Any) -> LeRobotEnv:
    return LeRobotEnv("lift_barrier", Observations("full"), render_mode=None, **options)


@pytest.mark.slow
def test_an_episode_is_seen_and_commanded_as_an_export_holds_it(demonstrated: Episode) -> None:
    """So that what LeRobot learned from one fits: one agent behind the other, as in `observation.state`."""
    env = blind()
    observed, info = env.reset(seed=SEED, options={"lerobot_new_rollout": True})
    assert info["seed"] == SEED and info["is_success"] is False
    for row, command in enumerate(demonstrated.commanded):
        np.testing.assert_array_equal(observed["agent_pos"], demonstrated.qpos[row].ravel())
        pose = demonstrated.poses["barrier"][row]
        np.testing.assert_allclose(observed["environment_state"], pose, atol=1e-6)
        assert observed in env.observation_space
        observed, reward, terminated, _, info = env.step(command.ravel())
    assert terminated and reward == 1 and info["is_success"] is True
    env.close()


@pytest.mark.slow
def test_a_vector_of_environments_tells_of_success_where_lerobot_looks(demonstrated: Episode) -> None:
    """One has the commands of the expert, the other is cut off on the way."""
    makes = [blind, partial(blind, step_limit=9)]
    vector = SyncVectorEnv(makes, autoreset_mode=AutoresetMode.SAME_STEP)
    limits: Any = vector.call("_max_episode_steps")
    assert limits == (read_task("lift_barrier").step_limit, 9)
    assert vector.call("task_description") == (read_task("lift_barrier").description,) * 2
    assert vector.metadata["render_fps"] == 20
    vector.reset(seed=[SEED, SEED])
    ended: list[list[bool]] = []
    for command in demonstrated.commanded:
        *_, info = vector.step(np.tile(command.ravel(), (2, 1)))
        if "final_info" in info:
            ended.append(info["final_info"]["is_success"].tolist())
    assert ended[0] == [False, False] and ended[-1] == [True, False]
    vector.close()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
def test_gymnasium_finds_nothing_wrong() -> None:
    env = gymnasium.make(LEROBOT_ID, task="pick_meat", observations=Observations("full"), render_mode=None)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.render
@pytest.mark.slow
def test_pictures_are_told_by_the_names_of_cameras() -> None:
    seen = Observations("joints", pictures=True, cameras="local", width=32, height=24)
    env = LeRobotEnv("lift_barrier", seen)
    observed, _ = env.reset(seed=SEED)
    assert observed in env.observation_space and observed.keys() == {"agent_pos", "pixels"}
    assert {name: each.shape for name, each in observed["pixels"].items()} == {
        "agent1": (24, 32, 3),
        "agent2": (24, 32, 3),
    }
    assert env.render().shape == (24, 32, 3)
    env.close()


def test_what_is_observed_is_known_before_any_simulator() -> None:
    observed, acts = lerobot_spaces("take_photo", Observations("full", pictures=True))
    assert acts.shape == (32,) and observed["agent_pos"].shape == (36,)
    pixels: Any = observed["pixels"]
    assert {*pixels} == {"global", "agent1", "agent2", "agent3", "agent4"}
    assert observed["environment_state"].shape == (7 * len(read_task("take_photo").objects),)
    alone, _ = lerobot_spaces("pick_meat", Observations("none", pictures=True))
    assert [*alone] == ["pixels"]


@pytest.mark.parametrize("kind", ["depth", "segmentation", "calibration", "language"])
def test_what_lerobot_has_no_key_for_is_refused(kind: str) -> None:
    asked: dict[str, Any] = {kind: True}
    with pytest.raises(ArgumentError, match="expected observations without depth"):
        lerobot_spaces("pick_meat", Observations("full", pictures=True, **asked))


def test_another_action_is_refused() -> None:
    env = blind()
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"shape \(2, 8\); expected finite numbers of shape \(16,\)"):
        env.step(np.zeros((2, 8)))
    env.close()


# The plug-in


def test_lerobot_would_find_the_distribution() -> None:
    """It imports whatever is installed under a name that begins so, as a module of that name."""
    told = tomllib.loads((PLUGIN / "pyproject.toml").read_text("utf-8"))
    name = told["project"]["name"]
    assert name.startswith("lerobot_env_") and told["tool"]["setuptools"]["py-modules"] == [name]
    assert (PLUGIN / f"{name}.py").is_file()


@pytest.fixture(scope="module")
def plugin() -> Any:
    """Its module, which registers with LeRobot as it is imported."""
    pytest.importorskip("lerobot.envs", reason="LeRobot 0.6 wants Python 3.12")
    name = "lerobot_env_rf_exp"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, PLUGIN / f"{name}.py")
        assert spec is not None and spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


def test_its_features_are_those_of_the_task(plugin: Any) -> None:
    from lerobot.envs.utils import env_to_policy_features  # pyright: ignore[reportMissingImports]

    config = plugin.RfExpEnv(task="place_food", state="full", cameras="local", width=32, height=24)
    assert config.type == "rf_exp"
    found = {key: each.shape for key, each in env_to_policy_features(config).items()}
    objects = len(read_task("place_food").objects)
    assert found == {
        "action": (16,),
        "observation.state": (18,),
        "observation.environment_state": (7 * objects,),
        "observation.images.agent1": (3, 24, 32),
        "observation.images.agent2": (3, 24, 32),
    }


@pytest.mark.slow
def test_lerobot_judges_the_expert_as_the_suite_does(plugin: Any, demonstrated: Episode) -> None:
    import torch
    from lerobot.envs.factory import make_env  # pyright: ignore[reportMissingImports]
    from lerobot.scripts.lerobot_eval import rollout  # pyright: ignore[reportMissingImports]

    class Replays(torch.nn.Module):
        def __init__(self, commands: NDArray[np.float32]) -> None:
            super().__init__()
            self._commands, self._row, self.seen = commands, 0, list[Keyed]()

        def reset(self) -> None:
            self._row = 0

        def select_action(self, observation: Keyed) -> torch.Tensor:
            self.seen.append(observation)
            self._row += 1
            return torch.from_numpy(self._commands[self._row - 1].reshape(1, -1))

    same: Callable[[Any], Any] = lambda value: value  # noqa: E731
    config = plugin.RfExpEnv(task="lift_barrier", state="full", pictures=False)
    vector = make_env(config, n_envs=1)["rf_exp"][0]
    policy = Replays(demonstrated.commanded.astype(np.float32))
    found = rollout(vector, policy, same, same, same, same, seeds=[SEED])  # pyright: ignore
    vector.close()
    assert found["success"].any() and found["reward"].sum() == 1
    assert found["done"].shape[1] == len(demonstrated.commanded)
    first = policy.seen[0]
    np.testing.assert_array_equal(first["observation.state"][0].numpy(), demonstrated.qpos[0].ravel())
    assert first["task"] == [read_task("lift_barrier").description]
