"""Generation: consecutive seeds become checked demonstrations in the store, with a row for each seed."""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rf_exp import recording
from rf_exp.ablation import GenerationRow, append_row, restore_row
from rf_exp.artifacts import atomic_path, code_version, plain, remove_stale_drafts, write_text_if_changed
from rf_exp.datagen import EpisodeGenerator, Outcome, Settings, generate, generator_version, make_episode
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import EVALUATION_SEED, Experiment
from rf_exp.launch import LOCAL
from rf_exp.progress import Progress, console
from rf_exp.sim import close_shared_simulator, shared_simulator
from rf_exp.stages.cell import Cell, artifact_lock, cells, known_rows, shared_fields
from rf_exp.stages.logs import rate_log
from rf_exp.stages.shards import Attempt, Shards
from rf_exp.store import Description, Store, card
from rf_exp.tasks import Task, label_names, scene_draws
from rf_exp.types import CameraModel, Extras, Pictures

MAX_REASONS = 3  # most frequent reasons, which are reported where seeds fail
MAX_SEEDS_PER_DEMO = 10  # seeds tried for each demonstration wanted, before generation gives up


def generate_data(cell: Cell) -> int:
    """Generates `demos` demonstrations, or tries `episodes` consecutive seeds; continues where it stopped.

    Returns the number of demonstrations. Raises StageError when existing data was made otherwise, or when
    almost no seed succeeds.
    """
    experiment, title = cell.experiment, cell.title("generate")
    path, rows_path = cell.data_path, cell.generation_path
    max_seeds = experiment.episodes or MAX_SEEDS_PER_DEMO * experiment.demos
    seeds = range(experiment.seed, min(experiment.seed + max_seeds, EVALUATION_SEED))
    with (
        artifact_lock(rows_path, cell.generation_identity, [path]),
        artifact_lock(path),
        _store(cell) as store,
    ):
        pictures = _pictures(cell, store.cameras)
        wanted = None if experiment.episodes else experiment.demos
        if experiment.launch.engine == LOCAL:
            make = partial(make_episode, cell.settings, pictures, extras=experiment.store)
            make_attempts = partial(attempts, cell, make)
        else:
            store_cell = replace(cell, experiment=replace(experiment, pictures=pictures))
            make_attempts = Shards(store_cell, generate_data).attempts
        done = collect(cell, "generate", store, rows_path, seeds, wanted, make_attempts)
        rows = known_rows(rows_path, GenerationRow)
        for line in answer_summary(cell, [row for row in rows if row.seed in seeds]):
            console.print(f"{title}: {line}")
        write_text_if_changed(path.with_suffix(".md"), card(store))
        _record(cell, experiment.recorded("generate", store.seeds.tolist()))
        if wanted is not None and done < wanted:
            raise StageError(
                f"{title}: only {done} of {len(seeds)} seeds succeeded, {wanted} demonstrations were wanted; "
                f"failed {_failure_summary(rows)}; the rows are in {rows_path}"
            )
        return done


def answer_summary(cell: Cell, rows: Iterable[GenerationRow]) -> Iterator[str]:
    """Yields a summary of RoboBrain's answers, if any was refused, and the folder of a model's answers."""
    dialogues = [row.dialogue for row in rows]
    codes = sum((each.codes for each in dialogues), Counter[str]())
    if codes:
        answers, rounds = (
            sum(len(each.answers) for each in dialogues),
            sum(len(each.rounds) for each in dialogues),
        )
        listed = ", ".join(f"{code} {count}" for code, count in codes.most_common())
        repairs = sum(each.repairs for each in dialogues)
        yield f"{answers} answers in {rounds} rounds, {repairs} repairs, {codes.total()} refusals: {listed}"
    if (folder := cell.settings.brain.folder) is not None:
        yield f"exchanges in {folder / cell.task.name / cell.constraint_set.name}"


