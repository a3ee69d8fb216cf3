"""Renders expert episodes of all tasks, gallery.jpg and tasks/: python docs/images/gallery.py"""

from pathlib import Path

from rf_exp.datagen import Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.gallery import overview, panel, perform, strip
from rf_exp.installed import CONF
from rf_exp.sim import Simulator
from rf_exp.tasks import read_task
from rf_exp.types import ConstraintSet

HERE = Path(__file__).parent
QUALITY = 85  # of JPEG
WIDTH_PX, HEIGHT_PX = 1280, 960  # larger than shown, for smooth edges also in close-ups


def main() -> None:
    tasks = sorted(map(read_task, sorted((CONF / "task").glob("*.yaml"))), key=lambda task: len(task.agents))
    panels = []
    (HERE / "tasks").mkdir(exist_ok=True)
    for task in tasks:
        with Simulator(task, width_px=WIDTH_PX, height_px=HEIGHT_PX) as world:
            performance, reason = perform(
                Settings.configured(task, ConstraintSet("full"), ScriptedSpec()), world, 0
            )
        if performance is None:
            raise SystemExit(f"{task.name}: {reason}")
        panels.append(panel(task, performance))
        strip(task, performance).save(HERE / "tasks" / f"{task.name}.jpg", quality=QUALITY)
    overview(panels).save(HERE / "gallery.jpg", quality=QUALITY)


if __name__ == "__main__":
    main()
