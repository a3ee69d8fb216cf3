"""Generation of episodes: propose, plan, check, execute, explain, propose again (paper, section 3.1).

Every proposal starts from the scene as measured at that time, so a violation half-way through costs only the
remaining work.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from math import inf
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints.stl import Execution
from rf_exp.coordination import intended_actions, scheduled_actions
from rf_exp.datagen.brain import Brain, FaultyBrain, LanguageBrain, Question, to_json
from rf_exp.datagen.disturb import Disturbance, ObjectMotionWatch, clearance_losses
from rf_exp.datagen.driving import (
    at_last_command,
    come_to_rest_disturbed,
    execute_commands,
    execute_monitored,
    plan_commands,
    with_start,
)
from rf_exp.datagen.planning import Planned, Planner, Settings
from rf_exp.datagen.subgoals import NO_SUBGOAL, Subgoals
from rf_exp.errors import error_context
from rf_exp.findings import Account, Answer, Dialogue, Ruling, Violation
from rf_exp.geometry import PlanningScene
from rf_exp.perception import occupied_voxels
from rf_exp.processes import Timeout, in_order
from rf_exp.sim import CameraSubset, depth_and_segmentation, shared_simulator
from rf_exp.statements import Statement, Step, UnparsedStatement
from rf_exp.tasks import Ledger, SuccessEvaluator, scene_certificate
from rf_exp.transforms import Matrix, quaternion
from rf_exp.types import (
    CONTROL_DT_S,
    CONTROL_HZ,
    DISTURBANCES,
    NO_EXTRAS,
    PLANNING,
    UNITS,
    Episode,
    Extras,
    Judged,
    Measured,
    Pictures,
    Scene,
    SeeingWorld,
    Subgoal,
    Verdict,
)

_MAX_ROUNDS = 12  # successful proposals in a row, at most; a plan that never ends is a failure
_SETTLE_STEPS = 20  # after the last motion, for objects to come to rest and be judged
_MAX_REDUCTIONS = 40  # of the disturbance of a plan, where a check fails, before it stays undisturbed


@dataclass(frozen=True)
class Outcome:
    """Result of one seed. `episode` is set for successes only."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    attempts: int  # proposals that ended in a violation, plus the last one
    contacts: int  # control steps in which arms touched each other
    wall_s: float
    # Violations that ended proposals, contacts between arms, unmet conditions.
    account: Account = field(default_factory=Account)
    episode: Episode | None = None
    dialogue: Dialogue = field(default_factory=Dialogue)  # the answers and their outcomes

    @property
    def violations(self) -> int:
        """Proposals that ended in a violation."""
        return len(self.account.rejections)

    @property
    def reason(self) -> str:
        """The reason of a failure, in words; empty for a success."""
        return "" if self.success else self.account.reason


class Observer(Protocol):
    """Observer of the generation loop, e.g. a recorder. Must not change anything."""

    def planned(self, plan: Planned) -> None:
        pass

    def rejected(self, violation: Violation) -> None:
        pass

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        pass


class NullObserver(Observer):
    """Observer that does nothing."""


class Trace(NullObserver):
    """Observer of the generation loop that keeps an `Execution` of every plan."""

    def __init__(self) -> None:
        self._scenes: list[Scene] = []
        self._plans: list[tuple[Planned, float]] = []  # with the control step of the violation that ended it

    def planned(self, plan: Planned) -> None:
        self._plans.append((plan, inf))

    def rejected(self, violation: Violation) -> None:
        if self._plans:  # a violation before any motion is later than the last plan's end
            plan, stop_step = self._plans.pop()
            self._plans.append((plan, min(stop_step, round(violation.time_s * CONTROL_HZ))))

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        self._scenes.append(scene)

    def executions(self) -> list[tuple[Planned, Execution]]:
        """Every plan with the control steps that its monitor has judged.

        The step that ended in success is not among them, as it is not judged any more.
        """
        executions = []
        for planned, stop_step in self._plans:
            plan, start_step = planned.checked.plan, planned.checked.plan.scene.step
            end_step = min(start_step + len(plan.schedule), stop_step)
            scenes = [scene for scene in self._scenes if start_step < scene.step <= end_step]
            executions.append((planned, Execution(plan, scenes)))
        return executions


