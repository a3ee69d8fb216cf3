"""Generation: consecutive seeds become checked demonstrations in the store, each seed a row."""

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from rf_exp.ablation import rows
from rf_exp.ablation.rows import GenerationRow
from rf_exp.artifacts.files import keep_text, sweep, whole
from rf_exp.artifacts.identity import plain, without
from rf_exp.artifacts.provenance import commit
from rf_exp.datagen.episode import EpisodeMaker, Outcome
from rf_exp.datagen.generate import generate, make_episode
from rf_exp.datagen.planning import Settings
from rf_exp.datagen.version import generator_version
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import EVALUATION_SEED, Experiment
from rf_exp.progress import Progress, console
from rf_exp.recording import EpisodeRecorder
from rf_exp.sim.pool import close_simulator, simulator
from rf_exp.stages.artifacts import data_path, generation_path, owned, recording_path
from rf_exp.stages.description import described
from rf_exp.stages.identity import generation_identity
from rf_exp.stages.logs import rate_log
from rf_exp.store import Store, card
from rf_exp.tasks import Task
from rf_exp.types import Episode, Pictures, Row

HOPELESS = 10  # seeds tried for each demonstration wanted, before generation gives up


def generate_data(experiment: Experiment, task: Task, row: Row) -> int:
    """`demos` successes, or all of `episodes` consecutive seeds; continues where it stopped.

    Returns how many demonstrations there are.

    Raises StageError when the data there was made otherwise, or when almost no seed succeeds.
    """
    title = f"generate {task.name}/{row.name}"
    settings = experiment.settings(task, row)
    made_of = generation_identity(experiment, task, row)
    path, rows_path = data_path(experiment, task, row), generation_path(experiment, task, row)
    goal = experiment.episodes or HOPELESS * experiment.demos
    span = range(experiment.seed, min(experiment.seed + goal, EVALUATION_SEED))
    with owned(rows_path, made_of, [path]), owned(path), _store(experiment, task, row, made_of) as store:
        pictures = _pictures(experiment, store.cameras, len(task.agents))

        enough = None if experiment.episodes else experiment.demos
        logged = partial(rate_log, experiment, "generate", task, row, None)
        make = partial(make_episode, settings, pictures, extras=experiment.store)
        made = collect(experiment, settings, title, store, rows_path, span, enough, make, logged)
        keep_text(path.with_suffix(".md"), card(store))
        _record(experiment, task, row, experiment.recorded("generate", store.seeds.tolist()))
        if enough is not None and made < enough:
            raise StageError(
                f"{title}: only {made} of {len(span)} seeds succeeded, {enough} demonstrations "
                f"were wanted; the reasons are in {rows_path}"
            )
        return made


def collect(
    experiment: Experiment,
    settings: Settings,
    title: str,
    store: Store,
    rows_path: Path,
    span: Sequence[int],
    enough: int | None,
    make: Callable[[int], Outcome],
    logged: Callable[[Iterable[GenerationRow]], AbstractContextManager[Callable[[GenerationRow], None]]],
    became: str = "succeeded",
) -> int:
    """Episodes of the seeds of `span` into a store and a row of each: of all, or until there are `enough`.

    `make` gives the outcome of a seed, made as `settings` say; `logged`, from the rows that are known, who is
    told of the new ones. Returns how many of `span` are stored.
    """
    known = {r.seed: r for r in rows.read(rows_path, GenerationRow)} if rows_path.exists() else {}
    for lost in _lost(store, span, known, rows_path):
        rows.append(rows_path, lost)
        known[lost.seed] = lost
    stored = {*store.seeds.tolist()} & {*span}
    tried = stored | {seed for seed, r in known.items() if seed in span and not r.success}
    made = len(stored)
    if (enough is not None and made >= enough) or len(tried) == len(span):
        console.print(f"{title}: {made} demonstrations are there, nothing to do")
        return made
    unit, total, there = ("demonstrations", enough, made) if enough else ("seeds", len(span), len(tried))
    with Progress(title, total, unit, there) as progress, logged(known.values()) as log:
        missing = [seed for seed in span if seed not in tried]
        for outcome in generate(make, missing, experiment.workers, experiment.seed_limit_s):
            who = settings.brain.name, outcome, settings.disturbance_rad
            tells = generation_row(settings.task, settings.row, *who)
            if outcome.episode is not None:
                store.append(_with_row(outcome.episode, tells))
            if outcome.seed not in known:  # a kill before this: the episode has its row
                rows.append(rows_path, tells)
                log(tells)
            tried.add(outcome.seed)
            made += outcome.success
            progress.advance(int(enough is None or outcome.success), f"{made} of {len(tried)} seeds {became}")
            if made == enough:
                break
    return made


