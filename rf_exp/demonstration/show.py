"""Makes the episode of a seed and writes its page, recording and certificate."""

from pathlib import Path

from rf_exp.artifacts import atomic_path, plain, write_json
from rf_exp.datagen import EpisodeGenerator, Outcome, Settings, Trace
from rf_exp.demonstration.episode_log import EpisodeLog, ObserverGroup
from rf_exp.demonstration.page import specification, write_page
from rf_exp.progress import console
from rf_exp.recording import EpisodeRecorder
from rf_exp.sim import shared_simulator
from rf_exp.types import CONTROL_DT_S, Pictures


def demonstrate(settings: Settings, pictures: Pictures, seed: int, folder: Path) -> Outcome:
    """Makes the episode of a seed. Writes a success to `<task>-<seed>.html`, .md, .rrd, .json in `folder`."""
    task, constraint_set = settings.task, settings.constraint_set
    simulator, trace = shared_simulator(task, pictures), Trace()
    episode_log = EpisodeLog(task, settings.make_brain(seed))
    page = folder / f"{task.name}-{seed}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(page.with_suffix(".rrd")) as draft:
        title = f"{task.title}, {constraint_set.name}, scene {seed}"
        with EpisodeRecorder(draft, task, simulator, title) as recorder:
            observers = ObserverGroup(recorder, episode_log, trace)
            outcome = EpisodeGenerator(settings, simulator, episode_log, observers).make(seed)
    if outcome.episode is not None:
        plans = [specification(planned.checked, execution) for planned, execution in trace.executions()]
        end = simulator.images()["global"] if simulator.cameras else None
        write_page(page, settings, outcome, episode_log.rounds, plans, end)
        write_json(
            page.with_suffix(".json"), {"certificate": plain(outcome.episode.certificate), "stl": plans}
        )
        console.print(f"{task.name}, seed {seed}: success after {outcome.steps * CONTROL_DT_S:.1f} s")
        console.print(f"page: {page.with_suffix('.html')}")
        console.print(f"recording: rerun {page.with_suffix('.rrd')}")
    else:
        page.with_suffix(".rrd").unlink()
    return outcome
