"""Families: tasks whose numbers of arms and objects are keys."""

from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from rf_exp.artifacts import plain
from rf_exp.constraints import RoboChecker
from rf_exp.datagen import Settings, allocate_jobs, make_episode
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.envs import central
from rf_exp.errors import ArgumentError
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene
from rf_exp.tasks import CONFIGURED, SuccessEvaluator, Task, load_task, named_task, stored_task
from rf_exp.types import NO_PICTURES, ConstraintSet
from tests.conftest import CONF, TASKS, experiment
from tests.scenes import start_scene

FAMILIES = {path.stem: path for path in sorted((CONF / "task" / "family").glob("*.yaml"))}
MAX_CUBES = 8  # per tower


def members() -> list[str]:
    """Every number of arms, with the fewest objects and with the most that fit."""
    found = []
    for family, path in FAMILIES.items():
        node = OmegaConf.load(path)[family]  # pyright: ignore[reportArgumentType]
        for arms in range(node.arms.least, node.arms.most + 1):
            max_things = node.things.most if family != "tower" else min(node.things.most, MAX_CUBES // arms)
            found += [f"{family}_{arms}x{things}" for things in sorted({node.things.least, max_things})]
    return found


def member(name: str) -> Task:
    task = named_task(name)
    assert task is not None
    return task


def test_the_package_has_five_families() -> None:
    assert list(FAMILIES) == ["chain", "lift", "pool", "ring", "tower"]
    assert len(members()) == 60


@pytest.mark.parametrize("name", members())
def test_a_member_is_a_valid_task(name: str) -> None:
    """It starts unsolved with its arms apart; its plan is understood and names what exists in the task."""
    task = member(name)
    assert task.name == name and len(task.robots) == int(name.split("_")[1].split("x")[0])
    scene = start_scene(task, 0)
    planning_scene = PlanningScene(task, scene)
    for a, b in combinations(task.agents, 2):
        assert planning_scene.between(a, b).distance_m > AGENT_MARGIN_M, (a, b)
    assert not SuccessEvaluator(task, scene)(scene).success
    limits = Settings.configured(task, ConstraintSet("full"), ScriptedSpec()).limits
    proposal = allocate_jobs(task.module.plan(scene, task), task, scene, limits)
    if len(task.objects) > 2:  # in a pool with one object, one arm takes it
        assert {subgoal.agent for subgoal in proposal.subgoals} == set(task.agents)
    for subgoal in proposal.subgoals:
        assert subgoal.object in task.objects
        assert subgoal.point is None or subgoal.point in task.asset(subgoal.object or "").points
        assert subgoal.target is None or subgoal.target in {*task.objects, *task.places(scene)}
    code = RoboChecker(task, proposal, ConstraintSet("full")).code
    assert len(code.checks) == len(proposal.constraints)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain_2x2", "lift_1x1", "lift_3x1", "pool_3x4", "ring_2x2", "tower_2x2"])
def test_the_expert_succeeds(name: str) -> None:
    settings = Settings.configured(member(name), ConstraintSet("full"), ScriptedSpec())
    outcome = make_episode(settings, NO_PICTURES, 0)
    assert outcome.success and outcome.contacts == 0 and outcome.attempts == 1, outcome.reason


def test_seeds_differ_and_repeat() -> None:
    starts = [np.stack(list(member("ring_3x2").start(seed).poses.values())) for seed in (0, 0, 1)]
    assert np.array_equal(starts[0], starts[1]) and not np.array_equal(starts[0], starts[2])


def test_numbers_are_keys_of_the_command_line() -> None:
    assert [task.name for task in experiment("task=ring", "arms=6", "things=2").tasks] == ["ring_6x2"]
    tasks = experiment("task=[ring,tower]", "arms=3").tasks
    assert [task.name for task in tasks] == ["ring_3x1", "tower_3x1"]
    assert [task.name for task in experiment("task=lift").tasks] == ["lift_4x1"]
    assert experiment("task=ring", "task.ring.success.goal_m=0.01").tasks[0].success["goal_m"] == 0.01


def test_task_all_has_no_members_of_families() -> None:
    assert {task.name for task in experiment("task=all").tasks} == set(TASKS)


def test_the_task_of_a_store_is_found() -> None:
    task = member("chain_3x2")
    identity = {"task": task.name, "scene": plain(task.identity)}
    assert stored_task(identity, CONFIGURED) == task
    with pytest.raises(ArgumentError, match="unknown task of a store"):
        stored_task({**identity, "task": "pair_3x2"}, CONFIGURED)


def test_an_environment_is_made_by_name() -> None:
    with central.CentralEnv("ring_3x1", central.Observations(pictures=False)) as env:
        env.reset(seed=0)
        assert env.action_space.shape == (3, 8)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("task=ring", "arms=9"), "task 'ring': arms is 9; expected 1 to 8"),
        (("task=ring", "arms=0"), "task 'ring': arms is 0; expected 1 to 8"),
        (("task=ring", "arms=two"), "task 'ring': arms is 'two'; expected a number from 1 to 8"),
        (("task=chain", "things=5"), "task 'chain': things is 5; expected 1 to 4"),
        (("task=lift", "things=2"), "task 'lift': things is 2; expected 1"),
        (
            ("task=tower", "arms=4", "things=3"),
            "task 'tower': a tower of 4 x 3 cubes is higher than the arms can build; expected at most 8 in "
            "all",
        ),
        (
            ("task=lift_barrier", "arms=3"),
            "task 'lift_barrier' has numbers of its own; arms and things are keys of chain, lift, pool, "
            "ring, tower",
        ),
    ],
)
def test_impossible_numbers_are_refused(overrides: tuple[str, ...], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        experiment(*overrides)
    assert str(error.value) == message


def test_an_unknown_key_of_a_layout_is_refused(tmp_path: Path) -> None:
    node: Any = OmegaConf.to_container(OmegaConf.load(FAMILIES["lift"]))
    node["lift"]["layout"]["radius"] = 1.0
    with pytest.raises(ArgumentError, match=r"task 'lift': layout: .* unexpected keyword argument 'radius'"):
        load_task("lift", node["lift"])


def test_every_arm_has_a_share_of_the_work() -> None:
    for family, arms in product(("ring", "tower", "chain"), (2, 5)):
        task = member(f"{family}_{arms}x1")
        plan = task.module.plan(start_scene(task, 1), task)
        grasps = [subgoal.agent for subgoal in plan.subgoals if subgoal.verb == "grasp"]
        assert sorted(grasps) == list(task.agents)