@dataclass(frozen=True)
class EpisodeGenerator:
    """Generator of one episode of `settings` in a world. Use one per seed, as a brain is for one episode."""

    settings: Settings
    world: SeeingWorld
    brain: Brain
    observer: Observer = field(default_factory=NullObserver)
    # Returns the arrays stored for each step beside its images (`Episode.extras`).
    extras: Callable[[], Mapping[str, NDArray]] = dict

    def make(
        self, seed: int, lead: Iterable[NDArray[np.float64]] = (), known: Sequence[Iterable[str]] = ()
    ) -> Outcome:
        """Runs the loop from the scene of `seed` to success or to the end of the budget.

        Commands (N, A) of another controller may `lead` to where it begins; their steps are stored with the
        subgoal `NO_SUBGOAL`. `known` subgoals of each agent keep their numbers.
        """
        outcome = _EpisodeRun(self, seed, known).run(lead)
        if isinstance(self.brain, LanguageBrain):
            return replace(outcome, dialogue=self.brain.with_usage(outcome.dialogue))
        return outcome


def missing_constraints(expected: Iterable[Statement], stated: Iterable[Statement]) -> list[Statement]:
    """Constraints `expected` and not `stated` for the same agents and objects; numbers are ignored."""
    stated_keys = {_comparison_key(each) for each in stated}
    return [each for each in expected if _comparison_key(each) not in stated_keys]


def _comparison_key(statement: Statement) -> tuple[object, ...]:
    """Key that is equal for statements that differ only in their numbers or in the order of agents."""
    steps: Iterator[object] = (part for part in vars(statement).values() if isinstance(part, Step))
    words = (part for part in vars(statement).values() if isinstance(part, str))
    return type(statement), frozenset(statement.agents), frozenset(statement.names), *steps, *words


class _Frame(NamedTuple):
    """One control step: observation, intended and executed action, subgoals, and the verdict afterwards."""

    scene: Scene
    intended: NDArray[np.float64]  # (N, A)
    executed: NDArray[np.float64]  # (N, A)
    images: Mapping[str, NDArray[np.uint8]]
    subgoal: NDArray[np.int16]  # (N,)
    extras: Mapping[str, NDArray]
    verdict: Verdict