def _store(experiment: Experiment, task: Task, row: Row, made_of: dict[str, object]) -> Store:
    path, there = data_path(experiment, task, row), ()
    if path.exists() and experiment.pictures.cameras != "all":
        there = Store.open(path).cameras
    pictures = _pictures(experiment, there, len(task.agents))
    cameras = pictures.of(len(task.agents))
    size = (pictures.height, pictures.width) if pictures.render else (0, 0)
    identity = {
        **made_of,
        **without(asdict(experiment.store), depth=False, segmentation=False),
        "first_seed": experiment.seed,
        "cameras": list(cameras),
        "picture": list(size),
    }
    if path.exists():
        return Store.open(path, identity, writable=True)
    disturbed = experiment.disturbance_rad > 0
    description = described(task, pictures, cameras, experiment.store)
    objects = tuple(task.objects)
    return Store.create(path, identity, len(task.agents), cameras, *size, objects, disturbed, description)


def _pictures(experiment: Experiment, there: Sequence[str], agents: int) -> Pictures:
    """What is asked for; data that hold the pictures of all cameras will do, and go on with those."""
    everything = replace(experiment.pictures, cameras="all")
    return everything if {*there} == {*everything.of(agents)} else experiment.pictures


def _with_row(episode: Episode, row: GenerationRow) -> Episode:
    """The episode with its row in its certificate; without the time it took, so that bytes are the same."""
    kept = {name: value for name, value in plain(row).items() if name != "wall_s"}
    return replace(episode, certificate={**episode.certificate, "row": kept})


def _lost(
    store: Store, span: Container[int], known: Container[int], rows_path: Path
) -> Iterator[GenerationRow]:
    """The rows of stored episodes that are not among the rows: a kill, or a line that was removed."""
    for index, seed in enumerate(store.seeds.tolist()):
        if seed in known or seed not in span:
            continue
        try:
            values = {**store.certificates[index]["row"], "wall_s": 0.0}
            yield rows.from_values(values, GenerationRow)
        except (KeyError, TypeError, ArgumentError) as error:
            raise StageError(
                f"seed {seed} is stored in {store.path}, but has no row, neither in {rows_path} nor in its "
                f"certificate; delete {store.path} and generate again"
            ) from error


def _record(experiment: Experiment, task: Task, row: Row, seeds: Sequence[int]) -> None:
    """Makes episodes once more, being recorded, where the recording is missing: same seed, same episode."""
    settings = experiment.settings(task, row)
    settings = replace(settings, brain=settings.brain.again())  # a model is not asked twice
    sweep(recording_path(experiment, task, row, "generate", 0).parent)
    for seed in seeds:
        path = recording_path(experiment, task, row, "generate", seed)
        if path.exists():
            continue
        world, title = simulator(task, experiment.pictures), f"{task.title}, {row.name}, scene {seed}"
        with whole(path) as draft, EpisodeRecorder(draft, task, world, title) as recorder:
            EpisodeMaker(settings, world, settings.make_brain(seed), recorder).make(seed)
        console.print(f"recorded {path}")
    close_simulator()


def generation_row(
    task: Task, row: Row, brain: str, outcome: Outcome, disturbance_rad: float = 0.0
) -> GenerationRow:
    """The row of one attempt under the constraints `row`."""
    return GenerationRow(
        task=task.name,
        constraints=row.name,
        brain=brain,
        seed=outcome.seed,
        success=outcome.success,
        success_paper=outcome.success_paper,
        steps=outcome.steps,
        attempts=outcome.attempts,
        wall_s=round(outcome.wall_s, 3),
        version=task.version,
        violations=outcome.violations,
        contacts=outcome.contacts,
        generator=generator_version(task),
        commit=commit(),
        disturbance_rad=disturbance_rad,
        account=outcome.account,
    )