def why_seeds_failed(experiment: Experiment) -> str:
    """The most frequent reasons why seeds failed, with counts, and where all rows are."""
    paths = [cell.generation_path for cell in cells(experiment)]
    rows = [row for path in paths for row in known_rows(path, GenerationRow)]
    where = paths[0] if len(paths) == 1 else experiment.out / "results" / "generate"
    return f"{_failure_summary(rows)}; the rows are in {where}"


def _failure_summary(rows: Iterable[GenerationRow]) -> str:
    kinds = Counter(row.account.kind for row in rows if not row.success)
    listed = [f"{count} of {kinds.total()}: {kind}" for kind, count in kinds.most_common(MAX_REASONS)]
    omitted = len(kinds) - len(listed)
    return " | ".join([*listed, *([f"and {omitted} rarer"] if omitted else [])])


def collect(
    cell: Cell,
    stage: str,
    store: Store,
    rows_path: Path,
    seeds: Sequence[int],
    wanted: int | None,
    make_attempts: Callable[[Sequence[int], int | None], Iterator[Attempt]],
    became: str = "succeeded",
) -> int:
    """Stores the episodes of the seeds of `seeds` and a row of each: of all, or until there are `wanted`.

    `source(seeds, wanted)` yields the attempts at the seeds in their order: at all, or until `wanted` have
    succeeded. Returns the number of stored episodes of `seeds`.
    """
    title, row_by_seed = cell.title(stage), {row.seed: row for row in known_rows(rows_path, GenerationRow)}
    for row in _lost_rows(store, seeds, row_by_seed, rows_path):
        append_row(rows_path, row)
        row_by_seed[row.seed] = row
    stored = {*store.seeds.tolist()} & {*seeds}
    tried = stored | {seed for seed, r in row_by_seed.items() if seed in seeds and not r.success}
    stored_count = len(stored)
    if (wanted is not None and stored_count >= wanted) or len(tried) == len(seeds):
        console.print(f"{title}: {stored_count} demonstrations are there, nothing to do")
        return stored_count
    unit, total, done = (
        ("demonstrations", wanted, stored_count) if wanted else ("seeds", len(seeds), len(tried))
    )
    logged = rate_log(cell, stage, row_by_seed.values())
    with Progress(title, total, unit, done) as progress, logged as log:
        missing = [seed for seed in seeds if seed not in tried]
        for row, episode in make_attempts(missing, None if wanted is None else wanted - stored_count):
            if episode is not None:
                store.append(episode)
            if row.seed not in row_by_seed:  # after a kill before this, `_lost_rows` restores the row
                append_row(rows_path, row)
                log(row)
            tried.add(row.seed)
            stored_count += row.success
            progress.advance(
                int(wanted is None or row.success), f"{stored_count} of {len(tried)} seeds {became}"
            )
    return stored_count


def attempts(
    cell: Cell, make: Callable[[int], Outcome], seeds: Sequence[int], wanted: int | None
) -> Iterator[Attempt]:
    """Yields rows and episodes of `seeds` in their order: of all, or until `wanted` have succeeded.

    `make` returns the outcome of a seed under the cell's settings; it runs in processes of this machine.
    """
    for outcome in generate(make, seeds, cell.experiment.workers, cell.experiment.seed_limit_s):
        row, episode = generation_row(cell.settings, outcome), outcome.episode
        if episode is not None:  # its certificate has the row, without the time, so that bytes are equal
            row_values = {name: value for name, value in plain(row).items() if name != "wall_s"}
            episode = replace(episode, certificate={**episode.certificate, "row": row_values})
        yield row, episode
        if wanted is not None and not (wanted := wanted - outcome.success):
            return


def _store(cell: Cell) -> Store:
    experiment, task, path = cell.experiment, cell.task, cell.data_path
    if path.exists():
        identity = cell.store_identity(_pictures(cell, Store.open(path).cameras))
        return Store.open(path, identity, writable=True)
    identity = cell.store_identity(experiment.pictures)
    cameras, (height, width) = identity["cameras"], identity["picture"]
    description = _description(task, experiment.pictures, cameras, experiment.store)
    objects, robots = tuple(task.objects), [robot.model for robot in task.robots]
    size = len(robots), cameras, height, width, objects, experiment.disturbance_rad > 0
    return Store.create(path, identity, *size, description, robots)


