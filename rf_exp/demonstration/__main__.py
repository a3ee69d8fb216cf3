"""One episode on a page, with its recording (paper, figure of RoboChecker at work).

python -m rf_exp.demonstration                       Take Photo
python -m rf_exp.demonstration task=lift_barrier     any other task
"""

import sys
from pathlib import Path

from omegaconf import DictConfig

from rf_exp.artifacts import plain, whole, write_json
from rf_exp.command import composed, guarded, settled
from rf_exp.datagen import EpisodeMaker, Outcome, Settings, Trace
from rf_exp.demonstration.notes import Notes, Together
from rf_exp.demonstration.page import specified, write_page
from rf_exp.errors import ArgumentError, StageError
from rf_exp.experiment import read_experiment
from rf_exp.progress import console
from rf_exp.recording import EpisodeRecorder
from rf_exp.sim import close_shared_simulator, shared_simulator
from rf_exp.types import CONTROL_DT_S, Pictures

SEEDS = 20  # tried for one success


@composed("demonstration")
def main(config: DictConfig) -> None:
    """A page for every chosen task, of the first seed that succeeds."""
    experiment = read_experiment(settled(config))
    if len(experiment.constraint_sets) != 1:
        names = ", ".join(row.name for row in experiment.constraint_sets)
        raise ArgumentError(
            f"a demonstration is of one row of constraints, got {names}; use constraints=full"
        )
    for task in experiment.tasks:
        settings = experiment.settings(task, experiment.constraint_sets[0])
        folder, last = experiment.out / "demonstrations", experiment.seed + SEEDS - 1
        for seed in range(experiment.seed, last + 1):
            outcome = demonstrate(settings, experiment.pictures, seed, folder)
            if outcome.success:
                break
            console.print(f"{task.name}, seed {seed}: {outcome.reason}")
        else:
            raise StageError(f"{task.name}: no success in seeds {experiment.seed} to {last}")
    close_shared_simulator()


def demonstrate(settings: Settings, pictures: Pictures, seed: int, folder: Path) -> Outcome:
    """Makes the episode of a seed; of a success `<task>-<seed>.html`, `.md`, `.rrd`, `.json` in `folder`."""
    task, constraint_set = settings.task, settings.constraint_set
    world, trace = shared_simulator(task, pictures), Trace()
    notes = Notes(task, settings.make_brain(seed))
    page = folder / f"{task.name}-{seed}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    with whole(page.with_suffix(".rrd")) as draft:
        title = f"{task.title}, {constraint_set.name}, scene {seed}"
        with EpisodeRecorder(draft, task, world, title) as recorder:
            observers = Together(recorder, notes, trace)
            outcome = EpisodeMaker(settings, world, notes, observers).make(seed)
    if outcome.episode is not None:
        plans = [specified(made.checked, execution) for made, execution in trace.executions()]
        end = world.images()["global"] if world.cameras else None
        write_page(page, settings, outcome, notes.rounds, plans, end)
        write_json(
            page.with_suffix(".json"), {"certificate": plain(outcome.episode.certificate), "stl": plans}
        )
        console.print(f"{task.name}, seed {seed}: success after {outcome.steps * CONTROL_DT_S:.1f} s")
        console.print(f"page: {page.with_suffix('.html')}")
        console.print(f"recording: rerun {page.with_suffix('.rrd')}")
    else:
        page.with_suffix(".rrd").unlink()
    return outcome


if __name__ == "__main__":
    sys.exit(guarded(main))
