"""Guarantees of the environments: scenes and verdicts of the suite, equal for both interfaces."""

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.constraints import PolicyMonitor
from rf_exp.datagen import Settings, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs import Observations, ResetNeeded, environment_id, parallel_env, register
from rf_exp.envs.central import CentralEnv
from rf_exp.envs.core import EpisodeCore
from rf_exp.experiment import EVALUATION_SEED
from rf_exp.robots import DEFAULT
from rf_exp.tasks import CONFIGURED, Task
from rf_exp.types import NO_PICTURES, ConstraintSet
from tests.conftest import TASKS, experiment, read_task

ROOT = Path(__file__).parents[2]
BUTTON = ROOT / "tests/tutorial/conf/task/push_button.yaml"


def holding_action(env: CentralEnv) -> NDArray[np.float32]:
    """The action that holds the current positions."""
    qpos = env.core.episode.scene.qpos
    return np.column_stack([qpos[:, :7], np.ones(len(qpos))]).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_tasks_equal_those_of_the_command(name: str) -> None:
    task = experiment(f"task={name}").tasks[0]
    assert task == read_task(name)  # from which the environments are made
    assert gymnasium.spec(environment_id(name)).kwargs == {"task": name}


@pytest.mark.slow
def test_a_generated_episode_is_reproduced_from_its_seed_and_commands(task: Task) -> None:
    episode = make_episode(
        Settings.configured(task, ConstraintSet("full"), ScriptedSpec()), NO_PICTURES, 3
    ).episode
    assert episode is not None
    env = CentralEnv(task)
    observed, info = env.reset(seed=3)
    assert info["seed"] == 3 and not info["success"] and not all(info["conditions"].values())
    assert info["score"] == 0
    rewards, scores = [], []
    for row, command in enumerate(episode.commanded):
        np.testing.assert_array_equal(observed["qpos"], episode.qpos[row])
        np.testing.assert_array_equal(observed["qvel"], episode.qvel[row])
        for name in task.objects:
            np.testing.assert_allclose(observed[f"pose_{name}"], episode.poses[name][row], atol=1e-6)
        assert command in env.action_space
        observed, reward, terminated, truncated, info = env.step(command)
        assert observed in env.observation_space and not truncated
        rewards.append(reward)
        scores.append(info["score"])
    assert scores == sorted(scores) and max(scores[:-1]) < 1 == scores[-1]
    assert terminated and rewards == [0.0] * (len(rewards) - 1) + [1.0]
    assert info["success"] and all(info["conditions"].values()) and info["violations"] == 0
    assert set(info["measured"]) <= set(info["conditions"])
    env.close()


@pytest.mark.slow
def test_resets_without_a_seed_are_reproducible_and_avoid_evaluation_scenes() -> None:
    single, parallel = CentralEnv("pick_meat"), parallel_env("pick_meat")
    runs = []
    for _ in range(2):
        seeds = [single.reset(seed=7)[1]["seed"], *(single.reset()[1]["seed"] for _ in range(3))]
        runs.append(seeds)
        _, infos = parallel.reset(seed=7)
        runs.append([infos["agent1"]["seed"], *(parallel.reset()[1]["agent1"]["seed"] for _ in range(3))])
    assert runs == [runs[0]] * 4 and runs[0][0] == 7
    assert len(set(runs[0])) == 4 and max(runs[0]) < EVALUATION_SEED


@pytest.mark.slow
def test_both_interfaces_give_the_same_episode() -> None:
    single, parallel = CentralEnv("place_food"), parallel_env("place_food")
    observed, _ = single.reset(seed=1)
    per_agent, _ = parallel.reset(seed=1)
    rng, action = np.random.default_rng(0), holding_action(single)
    for _ in range(10):
        np.testing.assert_array_equal(per_agent["agent1"]["qpos"], observed["qpos"])
        np.testing.assert_array_equal(per_agent["agent2"]["qpos"], observed["qpos"][[1, 0]])
        for name in single.task.objects:
            np.testing.assert_array_equal(per_agent["agent2"][f"pose_{name}"], observed[f"pose_{name}"])
        action = (action + 0.05 * rng.standard_normal(action.shape)).astype(np.float32)
        observed, reward, _, _, info = single.step(action)
        per_agent, rewards, _, _, infos = parallel.step({"agent1": action[0], "agent2": action[1]})
        assert infos == {"agent1": info, "agent2": info} and set(rewards.values()) == {reward}
    state = parallel.state()
    assert state in parallel.state_space
    np.testing.assert_array_equal(state[:18], observed["qpos"].ravel())


