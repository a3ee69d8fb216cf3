"""Planning: RoboBrain proposes, primitives generate motion, RoboChecker schedules and checks it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from numpy.random import Generator

from rf_exp.constraints import CheckedPlan, Paths, RoboChecker, slowed
from rf_exp.coordination import Delays
from rf_exp.datagen.allocation import allocated
from rf_exp.datagen.brain import BadAnswer, Brain, BrainSpec, Question, from_json
from rf_exp.datagen.motion.paths import Search
from rf_exp.datagen.motion.planner import Motions, in_turn, plan_motion
from rf_exp.datagen.motion.reach import Reach
from rf_exp.datagen.motion.state import Unreachable
from rf_exp.datagen.obstacles import Obstacles, taken
from rf_exp.datagen.yielding import Way, ways
from rf_exp.errors import ArgumentError
from rf_exp.findings import Cause, CheckName, Finding, Misread, Violation
from rf_exp.geometry import PlanningScene
from rf_exp.statements import Proposal
from rf_exp.tasks import Task, default_of
from rf_exp.types import CONTROL_HZ, ConstraintSet, JointLimits, Occupancy, Scene, Schedule, Trajectory

LARGEST_DISTURBANCE_RAD = 0.2
LONGEST_DELAY_S = 5.0
PAUSES = 1 / 3  # share of the rests between segments that become pauses


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
        if not 0 <= self.disturbance_rad <= LARGEST_DISTURBANCE_RAD:
            possible = f"expected 0 to {LARGEST_DISTURBANCE_RAD} rad"
            raise ArgumentError(f"disturbance_rad is {self.disturbance_rad}; {possible}")
        if not 0 <= self.delay_s <= LONGEST_DELAY_S:
            raise ArgumentError(f"delay_s is {self.delay_s}; expected 0 to {LONGEST_DELAY_S} s")
        if self.attempts < 1:
            raise ArgumentError(f"attempts is {self.attempts}; at least 1 proposal is needed for an episode")

    @classmethod
    def configured(
        cls, task: Task, constraint_set: ConstraintSet, brain: BrainSpec, **changes: Any
    ) -> "Settings":
        """Those of conf/config.yaml, but for `changes`; undisturbed, as only recipes of policies disturb."""
        said = {key: default_of(key) for key in ("attempts", "occupancy")}
        said |= {"limits": JointLimits(**default_of("limits")), "disturbance_rad": 0.0, "delay_s": 0.0}
        return cls(task, constraint_set, brain, **(said | changes))

    def make_brain(self, seed: int) -> Brain:
        return self.brain.make(self.task.of(seed), self.constraint_set, seed)

    def of(self, seed: int) -> "Settings":
        """The same settings with the task as it is in the scene of a seed."""
        return replace(self, task=self.task.of(seed))


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
            proposal = allocated(proposal, task, scene, self._settings.limits)
        except BadAnswer as error:
            return _refused(CheckName.BRAIN, scene, error)
        except Unreachable as error:
            return _no_motion(scene, error)
        if not proposal.subgoals:
            return None
        # Without temporal constraints agents take turns as listed; with them the order must not matter.
        queues = in_turn(proposal, ()) if constraint_set.temporal else proposal
        try:
            checker = RoboChecker(task, queues, constraint_set)
        except ArgumentError as error:
            return _refused(CheckName.CODE, scene, error)
        queues = in_turn(queues, checker.order) if constraint_set.temporal else queues
        known = constraint_set.spatial and scene.seen is None  # whether object poses are known
        if known and (violation := taken(task, queues, scene)) is not None:
            return violation
        violation = None
        tried, search = ways(queues, scene, constraint_set), Search(rng)
        for way in tried:
            result = self._motion(queues, checker, scene, way, search, pauses)
            if isinstance(result, Planned):
                return replace(result, proposal=proposal)
            # The result of a check tells more than that arms in the way leave no path.
            if violation is None or result.check is not CheckName.MOTION:
                violation = result
            if _in_every_way(result, queues):
                return result
        assert violation is not None  # there is at least one way
        several = violation.cause is Cause.SPACE and len(tried) > 1
        return replace(violation, tried=tuple(map(str, tried))) if several else violation

    def _motion(
        self,
        proposal: Proposal,
        checker: RoboChecker,
        scene: Scene,
        way: Way,
        search: Search,
        pauses: Generator | None,
    ) -> Planned | Violation:
        """Trajectories and a schedule that pass all checks, or the first violation."""
        settings = self._settings
        obstacles = Obstacles(settings.task, scene, settings.constraint_set, proposal)
        blocked = obstacles.blocked(avoid_arms=way.avoid_arms)
        reach = Reach(settings.task.arms, settings.limits, blocked, search)
        motion = partial(plan_motion, lockstep=checker.lockstep, order=checker.order, yielding=way.yielding)
        try:
            motions = motion(settings.task, proposal, scene, reach)
        except Unreachable as error:
            near = {} if error.blockage is None else obstacles.how_near(error.blockage)
            return _no_motion(scene, error, **near)
        trajectories = motions.trajectories
        if checker.speeds_m_s:
            trajectories = slowed(trajectories, PlanningScene(settings.task, scene).arms, checker.speeds_m_s)
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
        schedule = partial(checker.schedule, paths, turns=motions.subgoals, also=motions.handovers)
        steps = round(self._settings.delay_s * CONTROL_HZ)
        if steps:
            several = len(paths.trajectories) > 1  # one arm alone waits for nobody
            pausing = _pauses(paths.trajectories, steps, pauses) if several and pauses is not None else {}
            for slack in (steps, steps // 2):
                timed = schedule(Delays(slack, pausing))
                if isinstance(timed, Schedule):
                    return timed
        return schedule()


def _pauses(trajectories: Sequence[Trajectory], longest: int, rng: Generator) -> dict[tuple[int, int], int]:
    """(agent, knot) -> steps, except at knots within a joint motion of several arms."""
    found = {}
    for trajectory in trajectories:
        runs = zip(trajectory.segments, trajectory.segments[1:], trajectory.knots[1:], strict=False)
        amid = {knot for one, other, knot in runs if one.joined is not None and one.joined == other.joined}
        for knot in trajectory.knots[:-1]:
            if rng.random() < PAUSES and knot not in amid:
                found[trajectory.agent, knot] = int(rng.integers(1, longest + 1))
    return found


def _in_every_way(violation: Violation, proposal: Proposal) -> bool:
    """Whether all ways fail alike: arms too close at the start, or obstacles that no other agent moves."""
    if violation.finding not in (Finding.NO_ROOM, Finding.BLOCKED):
        return violation.finding is Finding.CLOSE_AT_FIRST
    movers = {each.agent for each in proposal.subgoals if each.object in violation.obstacles}
    return len(violation.agents) == 1 and movers <= {*violation.agents}


def _no_motion(scene: Scene, error: Unreachable, **near: Any) -> Violation:
    about = {"cause": error.cause, "agents": error.agents, **error.facts, **near}
    return Violation(check=CheckName.MOTION, time_s=scene.time_s, **about)


def _refused(check: CheckName, scene: Scene, error: Exception) -> Violation:
    """Violation for an answer that was not understood, with the parser's message as feedback to RoboBrain."""
    finding = error.finding if isinstance(error, BadAnswer | Misread) else Finding.REFUSED
    return Violation(finding, check=check, cause=Cause.ANSWER, time_s=scene.time_s, refusal=str(error))
