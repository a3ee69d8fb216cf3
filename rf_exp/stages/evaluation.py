"""Evaluation: rollouts of policies, of this experiment or foreign ones, in consecutive scenes, a row each."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch

from rf_exp import ablation, policy, recording, sim
from rf_exp.ablation import EvaluationRow, GenerationRow
from rf_exp.artifacts import atomic_path, code_version, expect_same, plain, remove_stale_drafts
from rf_exp.constraints import PolicyMonitor
from rf_exp.datagen import Coordinator, Settings
from rf_exp.errors import error_context
from rf_exp.findings import Account
from rf_exp.processes import Timeout, in_order
from rf_exp.progress import Progress, console
from rf_exp.stages.cell import (
    Cell,
    artifact_lock,
    evaluation_rows,
    known_rows,
    same_configuration,
    shared_fields,
)
from rf_exp.stages.logs import rate_log
from rf_exp.tasks import SuccessEvaluator, Task, scene_draws
from rf_exp.types import CONTROL_DT_S, Pictures, Rollout, RolloutStep


@dataclass(frozen=True)
class Policies:
    """Policies to evaluate. The value is sent to worker processes, which make the runners."""

    make_runners: Callable[[], Sequence[policy.PolicyRunner]]  # called in the worker process
    step_limit: int  # of a scene
    coordinator: Settings | None = None  # of the coordinator's plans; None without a coordinator


@dataclass(frozen=True)
class TrainingRecord:
    """How policies were trained, for their rows."""

    provenance: dict[str, Any]  # as it is recorded beside the rows
    core_s: float = 0.0  # CPU seconds of learning, of all policies together
    queries: int = 0  # proposals that the expert was asked for
    disturbance_rad: float = 0.0  # of the demonstrations


def policies_of(cell: Cell) -> Policies:
    """The policies of a cell, with the step limit of the task, or that of a foreign policy if it has one."""
    experiment, limit = cell.experiment, cell.task.step_limit
    if (foreign := experiment.foreign) is not None:
        fastest_rad = experiment.limits.velocity_rad_s * CONTROL_DT_S
        runners = partial(policy.foreign_runners, foreign, fastest_rad, cell.task)
        return Policies(runners, foreign.step_limit or limit)
    coordinator = replace(cell.settings, disturbance_rad=0.0) if cell.arch.coordinated else None
    return Policies(partial(_load_runners, cell.policy_path, experiment.policy), limit, coordinator)


def training_record(cell: Cell) -> TrainingRecord:
    """How a cell's policies were trained. Raises StageError if that is not as the experiment says."""
    if (foreign := cell.experiment.foreign) is not None:
        return TrainingRecord({"foreign": foreign.name})
    experiment, folders = cell.experiment, [cell.policy_path / view.name for view in cell.views]
    config = replace(experiment.training, seed=experiment.train_seed)
    wanted = {
        "learner": policy.LEARNER,
        "policy": experiment.policy.training_values,
        "train": config.identity,
    }
    provenances = {}
    for folder in folders:
        provenances[folder.name] = policy.provenance(folder)
        policy.expect_policy(folder, wanted)
    weights = {name: provenance.pop("weights") for name, provenance in provenances.items()}
    data = next(iter(provenances.values()))["data"]
    if (brain := data["identity"].get("brain")) is not None:  # imported data have none
        remedy = "say the brain of its demonstrations, or choose another out=FOLDER"
        expect_same(
            cell.policy_path, {"brain": brain}, plain({"brain": cell.settings.brain.identity}), remedy
        )
    provenance, disturbed = {"data": data, "weights": weights}, data["identity"].get("disturbance_rad", 0.0)
    corrections = [cell.after_rounds(k + 1).correction_path for k in range(experiment.dagger.rounds)]
    queries = sum(row.attempts for path in corrections for row in ablation.read_rows(path, GenerationRow))
    return TrainingRecord(provenance, sum(map(policy.cost_s, folders)), queries, disturbed)


