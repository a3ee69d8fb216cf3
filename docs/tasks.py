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
renders these pictures, a sheet with all views, and a film of each task.

![Every task in the middle of an expert episode](images/gallery.jpg)

Each seed determines the initial scene: object positions and orientations, a small deviation of each arm
from its rest posture, the brightness of the light and of each colour channel. Each arm is a Franka Panda
with its own camera; the global camera covers the whole scene.

Each attempt is judged by two criteria. **Strict**: all listed conditions hold at the same time for several
control steps and, for policies, no two arms have touched before. **The paper's**: the target condition as
tested by the authors' release, which is looser. Rates in the tables are strict, next to the paper's
criterion. Violations are also reported: for policies the share of rollouts in which arms touched and the
mean number of control steps with contact; for generation the share of seeds with a proposal that ended in a
violation and the mean number of such proposals. The strict rate without any violation is added if it
differs.

The four tasks after the paper's are official tasks of the MARS challenge (NeurIPS 2025), with their scenes.
For them "the paper's criterion" is that of the challenge's release; tables of the paper omit them or list
them last.
"""


def tasks() -> list[Task]:
    """The paper's tasks in its order, then all others."""
    paths = {path.stem: path for path in sorted((CONF / "task").glob("*.yaml"))}
    names = [name for name in paper().levels if name in paths]
    names += [name for name in paths if name not in names]
    return [load_task(name, OmegaConf.to_container(OmegaConf.load(paths[name]))[name]) for name in names]


def conditions(task: Task) -> list[str]:
    """Names of the strict conditions of a task, from its start of seed 0."""
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
