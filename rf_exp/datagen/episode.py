"""The generation loop of one episode: propose, plan, check, execute, explain, propose again.

Paper, section 3.1. Every proposal starts from the scene as it is measured then, so a violation
half-way through costs what is left, not what is done.
"""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import actions, intended
from rf_exp.datagen.brain import Brain, Question, to_json
from rf_exp.datagen.knocks import Knocks
from rf_exp.datagen.motion import come_to_rest, disturb, let_off
from rf_exp.datagen.planning import Planned, Planner, Settings
from rf_exp.datagen.subgoals import NOBODYS, Subgoals
from rf_exp.findings import Account, CheckName, Violation
from rf_exp.geometry import Bodies
from rf_exp.perception import look
from rf_exp.tasks import Judge
from rf_exp.tasks.account import Ledger
from rf_exp.transforms import Matrix, quaternion
from rf_exp.types import (
    ARM_JOINTS,
    CONTROL_DT_S,
    UNITS,
    Episode,
    Judged,
    Measured,
    Scene,
    SeeingWorld,
    Subgoal,
    Verdict,
)

_ROUNDS = 12  # proposals that may succeed one after the other; a plan that never ends is a failure
_SETTLE_STEPS = 20  # after the last motion, for things to come to rest and be judged
_CALMER = 8  # times that a plan is disturbed less, where its checks object, before it is not at all


@dataclass(frozen=True)
class Outcome:
    """What became of one seed. `episode` is there for successes only."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    attempts: int  # proposals that ended in a violation, plus the last one
    contacts: int  # control steps in which arms touched each other
    wall_s: float
    account: Account = field(
        default_factory=Account
    )  # which violations ended proposals, which arms touched, what failed
    episode: Episode | None = None

    @property
    def violations(self) -> int:
        """Proposals that ended in a violation."""
        return len(self.account.rejections)

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty for a success."""
        return "" if self.success else self.account.reason


class Observer(Protocol):
    """Looks on while an episode is made, e.g. to record it. Must not change anything."""

    def planned(self, plan: Planned) -> None: ...

    def rejected(self, violation: Violation) -> None: ...

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None: ...


class Nobody:
    """The observer that looks away."""

    def planned(self, plan: Planned) -> None:
        pass

    def rejected(self, violation: Violation) -> None:
        pass

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        pass


class _Frame(NamedTuple):
    """One control step: what was seen, what was intended then, what was done, and what for."""

    scene: Scene
    action: NDArray[np.float64]  # (N, 8)
    executed: NDArray[np.float64]  # (N, 8)
    pictures: Mapping[str, NDArray[np.uint8]]
    subgoal: NDArray[np.int16]  # (N,)
    images: Mapping[str, NDArray]


