"""Laws over every task in conf/task: starts, chance, cheating. No pictures.

Beside them: the same seed gives the same bytes and nothing moves by itself (test_simulator.py), views show
what matters (test_cameras.py), plans name only what exists (tests/tasks/test_success.py).
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from sapien import physx

from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M, PlanningScene, Swept, nearest
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim import Simulator
from rf_exp.tasks import SuccessEvaluator, Task
from rf_exp.transforms import from_axes
from rf_exp.types import Scene
from tests.conftest import TASKS, read_task
from tests.scenes import start_scene

RESTING_M = 5e-4  # by so much things that lie on one another may overlap at the start
RANDOM_EPISODES, RANDOM_STEPS = 10, 40
APPROACHES = 5  # of an episode: to build a scene costs as much as all steps of one
FEWEST_TOUCHES = 20  # of all approaches, in which something was moved; with less, they prove nothing
NEAR_M = 0.03  # of the things that random actions go for
FLIGHT_STEPS = 30
THROWS_M_S = ((0.0, 0.0, 2.5), (0.6, 0.6, 1.5), (-0.6, 0.4, 1.5), (0.3, -0.8, 2.0))


@pytest.fixture(scope="module", params=TASKS)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(read_task(request.param), render=False) as simulator:
        yield simulator


# Starts


@pytest.mark.slow
def test_a_hundred_seeds_give_a_hundred_starts(task: Task) -> None:
    starts = [task.start(seed) for seed in range(100)]

    def different(values: Iterator[np.ndarray | float]) -> int:
        return len({np.asarray(value).round(9).tobytes() for value in values})

    assert different(np.stack(list(start.poses.values())) for start in starts) == 100
    assert different(start.light for start in starts) == 100
    for agent in task.agents:
        assert different(start.qpos[agent - 1, :-2] for start in starts) == 100
    for name in task.objects:
        assert different(start.tints[name] for start in starts) == 100


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


@pytest.mark.slow
def test_nothing_stands_in_anything_else(task: Task) -> None:
    for seed in range(50):
        scene = start_scene(task, seed)
        planning_scene = PlanningScene(task, scene)
        things = {name: solid(planning_scene, name) for name in task.objects if task.asset(name).hulls}
        for (one, a), (other, b) in combinations(things.items(), 2):
            assert distance_m(a, b) > -RESTING_M, (seed, one, other)
        for name in things:
            assert task.asset(name).vertices(scene.poses[name])[:, 2].min() > -RESTING_M, (seed, name)
        for agent in task.agents:
            arm = planning_scene.arm(agent, scene.qpos[agent - 1])
            for name, thing in things.items():
                assert distance_m(arm, thing) > OBJECT_MARGIN_M, (seed, agent, name)
        for a, b in combinations(task.agents, 2):
            assert planning_scene.between(a, b).distance_m > AGENT_MARGIN_M, (seed, a, b)


def solid(planning_scene: PlanningScene, name: str) -> Swept:
    """An object that may touch nothing, unlike one that lies on another."""
    return replace(planning_scene.standing([name]), objects=frozenset())


def distance_m(a: Swept, b: Swept) -> float:
    found = nearest(a, b)
    assert found is not None
    return found.distance_m


# Success is nothing that just happens


@pytest.mark.slow
def test_nothing_has_succeeded_at_reset(simulator: Simulator) -> None:
    for seed in range(20):
        scene = simulator.reset(seed)
        verdict = SuccessEvaluator(simulator.task, scene)(scene)
        assert not verdict.success and not verdict.success_paper and not all(verdict.evidence.values()), seed


@pytest.mark.slow
def test_random_actions_never_succeed(simulator: Simulator) -> None:
    moved = 0
    for seed in range(RANDOM_EPISODES):
        rng = np.random.default_rng(seed)
        scene = simulator.reset(seed)
        judge, action = SuccessEvaluator(simulator.task, scene), simulator.command
        for _ in range(APPROACHES):
            before, reach = scene, towards_things(simulator.task, scene, rng) / RANDOM_STEPS
            for step in range(RANDOM_STEPS):
                action[:, :-1] += reach + rng.normal(0.0, 0.015, reach.shape)
                if step % 10 == 0:
                    action[:, -1] = rng.choice([-1.0, 1.0], len(action))
                scene = simulator.step(action)
                verdict = judge(scene)
                assert not verdict.success and not verdict.success_paper, (seed, scene.step)
            moved += any(np.abs(scene.poses[name] - pose).max() > 2e-3 for name, pose in before.poses.items())
    assert moved >= FEWEST_TOUCHES, "the arms hardly ever touch anything: they prove nothing"


def towards_things(task: Task, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """(N, 7) rad: each arm goes for a place near a thing, from above; where it cannot reach, anywhere."""
    change = rng.normal(0.0, 0.3, (len(task.robots), task.dof))
    for row, robot in enumerate(task.robots):
        place_m = scene.poses[rng.choice(loose(task))][:3, 3] + rng.normal(0.0, NEAR_M, 3)
        turn = rng.uniform(0.0, np.pi)
        pose = from_axes(place_m, z=(0, 0, -1), y=(np.cos(turn), np.sin(turn), 0))
        qpos = Arm(DEFAULT, robot.world_from_base).solve(pose, scene.qpos[row, :-2])
        if qpos is not None:
            change[row] = qpos - scene.qpos[row, :-2]
    return change


@pytest.mark.slow
@pytest.mark.parametrize("throw_m_s", THROWS_M_S)
def test_flung_things_never_succeed(simulator: Simulator, throw_m_s: tuple[float, float, float]) -> None:
    thrown = loose(simulator.task)
    for names in [[name] for name in thrown] + [thrown]:
        start = scene = simulator.reset(0)
        judge, hold = SuccessEvaluator(simulator.task, start), simulator.command
        for name in names:
            fling(simulator, name, throw_m_s)
        highest_m = 0.0
        for step in range(FLIGHT_STEPS):
            scene = simulator.step(hold)
            risen_m = max(scene.poses[name][2, 3] - start.poses[name][2, 3] for name in names)
            highest_m = max(highest_m, float(risen_m))
            assert not judge(scene).success, (names, step)
        assert highest_m > 0.04, "it did not fly"


def loose(task: Task) -> list[str]:
    """The objects that can be moved at all."""
    return [name for name in task.objects if not (task.asset(name).static or task.asset(name).ghost)]


def fling(simulator: Simulator, name: str, velocity_m_s: tuple[float, float, float]) -> None:
    body = simulator._loaded.bodies[name].find_component_by_type(physx.PhysxRigidDynamicComponent)
    assert isinstance(body, physx.PhysxRigidDynamicComponent)
    body.set_linear_velocity(list(velocity_m_s))