@lru_cache(maxsize=1)  # once per process; a finished folder never changes
def _load_runners(folder: Path, config: policy.PolicyConfig) -> tuple[policy.DiffusionRunner, ...]:
    return policy.load_runners(folder, acting=config)


def evaluate_policies(cell: Cell) -> None:
    """Rolls policies out in consecutive scenes that generation never saw. Continues where it stopped."""
    experiment, path = cell.experiment, cell.evaluation_path
    policies, training = policies_of(cell), training_record(cell)
    with artifact_lock(path, cell.evaluation_identity(policies.step_limit)):
        provenance_file = ablation.training_seed_file(path, experiment.train_seed)
        exists = any(r.train_seed == experiment.train_seed for r in known_rows(path, EvaluationRow))
        same_configuration(provenance_file, training.provenance, exists, [path])
        remove_stale_drafts(cell.recording_path("evaluate", 0).parent)
        rows = evaluation_rows(cell)
        done = {r.scene_seed for r in rows}
        missing = [seed for seed in experiment.evaluation_seeds if seed not in done]
        title = cell.title("evaluate") + ", shielded" * experiment.shield
        if not missing:
            console.print(f"{title}: {experiment.scenes} scenes are there, nothing to do")
        successes = sum(r.success for r in rows)
        with (
            Progress(title, experiment.scenes, "scenes", len(done)) as progress,
            rate_log(cell, "evaluate", rows) as log,
        ):
            evaluate = scene_evaluator(cell, policies)
            jobs = (partial(evaluate, seed) for seed in missing)
            results = in_order(jobs, experiment.workers, experiment.seed_limit_s)
            for number, (seed, answer) in enumerate(zip(missing, results, strict=True), start=len(done) + 1):
                if isinstance(answer, Timeout):
                    lost = Account(ended=str(answer))
                    answer = Rollout(seed, False, False, 0, 0, 0, account=lost), answer.limit_s
                result, wall_s = answer
                row = _row(cell, policies.step_limit, training, result, wall_s)
                ablation.append_row(path, row)
                rows.append(row)
                log(row)
                successes += result.success
                progress.advance(note=f"{successes} of {number} scenes succeeded")
        _record_missing(cell, policies, rows)


def _record_missing(cell: Cell, policies: Policies, rows: Sequence[EvaluationRow]) -> None:
    """Makes missing recordings and films by rolling out again: the same seed gives the same rollout."""
    experiment, evaluate = cell.experiment, scene_evaluator(cell, policies)
    recorded = experiment.recorded("evaluate", experiment.evaluation_seeds)
    filmed = ablation.seeds_to_film(rows, experiment.films)
    policy_key = experiment.train_seed, experiment.shield, experiment.evaluated.name
    stage = ablation.rollout_name(cell.arch.name, experiment.method, experiment.learned_from, *policy_key)
    row_by_seed = {r.scene_seed: r for r in rows}
    pending: list[tuple[int, list[Path]]] = []
    jobs: list[Callable[[], Any]] = []
    for seed in sorted({*recorded, *filmed}):
        record = cell.recording_path(stage, seed)
        film, picture = record.with_suffix(ablation.FILM), record.with_suffix(ablation.PICTURE)
        wanted = [record] * (seed in recorded) + [film, picture] * (seed in filmed)
        if missing := [path for path in wanted if not path.exists()]:
            pending.append((seed, missing))
            to_record = record if record in missing else None
            to_film = film if {film, picture} & {*missing} else None
            jobs.append(partial(evaluate, seed, record=to_record, film=to_film))
    results = in_order(jobs, experiment.workers, experiment.seed_limit_s)
    for (seed, missing), answer in zip(pending, results, strict=True):
        if isinstance(answer, Timeout):
            console.print(f"warning: scene {seed} is not recorded: {answer}")
            continue
        result, _ = answer
        for path in missing:
            console.print(f"recorded {path}")
        row = row_by_seed.get(seed)
        if row is not None and (row.success, row.steps) != (result.success, result.steps):
            console.print(
                f"warning: scene {seed} ended otherwise than in its row: success {result.success} after "
                f"{result.steps} steps, there {row.success} after {row.steps}"
            )


