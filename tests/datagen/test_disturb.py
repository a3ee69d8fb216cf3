"""Disturbed demonstrations: planned actions are learned, executed ones stored, and no other object moves."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rf_exp.constraints import Paths, Plan
from rf_exp.datagen import EpisodeGenerator, NullObserver, Planned, Settings
from rf_exp.datagen.brain import ScriptedBrain, ScriptedSpec
from rf_exp.datagen.disturb import (
    MAX_PEAK_STD,
    MOTION_TOLERANCE_M,
    PERTURBATION_LIMITS,
    Disturbance,
    ObjectMotionWatch,
    clearance_losses,
)
from rf_exp.datagen.subgoals import IDLE, Subgoals
from rf_exp.errors import ArgumentError
from rf_exp.policy.inputs.coordination import held_up_mask
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim import shared_simulator
from rf_exp.tasks import default_of
from rf_exp.transforms import transform
from rf_exp.types import (
    CONTROL_DT_S,
    NO_PICTURES,
    ConstraintSet,
    Episode,
    JointLimits,
    Schedule,
    Segment,
    Subgoal,
    Trajectory,
)
from tests.conftest import TASKS, read_task

STRENGTH_RAD, DELAY_S = 0.05, 1.0
LIMITS = JointLimits(**default_of("limits"))
pytestmark = pytest.mark.slow  # whole episodes of every task
FULL = ConstraintSet("full")


class PlanRecorder(NullObserver):
    """Observer that records the plans."""

    def __init__(self) -> None:
        self.plans: list[Planned] = []

    def planned(self, plan: Planned) -> None:
        self.plans.append(plan)


def make(task_name: str, seed: int, strength_rad: float = STRENGTH_RAD):
    task = read_task(task_name)
    settings = Settings.configured(task, FULL, ScriptedSpec(), disturbance_rad=strength_rad, delay_s=DELAY_S)
    return EpisodeGenerator(settings, shared_simulator(task, NO_PICTURES), ScriptedBrain()).make(seed)


@pytest.fixture(scope="module", params=sorted(TASKS))
def episode(request) -> Episode:
    """The first disturbed episode of each task that is accepted."""
    for seed in range(6):
        outcome = make(request.param, seed)
        if outcome.episode is not None:
            return outcome.episode
    raise AssertionError(f"no disturbed episode of {request.param} in 6 seeds")


def test_actions_are_the_plan_and_executed_commands_differ(episode: Episode) -> None:
    assert episode.executed is not None
    deviation_rad = np.abs(episode.executed - episode.action)[..., :-1]
    assert 0 < deviation_rad.max() < 5 * STRENGTH_RAD
    late = held_up_mask(episode.action, episode.executed)
    np.testing.assert_array_equal(episode.executed[~late, -1], episode.action[~late, -1])
    assert late.any() == (late.shape[1] > 1)  # a single arm does not pause
    assert not late[-1].any()
    # The arm is not perturbed while the gripper command changes.
    changes = np.argwhere(np.diff(episode.action[..., -1], axis=0))
    assert len(changes) and max(deviation_rad[step + 1, agent].max() for step, agent in changes) < 1e-6
    low, high = DEFAULT.limits_rad
    arms = episode.executed[..., :-1]
    assert (arms >= low.astype(np.float32)).all() and (arms <= high.astype(np.float32)).all()


def max_derivatives(commands: NDArray[np.floating]) -> tuple[float, float]:
    """Largest joint velocity (rad/s) and acceleration (rad/s2) of commands (T, N, 8) on the control grid."""
    velocity = np.diff(commands[..., :-1].astype(float), axis=0) / CONTROL_DT_S
    acceleration = np.diff(velocity, axis=0) / CONTROL_DT_S
    return float(np.abs(velocity).max()), float(np.abs(acceleration).max())


def test_intended_actions_keep_the_joint_limits(episode: Episode) -> None:
    """Executed ones exceed them at most by the limits of perturbations; float32 rounding adds 2e-4 rad/s2."""
    velocity, acceleration = max_derivatives(episode.action)
    assert velocity <= 1.002 * LIMITS.velocity_rad_s
    assert acceleration <= 1.002 * LIMITS.acceleration_rad_s2 + 4e-4
    assert episode.executed is not None
    velocity, acceleration = max_derivatives(episode.executed)
    assert velocity <= 1.002 * LIMITS.velocity_rad_s + PERTURBATION_LIMITS.velocity_rad_s
    assert acceleration <= 1.002 * LIMITS.acceleration_rad_s2 + PERTURBATION_LIMITS.acceleration_rad_s2 + 4e-4
    deviation_rad = np.abs(episode.executed - episode.action)[..., :-1]
    step_rad = LIMITS.acceleration_rad_s2 * CONTROL_DT_S**2  # a hesitating arm intends the next step
    assert deviation_rad.max() <= MAX_PEAK_STD * STRENGTH_RAD + step_rad


@pytest.mark.parametrize(
    ("task", "seed"), [("lift_barrier", 5019), ("camera_alignment", 5003), ("two_robots_stack_cube", 5003)]
)
def test_a_disturbed_approach_does_not_push_the_object_to_be_grasped(task: str, seed: int) -> None:
    """In each of these episodes, a perturbation of the approach once pushed the object to be grasped."""
    outcome = make(task, seed)
    assert outcome.episode is not None, outcome.reason


def test_replaying_executed_actions_repeats_the_episode(episode: Episode) -> None:
    """Replaying the executed actions repeats the episode; replaying the intended ones does not."""
    world = shared_simulator(read_task(episode.task), NO_PICTURES)
    assert episode.executed is not None
    for commands, same in ((episode.executed, True), (episode.action, False)):
        scene, found = world.reset(episode.seed), []
        for command in commands.astype(float):
            found.append(scene.qpos.astype(np.float32))
            scene = world.step(command)
        assert np.array_equal(np.stack(found), episode.qpos) == same


def test_every_step_has_its_subgoal_and_every_object_its_pose(episode: Episode) -> None:
    texts: list[list[str]] = episode.certificate["subgoals"]  # pyright: ignore[reportAssignmentType]
    assert episode.subgoal is not None and episode.subgoal.shape == episode.action.shape[:2]
    for column, own in zip(episode.subgoal.T, texts, strict=True):
        assert column.min() >= 0 and column.max() < len(own)
        assert (np.diff(column) >= 0).all() and (np.diff(column) <= 1).all()
    assert set(episode.poses) == set(read_task(episode.task).objects)
    for values in episode.poses.values():
        assert values.shape == (len(episode.action), 7)
        np.testing.assert_allclose(np.linalg.norm(values[:, 3:], axis=1), 1.0, atol=1e-5)


def test_disturbances_are_determined_by_the_seed() -> None:
    first, again = (make("stack_cube", 1).episode for _ in range(2))
    assert first is not None and again is not None and first.executed is not None
    np.testing.assert_array_equal(first.executed, again.executed)


def test_without_disturbance_nothing_differs() -> None:
    episode = make("stack_cube", 0, 0.0).episode
    assert episode is not None and episode.executed is None


def test_a_strength_out_of_range_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"disturbance_rad is 0.5; expected 0 to 0.2 rad"):
        Settings.configured(read_task("stack_cube"), FULL, ScriptedSpec(), disturbance_rad=0.5)
    with pytest.raises(ArgumentError, match=r"delay_s is -1; expected 0 to 5.0 s"):
        Settings.configured(read_task("stack_cube"), FULL, ScriptedSpec(), delay_s=-1)


# components

GRASP, LIFT = Subgoal(1, "grasp", "cube", "top"), Subgoal(1, "lift", "cube", height_m=0.1)


def segment(subgoal: Subgoal, primitive: str, steps: int, **more: object) -> Segment:
    return Segment(1, subgoal, primitive, np.tile(DEFAULT.rest_rad, (steps, 1)), np.ones(steps), **more)  # pyright: ignore


TWO_SUBGOALS = Trajectory(
    1,
    np.array(DEFAULT.rest_rad),
    1.0,
    (
        segment(GRASP, "approach", 30, touches=frozenset({"cube"})),
        segment(GRASP, "close", 8, touches=frozenset({"cube"})),
        segment(LIFT, "lift", 30, attached="cube", touches=frozenset({"cube"})),
    ),
)
ARMS: dict[int, Arm] = {agent: Arm(DEFAULT, np.eye(4)) for agent in (1, 2)}
RESTING = Trajectory(2, np.zeros(7), 1.0, ())


WITHOUT_WAITS = Schedule(np.stack([np.arange(69), np.zeros(69, int)], axis=1), 0)


def disturbance(seed: int, strength_rad: float = 1e-3, schedule: Schedule = WITHOUT_WAITS) -> Disturbance:
    return Disturbance(ARMS, (TWO_SUBGOALS, RESTING), schedule, strength_rad, np.random.default_rng(seed))


def deviation_rad(disturbed: Disturbance) -> NDArray[np.float64]:
    """Deviations (P, 7) of the first agent in rad at each path position."""
    return disturbed.trajectories()[0].path()[:, :-1] - DEFAULT.rest_rad


@pytest.mark.parametrize("waits_at", [None, 12])
def test_perturbations_keep_their_own_limits(waits_at: int | None) -> None:
    """At any strength, also where an arm waits during one; path positions count as control steps."""
    trajectory = replace(TWO_SUBGOALS, segments=(segment(GRASP, "move", 12), *TWO_SUBGOALS.segments))
    positions = np.arange(len(trajectory) + 1)
    if waits_at is not None:
        positions = np.insert(positions, waits_at, np.full(9, waits_at))
    schedule, reached = Schedule(positions[:, None], 0), np.zeros(2)
    for seed in range(100):
        disturbed = Disturbance(ARMS, (trajectory,), schedule, 0.2, np.random.default_rng(seed))
        moved = disturbed.trajectories()[0].path()[positions]
        assert np.abs(moved[:, :-1] - DEFAULT.rest_rad).max() <= MAX_PEAK_STD * 0.2
        reached = np.maximum(reached, max_derivatives(moved[:, None]))
        low, high = DEFAULT.limits_rad
        assert (moved[:, :-1] >= low).all() and (moved[:, :-1] <= high).all()
    bounds = PERTURBATION_LIMITS
    assert 0.9 * bounds.acceleration_rad_s2 < reached[1] <= bounds.acceleration_rad_s2 + 1e-9
    assert reached[0] <= bounds.velocity_rad_s + 1e-9


def test_a_colliding_perturbation_is_mirrored_then_reduced_then_removed() -> None:
    disturbed = disturbance(1)
    full_rad = deviation_rad(disturbed)
    at = int(np.flatnonzero(full_rad.any(axis=1))[0])
    length = int(np.flatnonzero(~full_rad[at:].any(axis=1))[0])
    for factor in (-1.0, 0.5, -0.5, 0.25, -0.25, 0.0):
        assert disturbed.reduce([(1, at), (1, at + 1), (2, 0)])  # once, though it is listed twice
        reduced_rad = deviation_rad(disturbed)
        np.testing.assert_allclose(
            reduced_rad[at : at + length], factor * full_rad[at : at + length], atol=1e-12
        )
        np.testing.assert_allclose(reduced_rad[at + length :], full_rad[at + length :], atol=1e-12)
    assert not disturbed.reduce([(2, 0)])  # a resting agent has no perturbation
    while disturbed.reduce([(1, at)]):  # then the other perturbations, the nearest first
        pass
    assert not deviation_rad(disturbed).any()


def test_perturbations_fade_where_fingers_move_and_are_smaller_with_a_load() -> None:
    deviations = []
    for seed in range(200):
        moved = deviation_rad(disturbance(seed))
        assert not moved[0].any() and not moved[-1].any()
        assert not moved[31 - 4 : 39 + 4].any()  # around the closing of the gripper, positions 31 to 38
        deviations.append(moved)
    spread = np.std(deviations, axis=(0, 2))
    assert spread[10] > 3 * spread[24] > 0
    assert 0.1 < spread[39:69].max() / spread[:30].max() < 0.55


def test_a_waiting_agent_is_labelled_with_its_next_subgoal() -> None:
    positions = np.concatenate([np.arange(39), np.full(5, 38), np.arange(39, 69)])
    schedule = Schedule(np.stack([positions, np.zeros_like(positions)], axis=1), 0)
    subgoals = Subgoals(2)
    numbers = subgoals.number_steps((TWO_SUBGOALS, RESTING), schedule)
    assert (numbers[:39, 0] == 0).all() and (numbers[39:, 0] == 1).all() and not numbers[:, 1].any()
    assert subgoals.texts == [[GRASP.text, LIFT.text], [IDLE]]
    again = subgoals.number_steps((TWO_SUBGOALS, RESTING), schedule)  # a second proposal
    assert again[0, 0] == 2 and again[-1, 0] == 3 and not again[:, 1].any()


def test_known_subgoals_keep_their_numbers() -> None:
    """At any start of a plan, also for a subgoal that occurs repeatedly."""
    schedule = Schedule(np.stack([np.arange(69), np.zeros(69, int)], axis=1), 0)
    known_texts = ["home", LIFT.text], [IDLE, "press"]
    subgoals = Subgoals(2, known_texts)
    for _ in range(2):
        numbers = subgoals.number_steps((TWO_SUBGOALS, RESTING), schedule)
        assert numbers[0, 0] == 2 and numbers[-1, 0] == 1
        assert (numbers[:, 1] == 1).all()  # an agent without further subgoals has finished all of them
    assert subgoals.texts == [["home", LIFT.text, GRASP.text], [IDLE, "press"]]


def test_a_path_nearer_to_an_object_than_its_plan_is_found() -> None:
    """Also for objects that the gripper may touch there; not where the plan itself is as near."""
    task = read_task("stack_cube")
    outcome = PlanRecorder()
    settings = Settings.configured(task, FULL, ScriptedSpec())
    EpisodeGenerator(settings, shared_simulator(task, NO_PICTURES), ScriptedBrain(), outcome).make(0)
    planned = outcome.plans[0]
    plan = planned.checked.plan
    assert not [*clearance_losses(plan, planned.checker.paths(planned.trajectories, plan.scene))]
    trajectory = planned.trajectories[0]
    approach, arm = trajectory.segments[0], task.arms[1]
    assert approach.touches
    beside = arm.tcp(approach.qpos[-1]) @ transform((0.0, 0.03, 0.0))  # a finger in the cube
    inside = arm.solve(beside, approach.qpos[-1])
    assert inside is not None

    def through(*positions: int) -> Paths:
        """The paths with an approach that passes through `inside` at these path positions."""
        qpos = approach.qpos.copy()
        qpos[[position - 1 for position in positions]] = inside
        moved = replace(trajectory, segments=(replace(approach, qpos=qpos), *trajectory.segments[1:]))
        return planned.checker.paths((moved, *planned.trajectories[1:]), plan.scene)

    assert [*clearance_losses(plan, through(10, 12))] == [(1, 10), (1, 12)]
    assert not [*clearance_losses(planned.checker.check(through(10, 12), plan.schedule).plan, through(10))]


def test_only_objects_that_no_agent_handles_are_watched() -> None:
    world = shared_simulator(read_task("stack_cube"), NO_PICTURES)
    start = world.reset(0)
    blue = next(name for name in start.poses)
    path = Trajectory(
        1,
        np.zeros(7),
        1.0,
        (
            segment(GRASP, "approach", 3, touches=frozenset({blue})),
            segment(GRASP, "close", 3, touches=frozenset({blue})),
        ),
    )
    schedule = Schedule(np.arange(7)[:, None], 6)

    def moved(step: int, by_m: float):
        pose = start.poses[blue].copy()
        pose[0, 3] += by_m
        return replace(start, step=step, poses={**start.poses, blue: pose})

    plan = Plan(Paths(read_task("stack_cube"), FULL, start, (path,)), schedule)
    watch = ObjectMotionWatch(plan, objects=True)
    assert watch.unintended_motion(moved(1, MOTION_TOLERANCE_M / 2)) is None
    moved_by = watch.unintended_motion(moved(2, 2 * MOTION_TOLERANCE_M))
    assert moved_by is not None and moved_by.sentence == f"a disturbed arm has moved {blue} by 10 mm"
    assert (
        watch.unintended_motion(moved(5, 4 * MOTION_TOLERANCE_M)) is None
    )  # the fingers close on it: motion is expected


def test_the_content_of_a_held_cup_moves_with_it() -> None:
    task = read_task("place_cube_in_cup")
    start = shared_simulator(task, NO_PICTURES).reset(0)
    inside = start.poses["cup"] @ transform((0.005, 0.0, 0.105))
    filled = replace(start, poses={**start.poses, "cube": inside}, held=("cup", None))
    idle = tuple(Trajectory(agent, np.zeros(7), 1.0, ()) for agent in task.agents)
    plan = Plan(Paths(task, FULL, filled, idle), Schedule(np.zeros((1, 2), int), 0))
    watch = ObjectMotionWatch(plan, objects=True)
    shift = transform((0.0, 2 * MOTION_TOLERANCE_M, 0.0))
    along = {name: shift @ filled.poses[name] for name in ("cup", "cube")}
    assert watch.unintended_motion(replace(filled, step=1, poses={**filled.poses, **along})) is None
    beside = transform((0.2, 0.0, -0.1)) @ along["cube"]
    moved = watch.unintended_motion(
        replace(filled, step=2, poses={**filled.poses, "cup": along["cup"], "cube": beside})
    )
    assert moved is not None and moved.object == "cube"
