"""Evaluation: policies, of this experiment or somebody else's, act in consecutive scenes, each a row."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from rf_exp import recording, sim
from rf_exp.ablation import (
    FILM,
    PICTURE,
    EvaluationRow,
    GenerationRow,
    append_row,
    of_training_seed,
    read_rows,
    rollout_name,
    worth_seeing,
)
from rf_exp.artifacts import code, sweep, whole
from rf_exp.constraints import PolicyMonitor
from rf_exp.datagen import Coordinator, Settings
from rf_exp.findings import Account
from rf_exp.policy import (
    LEARNER,
    DiffusionRunner,
    PolicyConfig,
    PolicyRunner,
    Shield,
    cost_s,
    expect_policy,
    foreign_runners,
    load_runners,
    provenance,
    rollout,
)
from rf_exp.processes import Timeout, in_order
from rf_exp.progress import Progress, console
from rf_exp.stages.cell import Cell, known_rows, owned, same_configuration
from rf_exp.stages.logs import rate_log
from rf_exp.tasks import SuccessEvaluator, Task, drawn_of
from rf_exp.types import CONTROL_DT_S, Pictures, Rollout, RolloutStep

if TYPE_CHECKING:
    from rf_exp.sim import Simulator


@dataclass(frozen=True)
class Policies:
    """Policies as evaluation needs them. The value travels to worker processes, where runners are made."""

    make_runners: Callable[[], Sequence[PolicyRunner]]  # made in the process that asks
    step_limit: int  # of a scene
    coordinator: Settings | None = None  # of the plans by which one coordinates the policies, if one does


@dataclass(frozen=True)
class Learned:
    """How policies have learned, for their rows."""

    provenance: dict[str, Any]  # as it is recorded beside the rows
    core_s: float = 0.0  # CPU seconds of learning, together
    queries: int = 0  # proposals that the expert was asked for


def acting(cell: Cell) -> Policies:
    """The policies of a cell, which act for as long as the task says."""
    experiment, limit = cell.experiment, cell.task.step_limit
    if (foreign := experiment.foreign) is not None:
        fastest_rad = experiment.limits.velocity_rad_s * CONTROL_DT_S
        runners = partial(foreign_runners, foreign, fastest_rad, cell.task)
        return Policies(runners, foreign.step_limit or limit)
    coordinator = replace(cell.settings, disturbance_rad=0.0) if cell.arch.coordinated else None
    return Policies(partial(_loaded, cell.policy_path, experiment.policy), limit, coordinator)


def learned(cell: Cell) -> Learned:
    """How they learned. Raises StageError for policies that were made otherwise than the experiment says."""
    if (foreign := cell.experiment.foreign) is not None:
        return Learned({"foreign": foreign.name})
    experiment, folders = cell.experiment, [cell.policy_path / view.name for view in cell.views]
    config = replace(experiment.training, seed=experiment.train_seed)
    wanted = {"learner": LEARNER, "policy": experiment.policy.learned, "train": config.identity}
    made = {}
    for folder in folders:
        made[folder.name] = provenance(folder)
        expect_policy(folder, wanted)
    weights = {name: one.pop("weights") for name, one in made.items()}
    said = {"data": next(iter(made.values()))["data"], "weights": weights}
    corrections = [cell.after(k + 1).correction_path for k in range(experiment.dagger.rounds)]
    queries = sum(row.attempts for path in corrections for row in read_rows(path, GenerationRow))
    return Learned(said, sum(map(cost_s, folders)), queries)


@lru_cache(maxsize=1)  # once a process; a finished folder never changes
def _loaded(folder: Path, config: PolicyConfig) -> tuple[DiffusionRunner, ...]:
    return load_runners(folder, acting=config)


def evaluate_policies(cell: Cell) -> None:
    """Consecutive scenes that generation never saw; each is a row. Continues where it stopped."""
    experiment, task, path = cell.experiment, cell.task, cell.evaluation_path
    policies, made = acting(cell), learned(cell)
    with owned(path, cell.evaluation_identity(policies.step_limit)):
        known = known_rows(path, EvaluationRow)
        of_seed = of_training_seed(path, experiment.train_seed)
        there = any(r.train_seed == experiment.train_seed for r in known)
        same_configuration(of_seed, made.provenance, there, [path])
        sweep(cell.recording_path("evaluate", 0).parent)
        scenes, of = experiment.evaluation_seeds, (experiment.train_seed, task.version)
        ours = [r for r in known if r.scene_seed in scenes and (r.train_seed, r.version) == of]
        seen = {r.scene_seed for r in ours}
        missing = [seed for seed in scenes if seed not in seen]
        title = cell.title("evaluate") + ", shielded" * experiment.shield
        if not missing:
            console.print(f"{title}: {experiment.scenes} scenes are there, nothing to do")
        successes = sum(r.success for r in ours)
        with (
            Progress(title, experiment.scenes, "scenes", len(seen)) as progress,
            rate_log(cell, "evaluate", ours) as log,
        ):
            scene = scene_of(cell, policies)
            jobs = (partial(scene, seed) for seed in missing)
            results = in_order(jobs, experiment.workers, experiment.seed_limit_s)
            for tried, (seed, answer) in enumerate(zip(missing, results, strict=True), start=len(seen) + 1):
                if isinstance(answer, Timeout):
                    lost = Account(ended=str(answer))
                    answer = Rollout(seed, False, False, 0, 0, 0, account=lost), answer.limit_s
                result, wall_s = answer
                row = _row(cell, policies.step_limit, made, result, wall_s)
                append_row(path, row)
                ours.append(row)
                log(row)
                successes += result.success
                progress.advance(note=f"{successes} of {tried} scenes succeeded")
        _look(cell, policies, ours)


def _look(cell: Cell, policies: Policies, known: Sequence[EvaluationRow]) -> None:
    """Recordings and films that are missing: same seed, same rollout, once more."""
    experiment, scene = cell.experiment, scene_of(cell, policies)
    scenes = experiment.evaluation_seeds
    recorded = experiment.recorded("evaluate", scenes)
    filmed = worth_seeing([r for r in known if r.scene_seed in scenes], experiment.films)
    how = experiment.train_seed, experiment.shield, experiment.evaluated.name
    stage = rollout_name(cell.arch.name, experiment.method, experiment.learned_from, *how)
    before = {r.scene_seed: r for r in known}
    looks: list[tuple[int, list[Path]]] = []
    jobs: list[Callable[[], Any]] = []
    for seed in sorted({*recorded, *filmed}):
        record = cell.recording_path(stage, seed)
        film, picture = record.with_suffix(FILM), record.with_suffix(PICTURE)
        wanted = [record] * (seed in recorded) + [film, picture] * (seed in filmed)
        if missing := [path for path in wanted if not path.exists()]:
            looks.append((seed, missing))
            to_record = record if record in missing else None
            to_film = film if {film, picture} & {*missing} else None
            jobs.append(partial(scene, seed, record=to_record, film=to_film))
    made = in_order(jobs, experiment.workers, experiment.seed_limit_s)
    for (seed, missing), look in zip(looks, made, strict=True):
        if isinstance(look, Timeout):
            console.print(f"warning: scene {seed} is not recorded: {look}")
            continue
        result, _ = look
        for path in missing:
            console.print(f"recorded {path}")
        then = before.get(seed)
        if then is not None and (then.success, then.steps) != (result.success, result.steps):
            console.print(
                f"warning: scene {seed} ended otherwise than in its row: success {result.success} after "
                f"{result.steps} steps, there {then.success} after {then.steps}"
            )


def scene_of(cell: Cell, policies: Policies) -> Callable[..., tuple[Rollout, float]]:
    """`evaluate_scene` of a cell, which lacks the seed alone."""
    pictures, shield = cell.experiment.pictures, cell.experiment.shield
    return partial(evaluate_scene, cell.evaluated_task, pictures, policies, shield=shield)


def evaluate_scene(
    task: Task,
    pictures: Pictures,
    policies: Policies,
    seed: int,
    shield: bool = False,
    record: Path | None = None,
    film: Path | None = None,
    watch: Callable[[RolloutStep], None] | None = None,
) -> tuple[Rollout, float]:
    """A rollout in this process and the seconds it took; recorded and filmed to the files that are named.

    A film has the picture of its last moment beside it. `watch` is told of every step.
    """
    began = time.perf_counter()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # a small network on one picture gains nothing from more
    world = sim.shared_simulator(task, pictures)
    start = world.reset(seed)
    with ExitStack() as stack:
        stack.callback(torch.set_num_threads, threads)
        observers = _observers(stack, task, pictures, world, seed, record, film)
        task = world.task  # as it stands in this scene
        for observer in observers:
            observer.begun(start)

        def look(step: RolloutStep) -> None:
            for observer in observers:
                observer.rolled(step)
            if watch is not None:
                watch(step)

        runners, coordinator = policies.make_runners(), None
        if policies.coordinator is not None:
            assert isinstance(runners[0], DiffusionRunner)  # trained ones know subgoals by their numbers
            plans = replace(policies.coordinator, task=task)
            coordinator = Coordinator(plans, seed, start, runners[0].spec.names)
        aids = look, start, Shield(task) if shield else None, coordinator
        judge = SuccessEvaluator(task, start)
        result = rollout(world, judge, runners, seed, policies.step_limit, PolicyMonitor(task), *aids)
        for observer in observers:
            observer.ended(result)
    return result, time.perf_counter() - began


def _observers(
    stack: ExitStack,
    task: Task,
    pictures: Pictures,
    world: "Simulator",
    seed: int,
    record: Path | None,
    film: Path | None,
) -> "list[recording.RolloutRecorder | recording.RolloutFilm | recording.Onlooker]":
    """Who writes the files that are named, of pictures in which people see something."""
    observers, large = [], pictures.enlarged
    if record is None and film is None:
        return observers
    if pictures.render and large != pictures:
        shown = stack.enter_context(sim.Simulator(task, width_px=large.width, height_px=large.height))
        observers.append(recording.Onlooker(shown, seed))
    else:
        shown = world
    if record is not None:
        draft, title = stack.enter_context(whole(record)), f"{task.title}, policy, scene {seed}"
        recorder = recording.RolloutRecorder(draft, world.task, shown, title)
        observers.append(stack.enter_context(recorder))
    if film is not None:
        draft, picture = (stack.enter_context(whole(path)) for path in (film, film.with_suffix(PICTURE)))
        observers.append(stack.enter_context(recording.RolloutFilm(draft, picture, world.task, shown)))
    return observers


def _row(cell: Cell, limit: int, learned: Learned, result: Rollout, wall_s: float) -> EvaluationRow:
    experiment, foreign = cell.experiment, cell.experiment.foreign
    return EvaluationRow(
        task=cell.task.name,
        arch=cell.arch.name,
        constraints=cell.constraint_set.name,
        demos=experiment.learned_from,
        train_seed=experiment.train_seed,
        scene_seed=result.seed,
        success=result.success,
        success_paper=result.success_paper,
        steps=result.steps,
        step_limit=limit,
        violations=result.violations,
        wall_s=round(wall_s, 3),
        version=cell.task.version,
        contacts=result.contacts,
        commit=code(),
        observation=foreign.observation if foreign else experiment.policy.observation,
        disturbance_rad=0.0 if foreign else experiment.disturbance_rad,
        shield=experiment.shield,
        interventions=result.interventions,
        recipe=experiment.method,
        core_s=round(learned.core_s, 1),
        queries=learned.queries,
        account=result.account,
        variation=experiment.evaluated.name,
        drawn=drawn_of(cell.evaluated_task, result.seed),
    )