def test_agents_may_observe_only_their_joints_while_the_state_is_complete() -> None:
    env = parallel_env("take_photo", Observations(state="joints", language=True))
    observed, _ = env.reset(seed=0)
    for agent in env.agents:
        assert {key: np.shape(value) for key, value in observed[agent].items()} == {
            "qpos": (9,),
            "qvel": (9,),
            "language": (),
        }
        assert observed[agent] in env.observation_space(agent)
        assert observed[agent]["language"] == env.task.description
    assert env.state().shape == (4 * 18 + 7 * len(env.task.objects),)


def test_an_episode_is_truncated_at_the_step_limit() -> None:
    env = CentralEnv("pick_meat", step_limit=3)
    env.reset(seed=0)
    ends = [env.step(holding_action(env))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    assert CentralEnv("pick_meat").task.step_limit == read_task("pick_meat").step_limit == 144
    parallel = parallel_env("lift_barrier", step_limit=1)
    parallel.reset(seed=0)
    for agent in parallel.agents:
        parallel.action_space(agent).seed(0)
    actions = {agent: parallel.action_space(agent).sample() for agent in parallel.agents}
    _, _, terminated, truncated, _ = parallel.step(actions)
    assert not parallel.agents and not any(terminated.values()) and all(truncated.values())


def test_actions_are_joint_targets_of_the_panda_and_are_clipped() -> None:
    env = CentralEnv("lift_barrier")
    low, high = DEFAULT.limits_rad
    assert env.action_space.shape == (2, 8) and env.action_space.dtype == np.float32
    np.testing.assert_allclose(env.action_space.low, [[*low, -1]] * 2, rtol=1e-6)
    np.testing.assert_allclose(env.action_space.high, [[*high, 1]] * 2, rtol=1e-6)
    env.reset(seed=0)
    clipped = env.step(np.full((2, 8), 9.0, np.float32))[0]
    env.reset(seed=0)
    np.testing.assert_array_equal(
        clipped["qpos"], env.step(env.action_space.high.astype(np.float32))[0]["qpos"]
    )


@pytest.mark.slow
@pytest.mark.parametrize("overlaps", [False, True])
def test_colliding_arms_are_violations_and_stop_the_episode(overlaps: bool) -> None:
    core = EpisodeCore("lift_barrier", overlaps=overlaps)
    core.reset(0, np.random.default_rng(0))
    monitor, violations, contacts = PolicyMonitor(core.task), 0, 0
    target = np.zeros((2, 8))
    target[:, :7] = (0.0, 1.2, 0.0, -0.6, 0.0, 1.8, 0.8)  # outstretched towards the other arm
    while not core.episode.terminated and not core.episode.truncated:
        core.step(target)
        violations += monitor(core.episode.scene) is not None
        contacts += any(force_n > 1.0 for *_, force_n in core.episode.scene.arm_contacts)
    assert 0 < contacts <= violations
    info = core.episode.info()
    assert info["violations"] == (violations if overlaps else contacts)
    assert "Agent_1" in info["violation"] and "Agent_2" in info["violation"]
    assert info["stopped"] and not info["success"]
    with pytest.raises(ResetNeeded):
        core.step(target)
    core.close()


def test_a_task_outside_of_the_package() -> None:
    assert register(BUTTON) == "rf_exp/push_button-v1"
    env = gymnasium.make("rf_exp/push_button-v1")
    observed, _ = env.reset(seed=0)
    assert set(observed) == {"qpos", "qvel", "pose_button"}
    env.close()
    parallel = parallel_env(BUTTON)
    assert parallel.possible_agents == ["agent1"] and parallel.task.name == "push_button"
    parallel.close()


@pytest.mark.slow
def test_environments_in_separate_processes() -> None:
    envs = gymnasium.make_vec(environment_id("pick_meat"), num_envs=2, vectorization_mode="async")
    observed, infos = envs.reset(seed=4)
    assert observed["qpos"].shape == (2, 1, 9) and infos["seed"].tolist() == [4, 5]
    envs.close()


@pytest.mark.slow
def test_environments_without_pictures_need_no_renderer() -> None:
    """As on a machine without Vulkan: the loader's driver file does not exist."""
    code = (
        "import gymnasium, rf_exp.envs\n"
        "env = gymnasium.make('rf_exp/lift_barrier-v1')\n"
        "env.reset(seed=0)\n"
        "print(env.step(env.action_space.sample())[1])\n"
    )
    environment = {
        "PATH": "",
        "PYTHONPATH": str(ROOT),
        "VK_DRIVER_FILES": "/nowhere",
        "HOME": str(Path.home()),
    }
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert result.returncode == 0 and result.stdout.split() == ["0.0"], result.stderr


def test_every_configured_task_is_registered() -> None:
    ids = {name for name in gymnasium.registry if name.startswith("rf_exp/")}
    assert {environment_id(path.stem) for path in CONFIGURED.glob("*.yaml")} <= ids
