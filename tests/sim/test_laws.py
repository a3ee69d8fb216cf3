"""Every task in conf/task satisfies the laws of the suite, and each law is violated by some task.

Reproducible bytes are tested in test_simulator.py, laws of pictures in test_cameras.py.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rf_exp.laws import LAWS, Law
from rf_exp.laws import suite as laws
from rf_exp.sim import Simulator
from rf_exp.statements import Proposal
from rf_exp.tasks import CameraSpec, RobotSpec, Task
from rf_exp.types import Subgoal
from tests.conftest import TASKS, read_task


@pytest.fixture(scope="module", params=TASKS)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(read_task(request.param), render=False) as simulator:
        yield simulator


@pytest.mark.slow
@pytest.mark.parametrize("law", [law for law in LAWS if not law.pictures], ids=str)
def test_law(simulator: Simulator, law: Law) -> None:
    assert not list(law.violations(simulator)), law.sentence


@pytest.mark.slow
def test_masses_are_nominal_or_in_their_range(task: Task) -> None:
    nominal_kg = {name: task.asset(name).mass_kg for name in task.objects}
    assert task.start(5).masses_kg == nominal_kg
    heavy = replace(task, randomisation=replace(task.randomisation, mass_scale=1.0))
    starts = [heavy.start(seed) for seed in range(100)]
    for name, least_kg in nominal_kg.items():
        masses_kg, most_kg = (
            [start.masses_kg[name] for start in starts],
            task.asset(name).heaviest_kg or least_kg,
        )
        assert least_kg <= min(masses_kg) <= max(masses_kg) <= most_kg
        assert most_kg == least_kg or max(masses_kg) - min(masses_kg) > 0.9 * (most_kg - least_kg)
    assert np.array_equal(starts[5].qpos, task.start(5).qpos)  # masses change nothing else


# Tasks that violate a law


def without_variation(task: Task) -> Task:
    return replace(task, randomisation=replace(task.randomisation, init_qpos_std_rad=0.0))


def object_in_table(task: Task) -> Task:
    return replace(task, objects={"steak": replace(task.objects["steak"], z_m=-0.01)})


def object_in_air(task: Task) -> Task:
    return replace(task, objects={"steak": replace(task.objects["steak"], z_m=0.05)})


def gripper_at_object(task: Task) -> Task:
    low = RobotSpec(-0.615, 0.0, 0.0, rest_rad=(0.0, 0.6, 0.0, -2.0, 0.0, 2.6, 0.785))
    return replace(task, robots=(low,))


def lenient_success(task: Task) -> Task:
    """With criteria that nearly any scene satisfies."""
    return replace(task, success={**task.success, "lift_m": -1.0, "paper_height_m": -1.0})


def duplicate_view(task: Task) -> Task:
    return replace(task, cameras={**task.cameras, "agent1": task.cameras["global"]})


def cameras_facing_away(task: Task) -> Task:
    away = CameraSpec((0.0, 0.0, 2.0), (5.0, 5.0, 2.0))
    return replace(task, cameras={"global": away, "agent1": replace(away, eye_m=(1.0, 0.0, 2.0))})


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(
    ("law", "change", "message"),
    [
        (laws.starts_differ, without_variation, "posture of agent 1: 1 of 100"),
        (laws.nothing_stands_in_anything, object_in_table, "mm in the table"),
        (laws.nothing_stands_in_anything, gripper_at_object, "from steak"),
        (laws.nothing_moves_by_itself, object_in_air, "steak moves at"),
        (laws.nothing_has_succeeded_at_the_start, lenient_success, "is a success already"),
        (laws.random_actions_never_succeed, lenient_success, "random actions succeed"),
        (laws.every_view_is_its_own, duplicate_view, "global and agent1 see the same"),
        (laws.everything_is_seen_at_the_start, cameras_facing_away, "global sees 0 px of steak"),
        (
            laws.agents_see_their_work,
            cameras_facing_away,
            "agent 1 sees 0 px of its gripper and 0 px of steak",
        ),
    ],
)
def test_a_task_that_violates_a_law_is_reported(
    law: Callable[[Simulator], Iterator[str]], change: Callable[[Task], Task], message: str
) -> None:
    with Simulator(change(read_task("pick_meat"))) as world:
        assert any(message in each for each in law(world)), list(law(world))


@pytest.mark.slow
def test_success_by_thrown_objects_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    task = read_task("pick_meat")
    verdict = SimpleNamespace(success=True, success_paper=True)
    monkeypatch.setattr(laws, "SuccessEvaluator", lambda *_: lambda scene: verdict)
    with Simulator(task, render=False) as world:
        assert "steak flung at (0.0, 0.0, 2.5) m/s: a success at step 0" in list(
            laws.flung_things_never_succeed(world)
        )


def test_a_plan_with_unknown_points_and_agents_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    task = read_task("pick_meat")
    subgoals = Subgoal(1, "grasp", "steak", "handle"), Subgoal(2, "grasp", "steak", "center")
    monkeypatch.setattr(task.module, "plan", lambda scene, task: Proposal(subgoals, ()))
    with Simulator(task, render=False) as world:
        violations = list(laws.plans_name_what_exists(world))
    assert violations[0].endswith("there is no point handle") and violations[1].endswith(
        "there is no agent 2"
    )
