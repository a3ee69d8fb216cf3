"""The generation loop of one episode: propose, plan, check, execute, explain, propose again.

Paper, section 3.1. Every proposal starts from the scene as it is measured then, so a violation
half-way through costs what is left, not what is done.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.coordination import actions, intended
from rf_exp.datagen.brain import Brain, Question, to_json
from rf_exp.datagen.driving import commands_of, drive, follow, from_start
from rf_exp.datagen.episode.log import EpisodeLog, Frame
from rf_exp.datagen.episode.object_motion import ObjectMotionWatch, nearer
from rf_exp.datagen.episode.observer import NullObserver, Observer
from rf_exp.datagen.episode.outcome import Outcome
from rf_exp.datagen.motion import Disturbance, as_commanded, come_to_rest_disturbed
from rf_exp.datagen.planning import Planned, Planner, Settings
from rf_exp.datagen.subgoals import NOBODYS, Subgoals
from rf_exp.findings import Violation
from rf_exp.geometry import PlanningScene
from rf_exp.perception import look
from rf_exp.tasks import Ledger, SuccessEvaluator, Task, scene_certificate
from rf_exp.types import CONTROL_DT_S, DISTURBANCES, PLANNING, Episode, Scene, SeeingWorld, Subgoal

_ROUNDS = 12  # proposals that may succeed one after the other; a plan that never ends is a failure
_SETTLE_STEPS = 20  # after the last motion, for things to come to rest and be judged
_CALMER = 40  # times that a plan is disturbed less, where something objects, before it is not at all


class EpisodeMaker:
    """Makes one episode of `settings` in a world. One object for one seed: a brain is of one episode."""

    def __init__(
        self,
        settings: Settings,
        world: SeeingWorld,
        brain: Brain,
        observer: Observer | None = None,
        extras: Callable[[], Mapping[str, NDArray]] = dict,
    ) -> None:
        """`extras` takes what an episode holds of each step beside its images (`Episode.extras`)."""
        self._settings, self._world, self._brain = settings, world, brain
        self._observer: Observer = observer or NullObserver()
        self._extras = extras

    def make(
        self, seed: int, lead: Iterable[NDArray[np.float64]] = (), known: Sequence[Iterable[str]] = ()
    ) -> Outcome:
        """Runs the loop from the scene of `seed` to success or to the end of the budget.

        Before that, commands (N, A) of somebody else may `lead` to where it begins; their steps are stored as
        nobody's subgoal. What is `known` of each agent's subgoals keeps its number.
        """
        settings = self._settings.of(seed)
        planner, usual = Planner(settings, self._brain), self._settings.task
        making = _Making(settings, usual, self._world, planner, self._observer, self._extras, seed, known)
        return making.run(lead)


class _Making:
    """One episode while it is made, from the scene of its seed on."""

    def __init__(
        self,
        settings: Settings,
        usual: Task,
        world: SeeingWorld,
        planner: Planner,
        observer: Observer,
        extras: Callable[[], Mapping[str, NDArray]],
        seed: int,
        known: Sequence[Iterable[str]],
    ) -> None:
        self._began = time.perf_counter()
        self._settings, self._usual = settings, usual
        self._world, self._planner = world, planner
        self._observer, self._extras, self._seed = observer, extras, seed
        self._log, self._ledger = EpisodeLog(), Ledger()
        self._perturbations = np.random.default_rng([seed, DISTURBANCES])
        self._subgoals = Subgoals(len(settings.task.agents), known)
        self._doing = np.full(len(settings.task.agents), NOBODYS, np.int16)
        self.scene = world.reset(seed)
        self._judge = SuccessEvaluator(settings.task, self.scene)
        self._verdict = self._judge(self.scene)
        self._paper = False
        self._object_moved: Violation | None = None

    def run(self, lead: Iterable[NDArray[np.float64]]) -> Outcome:
        """`EpisodeMaker.make`."""
        for command in lead:
            self.take(command)
        self._doing = np.zeros_like(self._doing)
        rejections = self._rounds(np.random.default_rng([self._seed, PLANNING]))
        if self.told is not None:  # what was put down may need a moment to come to rest
            follow(self, np.tile(self.told, (_SETTLE_STEPS, 1, 1)))
        success = self._verdict.success and not self._object_moved
        return Outcome(
            self._seed,
            success,
            self._paper,
            len(self._log.frames),
            len(rejections) + int(success or len(rejections) < self._settings.attempts),
            self._ledger.contacts,
            time.perf_counter() - self._began,
            replace(self._ledger.account(), rejections=tuple(rejections), refused=self._object_moved),
            self._episode() if success else None,
        )

    def _rounds(self, rng: np.random.Generator) -> list[Violation]:
        """Proposals until it is done or the budget is: what ended some of them."""
        settings, rejections = self._settings, list[Violation]()
        feedback: tuple[Violation, ...] = ()
        done: tuple[Subgoal, ...] = ()
        for _ in range(_ROUNDS):
            if len(rejections) >= settings.attempts or self.over:
                break
            pictures = self._world.images() if self._world.cameras else {}
            result = self._plan(Question(settings.task, self.scene, pictures, done, feedback), rng)
            if result is None:  # the brain has nothing left to do
                break
            violation = result if isinstance(result, Violation) else None
            if isinstance(result, Planned):
                violation = self._execute(result)
                if violation is None:
                    feedback, done = (), done + result.proposal.subgoals
            if violation is not None:
                rejections.append(violation)
                feedback = (violation,)
                self._log.rounds.append({"violation": {**asdict(violation), "reason": violation.sentence}})
                self._observer.rejected(violation)
        return rejections

    # -- planning --------------------------------------------------------------------------------

    def _plan(self, question: Question, rng: np.random.Generator) -> Planned | Violation | None:
        scene = as_commanded(self._looked_at(question.scene), self.told)
        plan = self._planner.plan(
            question, scene, rng, self._perturbations if self._settings.disturbance_rad else None
        )
        if not isinstance(plan, Planned):
            return plan
        plan = self._disturbed(plan, scene)
        self._log.rounds.append(
            {
                "proposal": json.loads(to_json(plan.proposal)),
                "check_code": str(plan.checker.code),
                **plan.checked.certificate(),
            }
        )
        self._observer.planned(plan)
        return plan

    def _disturbed(self, plan: Planned, scene: Scene) -> Planned:
        """The plan as it will be executed: disturbed, but for where that leads too near to a thing.

        And for where its checks object. The disturbed motion is then the plan that was checked, and that is
        monitored.
        """
        strength_rad = self._settings.disturbance_rad
        if not strength_rad:
            return plan
        disturbance = Disturbance(
            self._settings.task.arms, plan.trajectories, plan.schedule, strength_rad, self._perturbations
        )
        for _ in range(_CALMER):
            paths = plan.checker.paths(disturbance.trajectories(), scene)
            wrong = {*nearer(plan.checked.plan, paths)}
            if not wrong:
                checked = plan.checker.check(paths, plan.schedule)
                if not checked.violations:
                    return replace(plan, checked=checked)
                wrong = {at for each in checked.violations for at in self._concerned(each, plan, scene)}
            if not disturbance.lessen(wrong):
                break
        return plan

    def _concerned(self, violation: Violation, plan: Planned, scene: Scene) -> Iterator[tuple[int, int]]:
        """The agents that a violation of a plan is about, and where they are on their paths then."""
        positions = plan.schedule.positions
        now = np.clip(round(violation.time_s / CONTROL_DT_S) - scene.step, 0, len(positions) - 1)
        for agent in violation.agents or self._settings.task.agents:
            yield agent, int(positions[now, agent - 1])

    def _looked_at(self, scene: Scene) -> Scene:
        """The scene with what the depth cameras see now, where spatial constraints ask for it."""
        settings = self._settings
        if settings.occupancy == "state" or not settings.constraint_set.spatial:
            return scene
        planning_scene = PlanningScene(settings.task, scene)
        return replace(scene, seen=look(self._world.depth(), self._world.camera_models(), planning_scene))

    # -- execution -------------------------------------------------------------------------------

    def _execute(self, plan: Planned) -> Violation | None:
        meant = from_start(plan, intended(plan.trajectories, plan.schedule))
        commands = commands_of(plan)
        doing = self._subgoals.of_plan(plan.trajectories, plan.schedule)
        limits, disturbed = self._settings.limits, self._settings.disturbance_rad > 0
        watched = disturbed or self.scene.clutter
        watch = ObjectMotionWatch(plan.checked.plan, objects=disturbed) if watched else None

        def take(now: int) -> None:
            self._doing = doing[now]
            self._step(meant[now], commands[now])
            if watch is not None:
                self._object_moved = watch.unintended(self.scene)

        def rest(now: int) -> None:
            undisturbed = from_start(plan, actions(plan.trajectories, plan.schedule))
            for steps in zip(*come_to_rest_disturbed(undisturbed, commands, now, limits), strict=True):
                if self.over:
                    break
                self._step(*steps)

        return drive(self, commands, plan.checked.monitor(), limits, take, rest if disturbed else None)

    @property
    def told(self) -> NDArray[np.float64] | None:
        """(N, A) what the arms were last told, if anything."""
        return self._log.frames[-1].executed if self._log.frames else None

    @property
    def over(self) -> bool:
        """Whether nothing is left to do, or nothing to be made of it any more."""
        return self._verdict.success or self._object_moved is not None

    def take(self, command: NDArray[np.float64]) -> None:
        """One control step that is meant as it is carried out."""
        self._step(command, command)

    def _step(self, action: NDArray[np.float64], executed: NDArray[np.float64]) -> None:
        # What is stored is what was done, to the last bit: a replay of the store gives the same episode.
        action, executed = (each.astype(np.float32).astype(float) for each in (action, executed))
        pictures = self._world.images() if self._world.cameras else {}
        self._log.frames.append(Frame(self.scene, action, executed, pictures, self._doing, self._extras()))
        self._observer.stepped(self.scene, action, pictures)
        self.scene = self._world.step(executed)
        self._verdict = self._judge(self.scene)
        self._ledger.see(self.scene, self._verdict)
        self._log.judged(self._verdict)
        self._paper = self._paper or self._verdict.success_paper

    def _episode(self) -> Episode:
        settings, cameras = self._settings, self._world.cameras
        episode = self._log.episode(
            settings.task, self._seed, cameras, self._subgoals.texts, settings.disturbance_rad > 0
        )
        varies = scene_certificate(self._usual, self._seed)
        return replace(episode, certificate={**episode.certificate, **varies}) if varies else episode
