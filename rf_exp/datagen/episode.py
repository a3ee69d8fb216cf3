"""The generation loop of one episode: propose, plan, check, execute, explain, propose again.

Paper, section 3.1. Every proposal starts from the scene as it is measured then, so a violation
half-way through costs what is left, not what is done.
"""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import Bodies, CheckCode, RoboChecker, actions
from rf_exp.constraints.depth import look
from rf_exp.datagen.brain import BadAnswer, Brain, BrainSpec, Question, from_json, to_json
from rf_exp.datagen.motion import Posture, Unreachable, come_to_rest, let_off, plan_motion
from rf_exp.datagen.obstacles import Obstacles
from rf_exp.errors import ArgumentError
from rf_exp.tasks import Judge, Task
from rf_exp.types import (
    ARM_JOINTS,
    COLLISION,
    CONTROL_DT_S,
    MOTION,
    Cause,
    Episode,
    JointLimits,
    Occupancy,
    Proposal,
    Row,
    Scene,
    Schedule,
    SeeingWorld,
    Subgoal,
    Trajectory,
    Violation,
)

_ROUNDS = 12  # proposals that may succeed one after the other; a plan that never ends is a failure
_SETTLE_STEPS = 20  # after the last motion, for things to come to rest and be judged


@dataclass(frozen=True)
class Settings:
    """How episodes are made. All of it decides the bytes of the result, together with the seed."""

    task: Task
    row: Row
    brain: BrainSpec
    limits: JointLimits = field(default_factory=JointLimits)
    attempts: int = 4
    occupancy: Occupancy = "state"

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise ArgumentError(f"attempts is {self.attempts}; at least 1 proposal is needed for an episode")

    def make_brain(self, seed: int) -> Brain:
        """The brain for one episode."""
        return self.brain.make(self.task, self.row, seed)