class EpisodeMaker:
    """Makes one episode of `settings` in a world. One object for one seed."""

    def __init__(
        self,
        settings: Settings,
        world: SeeingWorld,
        brain: Brain,
        observer: Observer | None = None,
        images: Callable[[], Mapping[str, NDArray]] = dict,
    ) -> None:
        """`images` takes what an episode holds of each step beside its pictures (`Episode.images`)."""
        self._settings, self._world, self._planner = settings, world, Planner(settings, brain)
        self._observer: Observer = observer or Nobody()
        self._images = images
        self._frames: list[_Frame] = []
        self._verdicts: list[Verdict] = []  # on what each frame has led to
        self._rounds: list[dict[str, object]] = []
        self._ledger = Ledger()

    def make(
        self, seed: int, lead: Iterable[NDArray[np.float64]] = (), known: Sequence[Iterable[str]] = ()
    ) -> Outcome:
        """Runs the loop from the scene of `seed` to success or to the end of the budget.

        Before that, commands (N, 8) of somebody else may `lead` to where it begins; their steps are stored as
        nobody's subgoal. What is `known` of each agent's subgoals keeps its number.
        """
        began = time.perf_counter()
        settings = self._settings
        scene = self._world.reset(seed)
        self._judge = Judge(settings.task, scene)
        self._verdict = self._judge(scene)
        self._paper = False
        self._subgoals = Subgoals(len(settings.task.agents), known)
        self._doing = np.full(len(settings.task.agents), NOBODYS, np.int16)
        self._knocked: Violation | None = None
        for command in lead:
            scene = self._step(scene, command, command)
        self._doing = np.zeros_like(self._doing)
        rng = np.random.default_rng([seed, 1])  # stream 1 of the episode: planning
        self._bumps = np.random.default_rng([seed, 2])  # stream 2: disturbances
        feedback: tuple[Violation, ...] = ()
        done: tuple[Subgoal, ...] = ()
        rejections: list[Violation] = []
        for _ in range(_ROUNDS):
            if len(rejections) >= settings.attempts or self._verdict.success or self._knocked:
                break
            question = Question(
                settings.task, scene, self._world.pictures() if self._world.cameras else {}, done, feedback
            )
            result = self._plan(question, rng)
            if result is None:  # the brain has nothing left to do
                break
            if isinstance(result, Planned):
                scene, violation = self._execute(result, scene)
            else:
                violation = result
            if violation is None:
                feedback, done = (), done + (result.proposal.subgoals if isinstance(result, Planned) else ())
                continue
            rejections.append(violation)
            feedback = (violation,)
            self._rounds.append({"violation": {**asdict(violation), "reason": violation.sentence}})
            self._observer.rejected(violation)
        if not self._verdict.success and not self._knocked:
            scene = self._settle(scene)
        success = self._verdict.success and not self._knocked
        return Outcome(
            seed,
            success,
            self._paper,
            len(self._frames),
            len(rejections) + int(success or len(rejections) < settings.attempts),
            self._ledger.contacts,
            time.perf_counter() - began,
            replace(self._ledger.account(), rejections=tuple(rejections), refused=self._knocked),
            self._episode(seed) if success else None,
        )

    # -- planning --------------------------------------------------------------------------------

    def _plan(self, question: Question, rng: np.random.Generator) -> Planned | Violation | None:
        scene = self._as_commanded(self._looked_at(question.scene))
        plan = self._planner.plan(
            question, scene, rng, self._bumps if self._settings.disturbance_rad else None
        )
        if not isinstance(plan, Planned):
            return plan
        plan = self._disturbed(plan, scene)
        self._rounds.append(
            {
                "proposal": json.loads(to_json(plan.proposal)),
                "check_code": str(plan.checker.code),
                **plan.checked.certificate(),
            }
        )
        self._observer.planned(plan)
        return plan

    def _disturbed(self, plan: Planned, scene: Scene) -> Planned:
        """The plan as it will be executed: disturbed, but for where its checks object to that.

        The disturbed motion is then the plan that was checked, and that is monitored.
        """
        strength_rad = self._settings.disturbance_rad
        if not strength_rad:
            return plan
        state, positions = self._bumps.bit_generator.state, plan.schedule.positions
        calm: dict[int, set[int]] = {agent: set() for agent in self._settings.task.agents}
        for _ in range(_CALMER):
            self._bumps.bit_generator.state = state  # the same bumps, with fewer of them left
            executed = disturb(plan.trajectories, strength_rad, self._bumps, calm)
            checked = plan.checker.check(plan.checker.paths(executed, scene), plan.schedule)
            if not checked.violations:
                return replace(plan, checked=checked)
            for each in checked.violations:
                now = round(each.time_s / CONTROL_DT_S) - scene.step
                for agent in each.agents or self._settings.task.agents:
                    calm[agent].add(int(positions[np.clip(now, 0, len(positions) - 1), agent - 1]))
        return plan

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
        command = self._frames[-1].executed
        return replace(scene, qpos=np.hstack([command[:, :ARM_JOINTS], scene.qpos[:, ARM_JOINTS:]]))

    # -- execution -------------------------------------------------------------------------------

    def _execute(self, plan: Planned, scene: Scene) -> tuple[Scene, Violation | None]:
        start = np.stack([trajectory.path()[0] for trajectory in plan.trajectories])
        meant, commands = (
            np.concatenate([start[None], each])
            for each in (intended(plan.trajectories, plan.schedule), actions(plan.executed, plan.schedule))
        )
        doing = self._subgoals.of_plan(plan.trajectories, plan.schedule)
        monitor = plan.checked.monitor()
        watch = Knocks(plan.checked.plan) if self._settings.disturbance_rad else None
        for now in range(1, len(commands)):
            self._doing = doing[now]
            scene = self._step(scene, meant[now], commands[now])
            if watch is not None:
                self._knocked = watch.knocked(scene)
            if self._verdict.success or self._knocked:
                break
            violation = monitor(scene)
            if violation is not None:
                return self._stop(scene, commands, now, violation), violation
        return scene, None

    def _stop(self, scene: Scene, commands: NDArray[np.float64], now: int, violation: Violation) -> Scene:
        """Everybody comes to rest along the plan; arms that have hit something then no longer push."""
        limits = self._settings.limits
        scene = self._follow(scene, come_to_rest(commands, now, limits))
        if violation.check is CheckName.COLLISION:
            scene = self._follow(
                scene, let_off(self._frames[-1].executed, scene.qpos, violation.agents, limits)
            )
        return scene

    def _follow(self, scene: Scene, commands: NDArray[np.float64]) -> Scene:
        """Carries out commands (K, N, 8) unless success comes before."""
        for command in commands:
            if self._verdict.success:
                break
            scene = self._step(scene, command, command)
        return scene

    def _settle(self, scene: Scene) -> Scene:
        """Holds still for a while: what was put down may need a moment to come to rest."""
        if not self._frames:
            return scene
        return self._follow(scene, np.tile(self._frames[-1].executed, (_SETTLE_STEPS, 1, 1)))

    def _step(self, scene: Scene, action: NDArray[np.float64], executed: NDArray[np.float64]) -> Scene:
        # What is stored is what was done, to the last bit: a replay of the store gives the same episode.
        action, executed = (each.astype(np.float32).astype(float) for each in (action, executed))
        pictures = self._world.pictures() if self._world.cameras else {}
        self._frames.append(_Frame(scene, action, executed, pictures, self._doing, self._images()))
        self._observer.stepped(scene, action, pictures)
        scene = self._world.step(executed)
        self._verdict = self._judge(scene)
        self._ledger.see(scene, self._verdict)
        self._verdicts.append(self._verdict)
        self._paper = self._paper or self._verdict.success_paper
        return scene

    # -- the result ------------------------------------------------------------------------------

    def _episode(self, seed: int) -> Episode:
        scenes, intended, executed, pictures, subgoals, images = zip(*self._frames, strict=True)
        certificate = {
            "rounds": self._rounds,
            "evidence": dict(self._verdict.evidence),
            "subgoals": self._subgoals.texts,
        }
        return Episode(
            self._settings.task.name,
            seed,
            np.stack([scene.qpos for scene in scenes]).astype(np.float32),
            np.stack([scene.qvel for scene in scenes]).astype(np.float32),
            np.stack(intended).astype(np.float32),
            {name: np.stack([frame[name] for frame in pictures]) for name in self._world.cameras},
            certificate,
            np.stack(executed).astype(np.float32) if self._settings.disturbance_rad else None,
            {
                name: _poses(np.stack([scene.poses[name] for scene in scenes]))
                for name in self._settings.task.objects
            },
            np.stack(subgoals),
            _judged(self._verdicts),
            {name: np.stack([taken[name] for taken in images]) for name in images[0]},
        )


def _poses(world_from_object: Matrix) -> NDArray[np.float32]:
    """(T, 4, 4) -> (T, 7) position in m and quaternion w, x, y, z."""
    parts = [world_from_object[:, :3, 3], quaternion(world_from_object)]
    return np.concatenate(parts, axis=1).astype(np.float32)


def _judged(verdicts: Sequence[Verdict]) -> Judged:
    """How far each condition was met, step by step."""
    names = tuple(verdicts[0].evidence)
    found = [
        [verdict.measured.get(name) or _yes_or_no(verdict.evidence[name]) for name in names]
        for verdict in verdicts
    ]
    return Judged(
        names,
        np.array([[each.value for each in row] for row in found], np.float32),
        np.array([[each.bound for each in row] for row in found], np.float32),
        np.array([[UNITS.index(each.unit) for each in row] for row in found], np.uint8),
        np.array([[each.holds for each in row] for row in found], np.bool_),
    )


def _yes_or_no(holds: bool) -> Measured:
    return Measured(holds, float(holds), 1.0, "", True)
