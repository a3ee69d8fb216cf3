"""Contact sheet, strip and film of each task, and an overview."""

from pathlib import Path

from rf_exp.artifacts import atomic_path
from rf_exp.errors import StageError
from rf_exp.experiment import Experiment
from rf_exp.gallery.draw import contact_sheet, film, overview, panel, strip
from rf_exp.gallery.performance import Performance, perform
from rf_exp.progress import console
from rf_exp.sim import Simulator
from rf_exp.tasks import Task

WIDTH_PX, HEIGHT_PX = 640, 480
TRIES = 20  # seeds per task
QUALITY = 85  # of JPEG


def write_gallery(experiment: Experiment, folder: Path) -> None:
    """Draws every task of an experiment into a folder, and an overview of those that succeed.

    Raises StageError at the end if no episode of some task succeeded.
    """
    panels, failed = [], []
    for task in sorted(experiment.tasks, key=lambda task: len(task.agents)):
        with Simulator(task, width_px=WIDTH_PX, height_px=HEIGHT_PX) as world:
            try:
                performance = _first_success(experiment, task, world)
            except StageError as error:
                console.print(f"{task.name}: {error}")
                failed.append(task.name)
                continue
            panels.append(panel(task, performance))
            with atomic_path(folder / f"{task.name}.jpg") as draft:
                strip(task, performance).save(draft, quality=QUALITY)
            with atomic_path(folder / f"{task.name}.png") as draft:
                contact_sheet(task, performance.stills, performance.seed).save(draft)
            with atomic_path(folder / f"{task.name}.mp4") as draft:
                film(draft, task, performance, world)
            console.print(f"{task.name}: {folder / task.name}.png, .jpg and .mp4")
    if panels:
        with atomic_path(folder / "gallery.png") as draft:
            overview(panels).save(draft)
        console.print(f"{len(panels)} tasks: {folder / 'gallery.png'}")
    if failed:
        raise StageError(f"no episode to show of {', '.join(failed)}; the reasons are above")


def _first_success(experiment: Experiment, task: Task, world: Simulator) -> Performance:
    """The expert's episode of the first successful seed of TRIES from `seed` on. Raises StageError."""
    settings, reason = experiment.settings(task, experiment.constraint_sets[0]), ""
    for seed in range(experiment.seed, experiment.seed + TRIES):
        performance, reason = perform(settings, world, seed)
        if performance is not None:
            console.print(f"{task.name}: seed {seed}, {performance.seconds:.1f} s")
            return performance
        console.print(f"{task.name}: seed {seed} failed: {reason}")
    raise StageError(f"none of the {TRIES} seeds from {experiment.seed} on succeeded, the last: {reason}")