def scene_evaluator(cell: Cell, policies: Policies) -> Callable[..., tuple[Rollout, float]]:
    """`evaluate_scene` of a cell, to be called with a seed."""
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
    """Makes a rollout in this process; returns it and its duration, s. Records and films to the given files.

    A picture of the last moment is written beside a film. `watch` is called with every step.
    """
    start_s = time.perf_counter()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # a small network on one picture gains nothing from more
    simulator = sim.shared_simulator(task, pictures)
    start = simulator.reset(seed)
    display, enlarged, scene_task = (
        simulator,
        pictures.enlarged,
        simulator.task,
    )  # the task as varied in this scene
    observers: list[recording.RolloutRecorder | recording.RolloutFilm] = []
    callbacks: list[Callable[[RolloutStep], None]] = []
    with ExitStack() as stack:
        stack.callback(torch.set_num_threads, threads)
        stack.enter_context(error_context(f"scene {seed}"))
        if (record or film) and pictures.render and enlarged != pictures:  # larger pictures, for people
            display = stack.enter_context(
                sim.Simulator(task, width_px=enlarged.width, height_px=enlarged.height)
            )
            display.reset(seed)
            callbacks.append(partial(recording.show_measured_state, display))
        if record is not None:
            draft, title = stack.enter_context(atomic_path(record)), f"{task.title}, policy, scene {seed}"
            recorder = recording.RolloutRecorder(draft, scene_task, display, title)
            observers.append(stack.enter_context(recorder))
        if film is not None:
            paths = film, film.with_suffix(ablation.PICTURE)
            draft, picture = (stack.enter_context(atomic_path(path)) for path in paths)
            observers.append(stack.enter_context(recording.RolloutFilm(draft, picture, scene_task, display)))
        callbacks += [observer.rolled for observer in observers] + ([] if watch is None else [watch])
        for observer in observers:
            observer.begun(start)

        def on_step(step: RolloutStep) -> None:
            for callback in callbacks:
                callback(step)

        runners, coordinator = policies.make_runners(), None
        if policies.coordinator is not None:
            assert isinstance(runners[0], policy.DiffusionRunner)  # a trained one, with numbered subgoals
            plans = replace(policies.coordinator, task=scene_task)
            coordinator = Coordinator(plans, seed, start, runners[0].spec.names)
        evaluator, monitor = SuccessEvaluator(scene_task, start), PolicyMonitor(scene_task)
        options = on_step, start, policy.Shield(scene_task) if shield else None, coordinator
        result = policy.rollout(simulator, evaluator, runners, seed, policies.step_limit, monitor, *options)
        for observer in observers:
            observer.ended(result)
    return result, time.perf_counter() - start_s


def _row(
    cell: Cell, step_limit: int, training: TrainingRecord, result: Rollout, wall_s: float
) -> EvaluationRow:
    experiment, foreign = cell.experiment, cell.experiment.foreign
    return EvaluationRow(
        **shared_fields(EvaluationRow, result),
        task=cell.task.name,
        arch=cell.arch.name,
        constraints=cell.constraint_set.name,
        demos=experiment.learned_from,
        train_seed=experiment.train_seed,
        scene_seed=result.seed,
        step_limit=step_limit,
        wall_s=round(wall_s, 3),
        version=cell.task.version,
        commit=code_version(),
        observation=foreign.observation if foreign else experiment.policy.observation,
        disturbance_rad=training.disturbance_rad,
        shield=experiment.shield,
        recipe=experiment.method,
        core_s=round(training.core_s, 1),
        queries=training.queries,
        variation=experiment.evaluated.name,
        drawn=scene_draws(cell.evaluated_task, result.seed),
    )