class _EpisodeRun:
    """Generation of one episode, from the scene of its seed on."""

    def __init__(self, generator: EpisodeGenerator, seed: int, known: Sequence[Iterable[str]]) -> None:
        self._began = time.perf_counter()
        self._nominal_task, self._seed = generator.settings.task, seed
        self._settings = generator.settings.in_scene(seed)
        self._world, self._observer, self._extras = generator.world, generator.observer, generator.extras
        self._planner, self._ledger = Planner(self._settings, generator.brain), Ledger()
        self._answers: list[Answer] = []
        self._frames: list[_Frame] = []
        self._rounds: list[dict[str, object]] = []  # proposals with their checks, and violations, as JSON
        self._perturbations = np.random.default_rng([seed, DISTURBANCES])
        task = self._settings.task
        self._subgoals = Subgoals(len(task.agents), known)
        self._current_subgoals = np.full(len(task.agents), NO_SUBGOAL, np.int16)
        self.scene = self._world.reset(seed)
        self._evaluator = SuccessEvaluator(task, self.scene)
        self._verdict = self._evaluator(self.scene)
        self._object_moved: Violation | None = None

    def run(self, lead: Iterable[NDArray[np.float64]]) -> Outcome:
        for command in lead:
            self.step(command)
        self._current_subgoals = np.zeros_like(self._current_subgoals)
        rejections = self._run_rounds(np.random.default_rng([self._seed, PLANNING]))
        if self.last_command is not None:  # placed objects may still be moving
            execute_commands(self, np.tile(self.last_command, (_SETTLE_STEPS, 1, 1)))
        success = self._verdict.success and not self._object_moved
        intended = [frame.intended for frame in self._frames]
        busy = np.diff(intended, axis=0).any(axis=2).sum(axis=0).tolist() if intended else []
        return Outcome(
            self._seed,
            success,
            any(frame.verdict.success_paper for frame in self._frames),
            len(self._frames),
            len(rejections) + int(success or len(rejections) < self._settings.attempts),
            self._ledger.contacts,
            time.perf_counter() - self._began,
            replace(self._ledger.account(success), rejections=tuple(rejections), refused=self._object_moved),
            self._episode() if success else None,
            Dialogue(tuple(self._answers), busy=tuple(busy)),
        )

    def _run_rounds(self, rng: np.random.Generator) -> list[Violation]:
        """Runs proposals until success or the end of the budget; returns the violations among them."""
        settings, rejections = self._settings, list[Violation]()
        feedback: tuple[Violation, ...] = ()
        completed: tuple[Subgoal, ...] = ()
        for _ in range(_MAX_ROUNDS):
            if len(rejections) >= settings.attempts or self.finished:
                break
            pictures = self._world.images() if self._world.cameras else {}
            question = Question(settings.task, self.scene, pictures, completed, feedback)
            plan = self._plan(question, rng)
            violation = self._execute(plan) if isinstance(plan, Planned) else plan
            self._record_answer(question, plan, violation)
            if violation is not None:
                rejections.append(violation)
                feedback = (violation,)
                self._rounds.append({"violation": {**asdict(violation), "reason": violation.sentence}})
                self._observer.rejected(violation)
            elif isinstance(plan, Planned):
                feedback, completed = (), completed + plan.proposal.subgoals
            else:  # the brain has nothing left to do
                break
        return rejections

    def _record_answer(
        self, question: Question, plan: Planned | Violation | None, violation: Violation | None
    ) -> None:
        """Records the outcome of RoboBrain's answer, compared with the constraints of the scripted plan."""
        ruling = Ruling.NOTHING_LEFT if violation is None else Ruling.REFUSED
        durations = dict[str, float]()
        if isinstance(plan, Planned):
            ruling = Ruling.CARRIED_OUT if violation is None else Ruling.STOPPED
            steps = {"makespan_s": len(plan.schedule), "bound_s": plan.schedule.makespan_bound}
            durations = {name: round(count * CONTROL_DT_S, 3) for name, count in steps.items()}
        stated = self._planner.proposal.constraints if self._planner.proposal is not None else ()
        expected = question.task.module.plan(question.scene, question.task).constraints
        understood = sum(not isinstance(each, UnparsedStatement) for each in stated)
        counts = len(stated), understood, len(expected), len(missing_constraints(expected, stated))
        round_number = 1 + sum(each.ruling is Ruling.CARRIED_OUT for each in self._answers)
        code = violation.code if violation is not None else ""
        self._answers.append(Answer(round_number, ruling, code, *counts, **durations))

    def _plan(self, question: Question, rng: np.random.Generator) -> Planned | Violation | None:
        scene = at_last_command(self._with_occupied_voxels(question.scene), self.last_command)
        pauses = self._perturbations if self._settings.disturbance_rad else None
        plan = self._planner.plan(question, scene, rng, pauses)
        if not isinstance(plan, Planned):
            return plan
        plan = self._disturbed(plan, scene)
        answer = {"proposal": json.loads(to_json(plan.proposal)), "check_code": str(plan.checker.code)}
        self._rounds.append({**answer, **plan.checked.certificate()})
        self._observer.planned(plan)
        return plan

    def _disturbed(self, plan: Planned, scene: Scene) -> Planned:
        """The plan as it will be executed: disturbed, as far as objects and checks permit.

        Checks and monitor then judge the disturbed motion.
        """
        strength_rad = self._settings.disturbance_rad
        if not strength_rad:
            return plan
        disturbance = Disturbance(
            self._settings.task.arms, plan.trajectories, plan.schedule, strength_rad, self._perturbations
        )
        for _ in range(_MAX_REDUCTIONS):
            paths = plan.checker.paths(disturbance.trajectories(), scene)
            places = {*clearance_losses(plan.checked.plan, paths)}
            if not places:
                checked = plan.checker.check(paths, plan.schedule)
                if not checked.violations:
                    return replace(plan, checked=checked)
                places = {at for each in checked.violations for at in self._places_of(each, plan, scene)}
            if not disturbance.reduce(places):
                break
        return plan

    def _places_of(self, violation: Violation, plan: Planned, scene: Scene) -> Iterator[tuple[int, int]]:
        """The agents of a violation of a plan, and their path positions at its time."""
        positions = plan.schedule.positions
        step = np.clip(round(violation.time_s / CONTROL_DT_S) - scene.step, 0, len(positions) - 1)
        for agent in violation.agents or self._settings.task.agents:
            yield agent, int(positions[step, agent - 1])

    def _with_occupied_voxels(self, scene: Scene) -> Scene:
        """The scene with the voxels that depth cameras see now, where spatial constraints use them."""
        settings = self._settings
        if settings.occupancy == "state" or not settings.constraint_set.spatial:
            return scene
        planning_scene = PlanningScene(settings.task, scene)
        voxels = occupied_voxels(self._world.depth(), self._world.camera_models(), planning_scene)
        return replace(scene, occupied_voxels=voxels)

    def _execute(self, plan: Planned) -> Violation | None:
        intended = with_start(plan, intended_actions(plan.trajectories, plan.schedule))
        commands = plan_commands(plan)
        subgoals = self._subgoals.number_steps(plan.trajectories, plan.schedule)
        limits, disturbed = self._settings.limits, self._settings.disturbance_rad > 0
        needs_watch = disturbed or self.scene.clutter
        watch = ObjectMotionWatch(plan.checked.plan, objects=disturbed) if needs_watch else None

        def step(row: int) -> None:
            self._current_subgoals = subgoals[row]
            self._run_step(intended[row], commands[row])
            if watch is not None:
                self._object_moved = watch.unintended_motion(self.scene)

        def stop(row: int) -> None:
            undisturbed = with_start(plan, scheduled_actions(plan.trajectories, plan.schedule))
            for pair in zip(*come_to_rest_disturbed(undisturbed, commands, row, limits), strict=True):
                if self.finished:
                    break
                self._run_step(*pair)

        return execute_monitored(
            self, commands, plan.checked.monitor(), limits, step, stop if disturbed else None
        )

    @property
    def last_command(self) -> NDArray[np.float64] | None:
        """(N, A) the last executed command, if any."""
        return self._frames[-1].executed if self._frames else None

    @property
    def finished(self) -> bool:
        """Whether the episode has succeeded, or cannot any more, as an object was moved unintentionally."""
        return self._verdict.success or self._object_moved is not None

    def step(self, command: NDArray[np.float64]) -> None:
        """One control step whose intended command is the executed one."""
        self._run_step(command, command)

    def _run_step(self, intended: NDArray[np.float64], executed: NDArray[np.float64]) -> None:
        # Rounded as it is stored, so that a replay of the store gives the same episode to the last bit.
        intended, executed = (command.astype(np.float32).astype(float) for command in (intended, executed))
        pictures = self._world.images() if self._world.cameras else {}
        before = self.scene, intended, executed, pictures, self._current_subgoals, self._extras()
        self._observer.stepped(self.scene, intended, pictures)
        self.scene = self._world.step(executed)
        self._verdict = self._evaluator(self.scene)
        self._ledger.record(self.scene, self._verdict)
        self._frames.append(_Frame(*before, self._verdict))

    def _episode(self) -> Episode:
        """The whole episode as a demonstration."""
        task = self._settings.task
        scenes, intended, executed, images, numbers, extras, verdicts = zip(*self._frames, strict=True)
        certificate = {
            "rounds": self._rounds,
            "evidence": dict(verdicts[-1].evidence),
            "subgoals": self._subgoals.texts,
            **scene_certificate(self._nominal_task, self._seed),
        }
        return Episode(
            task.name,
            self._seed,
            np.stack([scene.qpos for scene in scenes]).astype(np.float32),
            np.stack([scene.qvel for scene in scenes]).astype(np.float32),
            np.stack(intended).astype(np.float32),
            {name: np.stack([frame[name] for frame in images]) for name in self._world.cameras},
            certificate,
            np.stack(executed).astype(np.float32) if self._settings.disturbance_rad > 0 else None,
            {name: _poses(np.stack([scene.poses[name] for scene in scenes])) for name in task.objects},
            np.stack(numbers),
            _judged(verdicts),
            {name: np.stack([arrays[name] for arrays in extras]) for name in extras[0]},
        )


