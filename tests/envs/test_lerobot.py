"""The LeRobot interface: its keys for our episodes, and the plug-in, tested with LeRobot if installed."""

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
ObservationDict = dict[str, Any]


@pytest.fixture(scope="module")
def expert_episode() -> Episode:
    """The expert's episode in the scene of the seed."""
    settings = Settings.configured(read_task("lift_barrier"), ConstraintSet("full"), ScriptedSpec())
    episode = make_episode(settings, NO_PICTURES, SEED).episode
    assert episode is not None
    return episode


def without_pictures(**options: Any) -> LeRobotEnv:
    return LeRobotEnv("lift_barrier", Observations("full"), render_mode=None, **options)


@pytest.mark.slow
def test_observations_and_actions_have_the_layout_of_an_export(expert_episode: Episode) -> None:
    """For policies trained with LeRobot on an export: agents are concatenated, as in `observation.state`."""
    env = without_pictures()
    observed, info = env.reset(seed=SEED, options={"lerobot_new_rollout": True})
    assert info["seed"] == SEED and info["is_success"] is False
    for row, command in enumerate(expert_episode.commanded):
        np.testing.assert_array_equal(observed["agent_pos"], expert_episode.qpos[row].ravel())
        pose = expert_episode.poses["barrier"][row]
        np.testing.assert_allclose(observed["environment_state"], pose, atol=1e-6)
        assert observed in env.observation_space
        observed, reward, terminated, _, info = env.step(command.ravel())
    assert terminated and reward == 1 and info["is_success"] is True
    env.close()


@pytest.mark.slow
def test_vectorised_environments_report_success_in_final_info(expert_episode: Episode) -> None:
    """One environment receives the commands of the expert, the other is truncated earlier."""
    factories = [without_pictures, partial(without_pictures, step_limit=9)]
    vector = SyncVectorEnv(factories, autoreset_mode=AutoresetMode.SAME_STEP)
    limits: Any = vector.call("_max_episode_steps")
    assert limits == (read_task("lift_barrier").step_limit, 9)
    assert vector.call("task_description") == (read_task("lift_barrier").description,) * 2
    assert vector.metadata["render_fps"] == 20
    vector.reset(seed=[SEED, SEED])
    successes: list[list[bool]] = []
    for command in expert_episode.commanded:
        *_, info = vector.step(np.tile(command.ravel(), (2, 1)))
        if "final_info" in info:
            successes.append(info["final_info"]["is_success"].tolist())
    assert successes[0] == [False, False] and successes[-1] == [True, False]
    vector.close()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
def test_the_checker_of_gymnasium_passes() -> None:
    env = gymnasium.make(LEROBOT_ID, task="pick_meat", observations=Observations("full"), render_mode=None)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.render
@pytest.mark.slow
def test_pictures_are_named_after_cameras() -> None:
    observations = Observations("joints", pictures=True, cameras="local", width=32, height=24)
    env = LeRobotEnv("lift_barrier", observations)
    observed, _ = env.reset(seed=SEED)
    assert observed in env.observation_space and observed.keys() == {"agent_pos", "pixels"}
    assert {name: each.shape for name, each in observed["pixels"].items()} == {
        "agent1": (24, 32, 3),
        "agent2": (24, 32, 3),
    }
    assert env.render().shape == (24, 32, 3)
    env.close()


def test_spaces_are_known_without_a_simulator() -> None:
    observed, action_space = lerobot_spaces("take_photo", Observations("full", pictures=True))
    assert action_space.shape == (32,) and observed["agent_pos"].shape == (36,)
    pixels: Any = observed["pixels"]
    assert {*pixels} == {"global", "agent1", "agent2", "agent3", "agent4"}
    assert observed["environment_state"].shape == (7 * len(read_task("take_photo").objects),)
    pictures_only, _ = lerobot_spaces("pick_meat", Observations("none", pictures=True))
    assert [*pictures_only] == ["pixels"]


@pytest.mark.parametrize("kind", ["depth", "segmentation", "calibration", "language"])
def test_observations_without_a_lerobot_key_are_refused(kind: str) -> None:
    unsupported: dict[str, Any] = {kind: True}
    with pytest.raises(ArgumentError, match="expected observations without depth"):
        lerobot_spaces("pick_meat", Observations("full", pictures=True, **unsupported))


def test_an_action_of_another_shape_is_refused() -> None:
    env = without_pictures()
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=r"shape \(2, 8\); expected finite numbers of shape \(16,\)"):
        env.step(np.zeros((2, 8)))
    env.close()


# The plug-in


def test_lerobot_finds_the_distribution_by_its_name() -> None:
    """LeRobot imports installed distributions with this prefix, as modules of the same name."""
    metadata = tomllib.loads((PLUGIN / "pyproject.toml").read_text("utf-8"))
    name = metadata["project"]["name"]
    assert name.startswith("lerobot_env_") and metadata["tool"]["setuptools"]["py-modules"] == [name]
    assert (PLUGIN / f"{name}.py").is_file()


@pytest.fixture(scope="module")
def plugin() -> Any:
    """The module of the plug-in, which registers with LeRobot on import."""
    pytest.importorskip("lerobot.envs", reason="LeRobot 0.6 wants Python 3.12")
    name = "lerobot_env_rf_exp"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, PLUGIN / f"{name}.py")
        assert spec is not None and spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


def test_features_of_the_plugin_match_the_task(plugin: Any) -> None:
    from lerobot.envs.utils import env_to_policy_features  # pyright: ignore[reportMissingImports]

    config = plugin.RfExpEnv(task="place_food", state="full", cameras="local", width=32, height=24)
    assert config.type == "rf_exp"
    features = {key: each.shape for key, each in env_to_policy_features(config).items()}
    objects = len(read_task("place_food").objects)
    assert features == {
        "action": (16,),
        "observation.state": (18,),
        "observation.environment_state": (7 * objects,),
        "observation.images.agent1": (3, 24, 32),
        "observation.images.agent2": (3, 24, 32),
    }


@pytest.mark.slow
def test_the_expert_succeeds_in_lerobot_as_in_the_suite(plugin: Any, expert_episode: Episode) -> None:
    import torch
    from lerobot.envs.factory import make_env  # pyright: ignore[reportMissingImports]
    from lerobot.scripts.lerobot_eval import rollout  # pyright: ignore[reportMissingImports]

    class ReplayPolicy(torch.nn.Module):
        def __init__(self, commands: NDArray[np.float32]) -> None:
            super().__init__()
            self._commands, self._row, self.observations = commands, 0, list[ObservationDict]()

        def reset(self) -> None:
            self._row = 0

        def select_action(self, observation: ObservationDict) -> torch.Tensor:
            self.observations.append(observation)
            self._row += 1
            return torch.from_numpy(self._commands[self._row - 1].reshape(1, -1))

    identity: Callable[[Any], Any] = lambda value: value  # noqa: E731
    config = plugin.RfExpEnv(task="lift_barrier", state="full", pictures=False)
    vector = make_env(config, n_envs=1)["rf_exp"][0]
    policy = ReplayPolicy(expert_episode.commanded.astype(np.float32))
    result = rollout(vector, policy, identity, identity, identity, identity, seeds=[SEED])  # pyright: ignore
    vector.close()
    assert result["success"].any() and result["reward"].sum() == 1
    assert result["done"].shape[1] == len(expert_episode.commanded)
    first = policy.observations[0]
    np.testing.assert_array_equal(first["observation.state"][0].numpy(), expert_episode.qpos[0].ravel())
    assert first["task"] == [read_task("lift_barrier").description]
