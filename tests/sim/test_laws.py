"""Every task in conf/task is held to the laws of the suite, and each law is broken by some task.

Beside them: the same seed gives the same bytes (test_simulator.py). Laws of pictures: test_cameras.py.
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
def test_a_law(simulator: Simulator, law: Law) -> None:
    assert not list(law.violations(simulator)), law.sentence


@pytest.mark.slow
def test_things_weigh_what_they_should(task: Task) -> None:
    usual = {name: task.asset(name).mass_kg for name in task.objects}
    assert task.start(5).masses_kg == usual
    heavy = replace(task, randomisation=replace(task.randomisation, mass_scale=1.0))
    drawn = [heavy.start(seed) for seed in range(100)]
    for name, least_kg in usual.items():
        masses_kg, most_kg = (
            [start.masses_kg[name] for start in drawn],
            task.asset(name).heaviest_kg or least_kg,
        )
        assert least_kg <= min(masses_kg) <= max(masses_kg) <= most_kg
        assert most_kg == least_kg or max(masses_kg) - min(masses_kg) > 0.9 * (most_kg - least_kg)
    assert np.array_equal(drawn[5].qpos, task.start(5).qpos)  # weights change nothing else


# Each law is broken by some task


def always_the_same(task: Task) -> Task:
    return replace(task, randomisation=replace(task.randomisation, init_qpos_std_rad=0.0))


def sunk(task: Task) -> Task:
    return replace(task, objects={"steak": replace(task.objects["steak"], z_m=-0.01)})


def dropped(task: Task) -> Task:
    return replace(task, objects={"steak": replace(task.objects["steak"], z_m=0.05)})


def beside_the_hand(task: Task) -> Task:
    low = RobotSpec(-0.615, 0.0, 0.0, rest_rad=(0.0, 0.6, 0.0, -2.0, 0.0, 2.6, 0.785))
    return replace(task, robots=(low,))


def lenient(task: Task) -> Task:
    """Whose criteria ask for next to nothing."""
    return replace(task, success={**task.success, "lift_m": -1.0, "paper_height_m": -1.0})


def twice_the_same_view(task: Task) -> Task:
    return replace(task, cameras={**task.cameras, "agent1": task.cameras["global"]})


def looking_away(task: Task) -> Task:
    away = CameraSpec((0.0, 0.0, 2.0), (5.0, 5.0, 2.0))
    return replace(task, cameras={"global": away, "agent1": replace(away, eye_m=(1.0, 0.0, 2.0))})


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(
    ("law", "change", "said"),
    [
        (laws.starts_differ, always_the_same, "posture of agent 1: 1 of 100"),
        (laws.nothing_stands_in_anything, sunk, "mm in the table"),
        (laws.nothing_stands_in_anything, beside_the_hand, "from steak"),
        (laws.nothing_moves_by_itself, dropped, "steak moves at"),
        (laws.nothing_has_succeeded_at_the_start, lenient, "is a success already"),
        (laws.random_actions_never_succeed, lenient, "random actions succeed"),
        (laws.every_view_is_its_own, twice_the_same_view, "global and agent1 see the same"),
        (laws.everything_is_seen_at_the_start, looking_away, "global sees 0 px of steak"),
        (laws.agents_see_their_work, looking_away, "agent 1 sees 0 px of its gripper and 0 px of steak"),
    ],
)
def test_a_task_that_breaks_a_law(
    law: Callable[[Simulator], Iterator[str]], change: Callable[[Task], Task], said: str
) -> None:
    with Simulator(change(read_task("pick_meat"))) as world:
        assert any(said in each for each in law(world)), list(law(world))


@pytest.mark.slow
def test_things_that_may_fly_to_success_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    task = read_task("pick_meat")
    judged = SimpleNamespace(success=True, success_paper=True)
    monkeypatch.setattr(laws, "SuccessEvaluator", lambda *_: lambda scene: judged)
    with Simulator(task, render=False) as world:
        assert "steak flung at (0.0, 0.0, 2.5) m/s: a success at step 0" in list(
            laws.flung_things_never_succeed(world)
        )


def test_a_plan_of_what_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    task = read_task("pick_meat")
    wrong = Subgoal(1, "grasp", "steak", "handle"), Subgoal(2, "grasp", "steak", "center")
    monkeypatch.setattr(task.module, "plan", lambda scene, task: Proposal(wrong, ()))
    with Simulator(task, render=False) as world:
        found = list(laws.plans_name_what_exists(world))
    assert found[0].endswith("there is no point handle") and found[1].endswith("there is no agent 2")