def _poses(world_from_object: Matrix) -> NDArray[np.float32]:
    """(T, 4, 4) -> (T, 7) position in m and quaternion w, x, y, z."""
    parts = [world_from_object[:, :3, 3], quaternion(world_from_object)]
    return np.concatenate(parts, axis=1).astype(np.float32)


def _judged(verdicts: Sequence[Verdict]) -> Judged:
    """The value, bound and verdict of every condition of success at each step."""
    names = tuple(verdicts[0].evidence)
    unmeasured = {holds: Measured(holds, float(holds), 1.0, "", True) for holds in (False, True)}
    rows = [[each.measured.get(name, unmeasured[each.evidence[name]]) for name in names] for each in verdicts]
    return Judged(
        names,
        np.array([[each.value for each in row] for row in rows], np.float32),
        np.array([[each.bound for each in row] for row in rows], np.float32),
        np.array([[UNITS.index(each.unit) for each in row] for row in rows], np.uint8),
        np.array([[each.holds for each in row] for row in rows], np.bool_),
    )


def make_episode(
    settings: Settings,
    pictures: Pictures,
    seed: int,
    cameras: Sequence[str] | None = None,
    lead: Iterable[NDArray[np.float64]] = (),
    known: Sequence[Iterable[str]] = (),
    extras: Extras = NO_EXTRAS,
) -> Outcome:
    """One episode, generated in this process, with these cameras, by default those of `pictures`.

    `extras` selects what is stored of depth and segmentation; `lead` and `known` as in
    `EpisodeGenerator.make`.
    The same arguments give the same bytes, whatever ran before.
    """
    cameras = pictures.camera_names(len(settings.task.agents)) if cameras is None else cameras
    world = shared_simulator(settings.task, pictures)  # samples the scene of a seed itself
    read_extras = partial(depth_and_segmentation, world, cameras, extras)
    brain = settings.make_brain(seed)
    with error_context(f"seed {seed}"):
        generator = EpisodeGenerator(settings, CameraSubset(world, cameras), brain, extras=read_extras)
        outcome = generator.make(seed, lead, known)
    if outcome.success and isinstance(brain, FaultyBrain) and not brain.inserted:  # tells nothing about it
        reason = f"the fault {brain.fault.name} was not planted: no plan in this scene has a place for it"
        return replace(outcome, success=False, episode=None, account=Account(ended=reason))
    return outcome


def generate(
    make: Callable[[int], Outcome], seeds: Sequence[int], workers: int, limit_s: float | None = None
) -> Iterator[Outcome]:
    """Outcomes of `seeds` in their order, each made by `make`, in `workers` processes.

    A seed that takes longer than `limit_s` has failed, and the others go on. The caller may stop
    early, which discards seeds under way. Bytes do not depend on `workers`.
    """
    jobs = (partial(make, seed) for seed in seeds)
    for seed, result in zip(seeds, in_order(jobs, workers, limit_s), strict=False):
        if isinstance(result, Timeout):
            account = Account(ended=str(result))
            yield Outcome(
                seed, False, False, steps=0, attempts=1, contacts=0, wall_s=result.limit_s, account=account
            )
        else:
            yield result