def _pictures(cell: Cell, stored_cameras: Sequence[str]) -> Pictures:
    """The experiment's pictures; those of all cameras where the existing data hold them."""
    pictures = cell.experiment.pictures
    all_cameras = replace(pictures, cameras="all")
    return (
        all_cameras if {*stored_cameras} == {*all_cameras.camera_names(len(cell.task.agents))} else pictures
    )


def _lost_rows(
    store: Store, seeds: Container[int], recorded: Container[int], rows_path: Path
) -> Iterator[GenerationRow]:
    """Yields the missing rows of stored episodes, lost by a kill or the removal of a line."""
    for index, seed in enumerate(store.seeds.tolist()):
        if seed in recorded or seed not in seeds:
            continue
        try:
            values = {**store.certificates[index]["row"], "wall_s": 0.0}
            yield restore_row(values, GenerationRow)
        except (KeyError, TypeError, ArgumentError) as error:
            raise StageError(
                f"seed {seed} is stored in {store.path}, but has no row, neither in {rows_path} nor in its "
                f"certificate; delete {store.path} and generate again"
            ) from error


def _record(cell: Cell, seeds: Sequence[int]) -> None:
    """Makes missing recordings by making episodes again: the same seed gives the same episode."""
    settings, task = cell.settings, cell.task
    settings = replace(settings, brain=settings.brain.again())  # a model is not asked twice
    remove_stale_drafts(cell.recording_path("generate", 0).parent)
    for seed in seeds:
        path = cell.recording_path(f"generate-{cell.data_path.stem}", seed)
        if path.exists():
            continue
        # Depth pictures decide the plan where occupancy is depth, so there they keep their size.
        pictures = cell.experiment.pictures
        simulator = shared_simulator(task, pictures.enlarged if settings.occupancy == "state" else pictures)
        title = f"{task.title}, {cell.constraint_set.name}, scene {seed}"
        simulator.reset(seed)  # cameras and arms have their poses of this scene in the recording
        with (
            atomic_path(path) as draft,
            recording.EpisodeRecorder(draft, simulator.task, simulator, title) as recorder,
        ):
            EpisodeGenerator(settings, simulator, settings.make_brain(seed), recorder).make(seed)
        console.print(f"recorded {path}")
    close_shared_simulator()


def generation_row(settings: Settings, outcome: Outcome) -> GenerationRow:
    """The row of one attempt under the constraints."""
    task = settings.task
    return GenerationRow(
        **shared_fields(GenerationRow, replace(outcome, wall_s=round(outcome.wall_s, 3))),
        task=task.name,
        constraints=settings.constraint_set.name,
        brain=settings.brain.label,
        version=task.version,
        generator=generator_version(task),
        commit=code_version(),
        disturbance_rad=settings.disturbance_rad,
        delay_s=settings.delay_s,
        variation=task.variation.name,
        drawn=scene_draws(task, outcome.seed),
    )


def _description(task: Task, pictures: Pictures, cameras: Sequence[str], extras: Extras) -> Description:
    scene, models = task.start(0).scene, {}
    for name in cameras:
        spec, pose = task.cameras[name], task.parent_from_camera(name)
        model = CameraModel(pictures.width, pictures.height, float(np.deg2rad(spec.fov_deg)), pose)
        frame = "hand" if spec.mount == "wrist" else "world"
        models[name] = {"intrinsics": plain(model.intrinsics), f"{frame}_from_camera": plain(pose)}
    return Description(
        language={key: getattr(task, key) for key in ("title", "description", "target_condition")},
        conditions=tuple(task.module.conditions(scene, scene, task)),
        world_from_base=[plain(robot.world_from_base) for robot in task.robots],
        camera_models=models,
        depth=extras.depth,
        labels=label_names(task) if extras.segmentation else (),
    )
