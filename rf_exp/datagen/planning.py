"""Planning: RoboBrain proposes, primitives generate motion, RoboChecker schedules and checks it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from numpy.random import Generator

from rf_exp.constraints import CheckedPlan, Paths, RoboChecker, limit_speeds
from rf_exp.coordination import Delays
from rf_exp.datagen.allocation import allocate_jobs
from rf_exp.datagen.brain import BadAnswer, Brain, BrainSpec, Question, from_json
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.planner import Motions, canonical_order, plan_motion
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.state import Unreachable
from rf_exp.datagen.obstacles import Obstacles, occupied_place
from rf_exp.datagen.yielding import PlanningMode, planning_modes
from rf_exp.errors import ArgumentError
from rf_exp.findings import Cause, CheckName, Finding, ParseError, Violation
from rf_exp.geometry import PlanningScene
from rf_exp.statements import Proposal
from rf_exp.tasks import Task, default_of
from rf_exp.types import CONTROL_HZ, ConstraintSet, JointLimits, Occupancy, Scene, Schedule, Trajectory

MAX_DISTURBANCE_RAD = 0.2
MAX_DELAY_S = 5.0
PAUSE_PROBABILITY = 1 / 3  # share of the rests between segments that become pauses


@dataclass(frozen=True)
class Settings:
    """Settings of episode generation. Together with the seed they determine the bytes of the result."""

    task: Task
    constraint_set: ConstraintSet
    brain: BrainSpec
    limits: JointLimits
    attempts: int
    occupancy: Occupancy
    disturbance_rad: float  # of executed motion; see disturb.py
    delay_s: float  # that any one arm may be late without collision; where disturbed, its longest pause

    def __post_init__(self) -> None:
        if not 0 <= self.disturbance_rad <= MAX_DISTURBANCE_RAD:
            possible = f"expected 0 to {MAX_DISTURBANCE_RAD} rad"
            raise ArgumentError(f"disturbance_rad is {self.disturbance_rad}; {possible}")
        if not 0 <= self.delay_s <= MAX_DELAY_S:
            raise ArgumentError(f"delay_s is {self.delay_s}; expected 0 to {MAX_DELAY_S} s")
        if self.attempts < 1:
            raise ArgumentError(f"attempts is {self.attempts}; at least 1 proposal is needed for an episode")

    @classmethod
    def configured(
        cls, task: Task, constraint_set: ConstraintSet, brain: BrainSpec, **changes: Any
    ) -> "Settings":
        """Those of conf/config.yaml, but for `changes`; undisturbed, as only recipes of policies disturb."""
        defaults = {key: default_of(key) for key in ("attempts", "occupancy")}
        defaults |= {"limits": JointLimits(**default_of("limits")), "disturbance_rad": 0.0, "delay_s": 0.0}
        return cls(task, constraint_set, brain, **(defaults | changes))

    def make_brain(self, seed: int) -> Brain:
        return self.brain.make(self.task.in_scene(seed), self.constraint_set, seed)

    def in_scene(self, seed: int) -> "Settings":
        """The same settings with the task as it is in the scene of a seed."""
        return replace(self, task=self.task.in_scene(seed))


@dataclass(frozen=True)
class Planned:
    """A proposal with its motion, which has passed the checks."""

    proposal: Proposal
    checker: RoboChecker  # that passed it
    trajectories: tuple[Trajectory, ...]
    checked: CheckedPlan  # what is executed: the trajectories, or disturbed ones

    @property
    def schedule(self) -> Schedule:
        return self.checked.plan.schedule

    @property
    def executed(self) -> tuple[Trajectory, ...]:
        return self.checked.plan.trajectories


class Planner:
    """Planner of a brain's proposals, under a set of constraints."""

    def __init__(self, settings: Settings, brain: Brain) -> None:
        self._settings, self._brain = settings, brain
        self.proposal: Proposal | None = None  # the last one, as written; None: unreadable

    def plan(
        self, question: Question, scene: Scene, rng: Generator, pauses: Generator | None = None
    ) -> Planned | Violation | None:
        """A plan from `scene` on, the first reason why there is none, or None: the brain proposes nothing.

        With `pauses`, arms pause at random where the settings have a delay.
        """
        task, constraint_set = self._settings.task, self._settings.constraint_set
        self.proposal = None
        try:
            self.proposal = proposal = from_json(self._brain.answer(question), task)
            proposal = allocate_jobs(proposal, task, scene, self._settings.limits)
        except BadAnswer as error:
            return _rejection(CheckName.BRAIN, scene, error)
        except Unreachable as error:
            return _motion_violation(scene, error)
        if not proposal.subgoals:
            return None
        # Without temporal constraints agents take turns as listed; with them the order must not matter.
        queues = canonical_order(proposal, ()) if constraint_set.temporal else proposal
        try:
            checker = RoboChecker(task, queues, constraint_set)
        except ArgumentError as error:
            return _rejection(CheckName.CODE, scene, error)
        queues = canonical_order(queues, checker.order) if constraint_set.temporal else queues
        poses_known = constraint_set.spatial and scene.occupied_voxels is None
        if poses_known and (violation := occupied_place(task, queues, scene)) is not None:
            return violation
        violation = None
        modes, search = planning_modes(queues, scene, constraint_set), Search(rng)
        for mode in modes:
            result = self._motion(queues, checker, scene, mode, search, pauses)
            if isinstance(result, Planned):
                return replace(result, proposal=proposal)
            # The result of a check tells more than that arms in the way leave no path.
            if violation is None or result.check is not CheckName.MOTION:
                violation = result
            if _fails_in_every_mode(result, queues):
                return result
        assert violation is not None  # there is at least one mode
        lists_modes = violation.cause is Cause.SPACE and len(modes) > 1
        return replace(violation, tried=tuple(map(str, modes))) if lists_modes else violation

    def _motion(
        self,
        proposal: Proposal,
        checker: RoboChecker,
        scene: Scene,
        mode: PlanningMode,
        search: Search,
        pauses: Generator | None,
    ) -> Planned | Violation:
        """Trajectories and a schedule that pass all checks, or the first violation."""
        settings = self._settings
        obstacles = Obstacles(settings.task, scene, settings.constraint_set, proposal)
        blocked = obstacles.blocked(avoid_arms=mode.avoid_arms)
        reach = Reach(settings.task.arms, settings.limits, blocked, search)
        plan = partial(plan_motion, lockstep=checker.lockstep, order=checker.order, yielding=mode.yielding)
        try:
            motions = plan(settings.task, proposal, scene, reach)
        except Unreachable as error:
            distance_facts = {} if error.blockage is None else obstacles.distance_facts(error.blockage)
            return _motion_violation(scene, error, **distance_facts)
        trajectories = motions.trajectories
        if checker.speed_limits_m_s:
            trajectories = limit_speeds(
                trajectories, PlanningScene(settings.task, scene).arms, checker.speed_limits_m_s
            )
        paths = checker.paths(trajectories, scene)
        schedule = self._schedule(checker, paths, motions, pauses)
        if isinstance(schedule, Violation):
            return schedule
        checked = checker.check(paths, schedule)
        if checked.violations:
            return checked.violations[0]
        return Planned(proposal, checker, trajectories, checked)

    def _schedule(
        self, checker: RoboChecker, paths: Paths, motions: Motions, pauses: Generator | None
    ) -> Schedule | Violation:
        """The schedule with the whole delay, with half of it, or without, whichever exists first."""
        schedule = partial(checker.schedule, paths, turns=motions.subgoals, extra_rules=motions.handovers)
        steps = round(self._settings.delay_s * CONTROL_HZ)
        if steps:
            may_pause = len(paths.trajectories) > 1  # one arm alone waits for nobody
            pausing = _pauses(paths.trajectories, steps, pauses) if may_pause and pauses is not None else {}
            for slack in (steps, steps // 2):
                result = schedule(Delays(slack, pausing))
                if isinstance(result, Schedule):
                    return result
        return schedule()


def _pauses(trajectories: Sequence[Trajectory], longest: int, rng: Generator) -> dict[tuple[int, int], int]:
    """(agent, knot) -> steps, except at knots within a joint motion of several arms."""
    pauses = {}
    for trajectory in trajectories:
        boundaries = zip(trajectory.segments, trajectory.segments[1:], trajectory.knots[1:], strict=False)
        joint = {
            knot for one, other, knot in boundaries if one.joined is not None and one.joined == other.joined
        }
        for knot in trajectory.knots[:-1]:
            if rng.random() < PAUSE_PROBABILITY and knot not in joint:
                pauses[trajectory.agent, knot] = int(rng.integers(1, longest + 1))
    return pauses


def _fails_in_every_mode(violation: Violation, proposal: Proposal) -> bool:
    """Whether all modes fail alike: arms too close at the start, or obstacles that no other agent moves."""
    if violation.finding not in (Finding.NO_ROOM, Finding.BLOCKED):
        return violation.finding is Finding.CLOSE_AT_FIRST
    movers = {subgoal.agent for subgoal in proposal.subgoals if subgoal.object in violation.obstacles}
    return len(violation.agents) == 1 and movers <= {*violation.agents}


def _motion_violation(scene: Scene, error: Unreachable, **distance_facts: Any) -> Violation:
    facts = {"cause": error.cause, "agents": error.agents, **error.facts, **distance_facts}
    return Violation(check=CheckName.MOTION, time_s=scene.time_s, **facts)


def _rejection(check: CheckName, scene: Scene, error: Exception) -> Violation:
    """Violation for an answer that was not understood, with the parser's message as feedback to RoboBrain."""
    finding = error.finding if isinstance(error, BadAnswer | ParseError) else Finding.REFUSED
    return Violation(finding, check=check, cause=Cause.ANSWER, time_s=scene.time_s, refusal=str(error))
