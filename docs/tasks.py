"""Writes docs/tasks.md from conf/task and the task modules: python docs/tasks.py"""

import textwrap
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from rf_exp.ablation import paper
from rf_exp.command import CONF
from rf_exp.tasks import SuccessEvaluator, Task, load_task
from rf_exp.types import Scene

INTRODUCTION = """\
# The tasks

Written by `python docs/tasks.py` from `conf/task/` and the task modules; a test compares. `make gallery`
makes these pictures, a sheet with all views, and a film of each task.

![Every task in the middle of an expert episode](images/gallery.jpg)

Every seed draws a start: where things stand and how they are turned, a little noise on the rest posture of
every arm, the brightness of the light and of every colour. Every arm is a Franka Panda with a camera view
of its own; the global view sees all.

An attempt is judged twice. **Strict**: all conditions listed hold at the same time, for several control
steps; and of a policy, no two arms have touched until then. **The paper's**: the target condition as the
authors' release tests it, which is looser; every rate in the tables is the strict one, with the paper's
beside it. Next to it stand the violations: for policies the share of rollouts in which arms touched each
other and the mean number of control steps in which they did; for generation the share of seeds with a
proposal that ended in a violation and the mean number of such proposals. Where it differs, the strict rate
without any violation is given as well.

The four tasks listed after the paper's are official ones of the MARS challenge (NeurIPS 2025), with their
scenes. Of these "the paper's criterion" means that of the challenge's release, and the tables of the paper
leave them out or have them last.
"""


def tasks() -> list[Task]:
    """The paper's tasks in its order, then all further ones."""
    paths = {path.stem: path for path in sorted((CONF / "task").glob("*.yaml"))}
    names = [name for name in paper().levels if name in paths]
    names += [name for name in paths if name not in names]
    return [load_task(name, OmegaConf.to_container(OmegaConf.load(paths[name]))[name]) for name in names]


def conditions(task: Task) -> list[str]:
    """The names of the strict conditions, as the module gives them for a start."""
    start = task.start(0)
    still = dict.fromkeys(start.poses, 0.0)
    scene = Scene(0, start.qpos, np.zeros_like(start.qpos), start.poses, still, (None,) * len(task.agents))
    return list(SuccessEvaluator(task, scene)(scene).evidence)


def section(task: Task) -> str:
    arms = "one arm" if len(task.agents) == 1 else f"{len(task.agents)} arms"
    config = f"[configuration](../conf/task/{task.name}.yaml)"
    module = f"[module](../rf_exp/tasks/{task.name}.py)"
    condition_label = "The paper's target condition" if task.name in paper().levels else "Target condition"
    strict = f"- Strict: {'; '.join(conditions(task))}; for {task.success['hold_steps']:g} steps."
    lines = [
        f"`{task.name}`, {arms}, criteria version {task.version}: {config}, {module}.",
        task.description,
        f"- {condition_label}: {task.target_condition}",
        strict,
    ]
    filled = [textwrap.fill(line, 108, subsequent_indent="  " * line.startswith("- ")) for line in lines]
    shown = f"![{task.title}: start, middle and end of an expert episode](images/tasks/{task.name}.jpg)"
    return f"## {task.title}\n\n{filled[0]}\n\n{filled[1]}\n\n{shown}\n\n{filled[2]}\n{filled[3]}\n"


def document() -> str:
    return "\n".join([INTRODUCTION, *map(section, tasks())])


if __name__ == "__main__":
    Path(__file__).with_suffix(".md").write_text(document(), "utf-8")
