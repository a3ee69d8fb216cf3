"""Other robots throughout: expert, store, exports, environments, cells of the library, policies."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import pytest

from rf_exp.data.__main__ import export
from rf_exp.datagen import EpisodeGenerator, Outcome, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs.parallel import ParallelArmsEnv
from rf_exp.library import Workcell
from rf_exp.robots import DEFAULT, robot_named
from rf_exp.sim import Simulator
from rf_exp.store import Store
from rf_exp.tasks import Task, named_task
from rf_exp.types import ConstraintSet

pytestmark = pytest.mark.slow
XARM7 = robot_named("xarm7")
STAGES = "stages=[generate,train,evaluate]"
NAME = "two_robots_stack_cube-panda-xarm7"


def task_named(name: str) -> Task:
    task = named_task(name)
    assert task is not None
    return task


def outcome_of(task: Task) -> Outcome:
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    with Simulator(task, render=False) as world:
        return EpisodeGenerator(settings, world, settings.make_brain(0)).make(0)


@pytest.mark.parametrize("name", ["pick_meat-xarm7", "lift_barrier-xarm7"])
def test_the_expert_succeeds_at_the_first_attempt_without_a_contact(name: str) -> None:
    outcome = outcome_of(task_named(name))
    assert outcome.success and outcome.attempts == 1 and outcome.contacts == 0, outcome.reason


def test_the_expert_succeeds_with_the_ur5_too() -> None:
    pytest.importorskip("collada", reason="rf_exp[ur5] is not installed")
    outcome = outcome_of(task_named("pick_meat-ur5"))
    assert outcome.success and outcome.contacts == 0 and outcome.episode is not None, outcome.reason
    assert outcome.episode.qpos.shape[1:] == (1, 8) and outcome.episode.action.shape[1:] == (1, 7)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """One episode of a Panda and an xArm7."""
    task = task_named(NAME)
    outcome = outcome_of(task)
    assert outcome.success and outcome.contacts == 0 and outcome.episode is not None, outcome.reason
    path = tmp_path_factory.mktemp("arms") / "s.zarr"
    robots = [robot.model for robot in task.robots]
    with Store.create(path, {"task": NAME}, 2, (), 0, 0, tuple(task.objects), robots=robots) as made:
        made.append(outcome.episode)
    return Store.open(path)


def test_a_store_names_both_arms(store: Store) -> None:
    assert [model.title for model in store.models] == [DEFAULT.title, XARM7.title]
    low, high = XARM7.limits_rad
    assert ((store.action[:, 1, :7] >= low) & (store.action[:, 1, :7] <= high)).all()


def test_exports_have_the_rows_and_the_names_of_each(store: Store, tmp_path: Path) -> None:
    export(store.path, tmp_path / "h5", "recordepisode")
    with h5py.File(next((tmp_path / "h5").glob("*.h5"))) as file:
        actions = file["traj_0/actions"]
        assert sorted(actions) == ["panda-0", "xarm7-1"]  # pyright: ignore[reportArgumentType]
        np.testing.assert_array_equal(actions["xarm7-1"][:], store.action[:, 1])  # pyright: ignore
    export(store.path, tmp_path / "lerobot", "lerobot")
    info = json.loads((tmp_path / "lerobot/meta/info.json").read_text())
    assert info["robot_type"] == "1x_franka_panda_1x_xarm7"
    export(store.path, tmp_path / "lightning", "policy_lightning")
    with h5py.File(next((tmp_path / "lightning").glob("*.h*5"))) as file:
        np.testing.assert_array_equal(file["action_1"][:], store.action[:, 1])  # pyright: ignore


def test_an_environment_takes_the_commands_of_both(store: Store) -> None:
    env = ParallelArmsEnv(task_named(NAME))
    try:
        seen, _ = env.reset(seed=0)
        for agent in env.agents:
            assert env.observation_space(agent).contains(seen[agent])
        np.testing.assert_allclose(env.action_space(env.agents[1]).high[:7], XARM7.limits_rad[1], rtol=1e-6)
        env.step({agent: store.action[0, k] for k, agent in enumerate(env.agents)})
    finally:
        env.close()


def test_a_scene_of_maniskill_with_it_is_a_cell_of_the_library() -> None:
    with Simulator(task_named("pick_meat-xarm7"), render=False) as world:
        world.reset(0)
        cell = Workcell(world._env)
        assert [robot.model for robot in cell.task.robots] == [XARM7]


def test_policies_of_another_arm_are_trained_and_evaluated(tmp_path: Path) -> None:
    """The six joints of the UR5 where it is installed, otherwise the xArm7."""
    robot = "ur5" if find_spec("collada") else "xarm7"
    chosen = "task=pick_meat", f"robot={robot}", "policy=state", "policy.head.refined.regression_steps=2"
    small = "demos=1", "scenes=1", "workers=1", "training.steps=2", "wandb=disabled"
    done = subprocess.run(
        [sys.executable, "-m", "rf_exp.run", *chosen, *small, STAGES, f"out={tmp_path}"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    row = next(tmp_path.glob("results/evaluate/**/*.jsonl")).read_text().splitlines()[-1]
    assert json.loads(row)["task"] == f"pick_meat-{robot}"