@dataclass(frozen=True)
class Outcome:
    """What became of one seed. `episode` is there for successes only."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    attempts: int  # proposals that ended in a violation, plus the last one
    violations: int  # proposals that ended in a violation
    contacts: int  # control steps in which arms touched each other
    reason: str  # empty for a success
    wall_s: float
    episode: Episode | None = None


@dataclass(frozen=True)
class Plan:
    """A proposal that has become motion and has passed its checks."""

    proposal: Proposal
    code: CheckCode
    trajectories: tuple[Trajectory, ...]
    schedule: Schedule


class Observer(Protocol):
    """Looks on while an episode is made, e.g. to record it. Must not change anything."""

    def planned(self, plan: Plan, checker: RoboChecker) -> None: ...

    def rejected(self, violation: Violation) -> None: ...

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None: ...


class Nobody:
    """The observer that looks away."""

    def planned(self, plan: Plan, checker: RoboChecker) -> None:
        pass

    def rejected(self, violation: Violation) -> None:
        pass

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        pass


class EpisodeMaker:
    """Makes one episode of `settings` in a world. One object for one seed."""

    def __init__(
        self, settings: Settings, world: SeeingWorld, brain: Brain, observer: Observer | None = None
    ) -> None:
        self._settings, self._world, self._brain = settings, world, brain
        self._observer: Observer = observer or Nobody()
        self._frames: list[tuple[Scene, NDArray[np.float64], dict[str, NDArray[np.uint8]]]] = []
        self._rounds: list[dict[str, object]] = []
        self._contacts = 0

    def make(self, seed: int) -> Outcome:
        """Runs the loop from the scene of `seed` to success or to the end of the budget."""
        began = time.perf_counter()
        settings = self._settings
        scene = self._world.reset(seed)
        self._judge = Judge(settings.task, scene)
        self._verdict = self._judge(scene)
        self._paper = False
        rng = np.random.default_rng([seed, 1])  # stream 1 of the episode: planning
        feedback: tuple[Violation, ...] = ()
        done: tuple[Subgoal, ...] = ()
        reasons: list[str] = []  # of the violations
        for _ in range(_ROUNDS):
            if len(reasons) >= settings.attempts or self._verdict.success:
                break
            question = Question(
                settings.task, scene, self._world.pictures() if self._world.cameras else {}, done, feedback
            )
            result = self._plan(question, rng)
            if result is None:  # the brain has nothing left to do
                break
            if isinstance(result, Plan):
                scene, violation = self._execute(result, scene)
            else:
                violation = result
            if violation is None:
                feedback, done = (), done + (result.proposal.subgoals if isinstance(result, Plan) else ())
                continue
            reasons.append(violation.reason)
            feedback = (violation,)
            self._rounds.append({"violation": _violation_json(violation)})
            self._observer.rejected(violation)
        if not self._verdict.success:
            scene = self._settle(scene)
        success = self._verdict.success
        return Outcome(
            seed,
            success,
            self._paper,
            len(self._frames),
            len(reasons) + int(success or len(reasons) < settings.attempts),
            len(reasons),
            self._contacts,
            "" if success else self._why(reasons),
            time.perf_counter() - began,
            self._episode(seed) if success else None,
        )

    # -- planning --------------------------------------------------------------------------------

    def _plan(self, question: Question, rng: np.random.Generator) -> Plan | Violation | None:
        task, row = self._settings.task, self._settings.row
        scene = self._as_commanded(self._looked_at(question.scene))
        try:
            proposal = from_json(self._brain.answer(question), task)
        except BadAnswer as error:
            return _refused("RoboBrain", "answer", (), scene, str(error))
        if not proposal.subgoals:
            return None
        checker = RoboChecker(task, proposal, row, scene.step * CONTROL_DT_S)
        if isinstance(checker.code, Violation):
            return checker.code
        violation: Violation | None = None
        for way in _ways(row):
            result = self._motion(proposal, checker, scene, way, rng)
            if isinstance(result, Plan):
                self._checker = checker
                self._rounds.append(
                    {
                        "proposal": json.loads(to_json(proposal)),
                        "check_code": str(checker.code),
                        **checker.certificate(),
                    }
                )
                self._observer.planned(result, checker)
                return result
            # Of two reasons, that arms in the way leave no path says less than what a check has found.
            if violation is None or result.check != MOTION:
                violation = result
        return violation

    def _motion(
        self,
        proposal: Proposal,
        checker: RoboChecker,
        scene: Scene,
        way: "_Way",
        rng: np.random.Generator,
    ) -> Plan | Violation:
        """Trajectories and a schedule that pass all checks, or the first reason why not."""
        settings = self._settings
        assert isinstance(checker.code, CheckCode)
        obstacles = Obstacles(settings.task, scene, settings.row, proposal)
        try:
            trajectories, _ = plan_motion(
                settings.task,
                proposal,
                scene,
                blocked=obstacles.blocked(avoid_arms=way.avoid_parked),
                limits=settings.limits,
                lockstep=checker.lockstep,
                order=checker.order,
                make_room=checker.makes_room,
                back=way.back,
                idle_too=way.idle_too,
                rng=rng,
            )
        except Unreachable as error:
            return _refused(MOTION, error.cause, error.agents, scene, str(error))
        schedule = checker.schedule(trajectories, scene)
        if isinstance(schedule, Violation):
            return schedule
        violations = checker.check(trajectories, schedule, scene)
        return violations[0] if violations else Plan(proposal, checker.code, trajectories, schedule)

    def _looked_at(self, scene: Scene) -> Scene:
        """The scene with what the depth cameras see now, where spatial constraints ask for it."""
        settings = self._settings
        if settings.occupancy == "state" or not settings.row.spatial:
            return scene
        bodies = Bodies(settings.task, scene)
        return replace(scene, seen=look(self._world.depth(), self._world.camera_models(), bodies))

    def _as_commanded(self, scene: Scene) -> Scene:
        """The scene with the arms where they were last sent.

        They trail their targets a little; motion that began at the measured joints would jerk back.
        """
        if not self._frames:
            return scene
        command = self._frames[-1][1]
        return replace(scene, qpos=np.hstack([command[:, :ARM_JOINTS], scene.qpos[:, ARM_JOINTS:]]))

    # -- execution -------------------------------------------------------------------------------

    def _execute(self, plan: Plan, scene: Scene) -> tuple[Scene, Violation | None]:
        start = np.stack([trajectory.path()[0] for trajectory in plan.trajectories])
        commands = np.concatenate([start[None], actions(plan.trajectories, plan.schedule)])
        for now in range(1, len(commands)):
            scene = self._step(scene, commands[now])
            if self._verdict.success:
                break
            violation = self._checker.monitor(scene)
            if violation is not None:
                return self._stop(scene, commands, now, violation), violation
        return scene, None

    def _stop(self, scene: Scene, commands: NDArray[np.float64], now: int, violation: Violation) -> Scene:
        """Everybody comes to rest along the plan; arms that have hit something then no longer push."""
        limits = self._settings.limits
        scene = self._follow(scene, come_to_rest(commands, now, limits))
        if violation.check == COLLISION:
            scene = self._follow(scene, let_off(self._frames[-1][1], scene.qpos, violation.agents, limits))
        return scene

    def _follow(self, scene: Scene, commands: NDArray[np.float64]) -> Scene:
        """Carries out commands (K, N, 8) unless success comes before."""
        for command in commands:
            if self._verdict.success:
                break
            scene = self._step(scene, command)
        return scene

    def _settle(self, scene: Scene) -> Scene:
        """Holds still for a while: what was put down may need a moment to come to rest."""
        if not self._frames:
            return scene
        return self._follow(scene, np.tile(self._frames[-1][1], (_SETTLE_STEPS, 1, 1)))

    def _step(self, scene: Scene, action: NDArray[np.float64]) -> Scene:
        # What is stored is what was done, to the last bit: a replay of the store gives the same episode.
        action = action.astype(np.float32).astype(float)
        pictures = self._world.pictures() if self._world.cameras else {}
        self._frames.append((scene, action, pictures))
        self._observer.stepped(scene, action, pictures)
        scene = self._world.step(action)
        self._contacts += bool(scene.arm_contacts)
        self._verdict = self._judge(scene)
        self._paper = self._paper or self._verdict.success_paper
        return scene

    # -- the result ------------------------------------------------------------------------------

    def _why(self, reasons: Sequence[str]) -> str:
        missing = [name for name, holds in self._verdict.evidence.items() if not holds]
        physical = f"not {', not '.join(missing)}" if missing else "success was not held long enough"
        if not reasons:
            return physical
        # The first says what went wrong; the last, why that could not be mended any more.
        last = f"; the last: {reasons[-1]}" if reasons[-1] != reasons[0] else ""
        return f"{physical}; the first violation of {len(reasons)}: {reasons[0]}{last}"

    def _episode(self, seed: int) -> Episode:
        scenes, actions, pictures = zip(*self._frames, strict=True)
        return Episode(
            self._settings.task.name,
            seed,
            np.stack([scene.qpos for scene in scenes]).astype(np.float32),
            np.stack([scene.qvel for scene in scenes]).astype(np.float32),
            np.stack(actions).astype(np.float32),
            {name: np.stack([frame[name] for frame in pictures]) for name in self._world.cameras},
            {"rounds": self._rounds, "evidence": dict(self._verdict.evidence)},
        )


class _Way(NamedTuple):
    """How to plan a proposal."""

    avoid_parked: bool  # whether paths go round arms that stand still
    back: Posture = "home"  # where an arm draws back to when it is done
    idle_too: bool = False  # whether arms that have nothing to do go aside first


def _ways(row: Row) -> Sequence[_Way]:
    """The ways to plan, the best first."""
    if not row.spatial:
        return [_Way(False)]
    if not row.temporal:
        return [_Way(True), _Way(True, idle_too=True)]
    # Who knows when arms move may pass one before it is in the way, and may send it farther off.
    return [_Way(False), _Way(True), _Way(False, "aside", idle_too=True)]


def _violation_json(violation: Violation) -> dict[str, object]:
    return {
        "check": violation.check,
        "cause": violation.cause,
        "agents": list(violation.agents),
        "time_s": violation.time_s,
        "value": violation.value,
        "bound": violation.bound,
        "reason": violation.reason,
    }


def _refused(check: str, cause: Cause, agents: tuple[int, ...], scene: Scene, reason: str) -> Violation:
    return Violation(check, cause, agents, scene.step * CONTROL_DT_S, 0.0, 0.0, reason)
