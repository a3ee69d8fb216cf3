"""Writes docs/policies.md, and a table of the README, from results/evaluate: python docs/policies.py"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import fmean

from omegaconf import OmegaConf

from rf_exp.ablation import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    EvaluationRow,
    configured,
    core_minutes,
    load,
    markdown_rows,
    newest,
    paper,
    title_of,
    wilson,
)
from rf_exp.types import FOREIGN

ROOT = Path(__file__).parents[1]
HEADING = (
    *("task", "arms", "architecture", "recipe", "demos", "strict", "95 % interval", "scenes"),
    *("paper's criterion", "the paper", "rollouts with a violation", "core-minutes", "queries"),
)
RUNG = (
    *("recipe", "what is otherwise", "strict", "95 % interval", "each training seed", "scenes"),
    *("rollouts with a violation", "core-minutes"),
)
README, BEGIN, END = ROOT / "README.md", "<!-- written by docs/policies.py -->", "<!-- end -->"
MOST = 3  # kinds of failures that are told of a policy
LADDER = ROOT / "conf" / "experiment" / "ladder.yaml"

INTRODUCTION = """\
# Policies, measured

Written by `python docs/policies.py` from the rows in `results/evaluate/`; a test compares. Every scene is a
seed from 1,000,000 on that generation never saw; all are counted, none is chosen. *Strict* is our
criterion, *paper's criterion* that of the paper for the same rollouts, *the paper* its figure, a dash where
it has none. A violation is a control step in which arms touched. Core-minutes are the CPU time of learning,
of all policies of the architecture together. Queries are the proposals that the expert was asked for where
policies had failed (`dagger.rounds`, below); without a number it never was.

```
python -m rf_exp.run -m experiment=benchmark          # eleven tasks, 50, 100 and 150 demonstrations
python -m rf_exp.run experiment=architectures         # four architectures, four tasks
```

Recipes are in `conf/policy/`. `paper` is the paper's. `fast` is ours:

- **Demonstrations that show how to come back** (`disturbance_rad`) and what to do when an arm is late
  (`delay_s`), see [laboratory.md](laboratory.md).
- **Eyes with millimetres** (`policy.encoder=heatmaps`). One heat map for each moment at which the own
  gripper changes, one for the end of the episode, one for each other arm: where the own TCP will be then,
  projected into the picture. The labels follow from stored joints, commands and the place of the camera; no
  pose of an object is used. They are learned first and then fixed, so that every picture is looked at once.
  `python benchmarks/eyes.py STORE` tells how many millimetres and degrees they are off on episodes they never
  saw. What they tell of each keypoint is a point (a polynomial of its place in the picture, 3 to 6 mm off at
  a grasp), that place itself (half a pixel off), and a heading. What moves through the room has no such
  point: for the hand of another arm the polynomial is 26 mm off in the median, and 70 to 100 mm in a tenth
  of the frames. Policies that were given that alone went to the stack while the other arm was still there
  (Two Robots Stack Cube: 70 of 100 scenes, 25 with a violation); given the place as well, 80 of 100 and 13.
  A second point of the hand, 10 cm across, lies where a tool works: Strike Cube rose from 94 to 100 of 100
  with it, and with pictures that are shifted at random while the heat maps are learned.
  Own cameras show what their agent works at, not the whole room: a pixel is 4 to 10 mm. They have to show
  whom it works with as well: with cameras of Camera Alignment in which each of the two that lift together saw
  the own hand alone, and the third not where the lens points, the same recipe reached 52 of 100, and with
  those of now 87.
  And from the picture as a whole they tell at which subgoal each other agent is: an arm that is done stands
  where it has begun, but what it has left behind does not.
- **A draft and its refinement** (`policy.draft`): a perceptron makes a chunk of actions, the diffusion
  U-Net says what to change about it.
- **Actions as motions of hands** (`policy.tcp_actions`): where the TCP goes is predicted beside the joints,
  and the joints follow it. In the laboratory, Two Robots Stack Cube rose from 24 to 32 of the same 40
  scenes by it.
- **Who may go on** (`policy.phases`). Each step of a demonstration is stored with the subgoal of its agent. A
  policy predicts from what it sees which one it is at, and whether it may go on or has to wait for another;
  its actions are made for that. Who has to wait stays exactly where it was sent last, and looks again 4 steps
  later. Without that, predictions between going and staying let arms drift from where they wait to where no
  demonstration has been. Where what precedes its leaving looks like what it has to wait through, it has
  learned a rate of leaving: a quarter, say, at every look, for ever. So the looks of a scene in which nothing
  changes add up (`policy.patience`). Rows of earlier commits are without.
- **Who goes carries its chunk out**, also where one policy commands several agents and another one waits and
  looks again. Cut short each time that one looks, a chunk never came to the step at which a gripper opens: in
  Two Robots Stack Cube one policy for both succeeded in 1 of 27 scenes so, and in 83 of 100 since.
- **Half of every batch from moments in which the own agent may go on** (`training.going`). In Long
  Pipeline Delivery an agent waits in 78 % of them, for a shoe that is not there yet, and learning went into
  that. How often it may go on is learned from all alike: there the drawn moments weigh less. With that, and
  1,000 steps for the heat maps in place of 500, 13 of 100 scenes became 56 (150 demonstrations), in the same
  core-minutes; what is near made them 82. Leaving out the keypoints of who waits, without drawing others, was
  worse than nothing (2 of 39): who decides whether to go on reads the same heat maps, which nothing held any
  more. Rows of commits
  before 3a741ff are without: all of `separate_local` with 150 demonstrations but Long Pipeline Delivery's.
  Three Robots Stack Cube reaches 91 of 100 with 50 demonstrations and 95 with 100 with it, 88 with 150
  without.
- Moments in which nobody moves are left out, chunks of 32 of which 12 are executed, the absolute error. How
  much of a chunk is executed decides nothing about what is learned: the same policies of the laboratory (Two
  Robots Stack Cube, 40 scenes from 2,000,000 on, one training seed) succeeded in 27 scenes when they executed
  24 steps, in 31 with 16, in 35 with 12, in 31 with 8.

What the last of these steps gave, Two Robots Stack Cube, 60 scenes from 2,000,000 on, one training seed:

| | strict | scenes with a violation |
|---|---|---|
| all but the following | 48 | 10 |
| demonstrations with delays; cameras that stand nearer | 42 | 2 |
| who goes nowhere moves nothing (`policy.hold_rad`) | 45 | 2 |
| who may go on; 12,000 in place of 6,000 steps of the draft | 56 | 2 |

Take Photo, the rates of its table (100 scenes, strict; the same policies):

| | strict | scenes with a violation |
|---|---|---|
| chances of going on add up (`policy.patience`), `policy.hold_rad` of 0.03 | 52 | 2 |
| of 0.01: what is three times as much holds a finger off that stands 3 mm above the shutter | 83 | 2 |

Before both, in trial scenes, about 15 %. Rows of the same earlier commits, but Take Photo's, are with 0.03.

With noise of 4 mm and 9 degrees on all that the eyes see, while the policy learns, 48 became 38:
not kept.

Rows of one table are not all by one version of the code; each tells its commit. Those of `state` and
`separate_coordinated` are by an older one, without delays and phases. All demonstrations are by generators 1
and 2 ([expert.md](expert.md)), but those behind Take Photo's row of 50 and Long Pipeline Delivery's of 150,
which are by generator 4. All rows but this last one are from before policies were told once more of what
their hand is near to, which is part of `fast` since ([laboratory.md](laboratory.md#what-is-near)): 56 of 100
became 82.

`separate_coordinated` is an architecture of ours: separate_local, and while policies act a coordinator tells
each its subgoal and when it has to wait (`rf_exp/datagen/coordinator.py`). It follows the arms along a plan
that RoboBrain and RoboChecker make in the true state of the scene, which the other architectures do not know.

`separate_both` is one too: beside the picture of its own camera each policy sees that of the global one. With
`task.NAME.cameras.agent1.mount=wrist` the own camera is eye in hand; heat maps need one that stands still,
the other encoders do not.

`fast+dagger1` is `fast` after one round of correction (`dagger.rounds=1`; Ross et al. 2011). The policies act
in 100 scenes of their own, from seed 900,000 on. Of each rollout that they lose, a moment in which somebody
moved is drawn; RoboBrain, planner and RoboChecker take over there, and carry the episode through. The
policies are learned anew from the same demonstrations and these, which are more than the number in the table
says. What the first policies did until then is stored too, but not learned.

`state` is the oracle: `fast` with the true poses of all things in place of pictures, no result beside the
paper's.
"""

STEPS = """\
The ladder (`python -m rf_exp.run -m experiment=ladder`): `fast`, and the same recipe without one of its steps
or with another one, where the main table leaves room to see it. Scenes are those of the table above, the same
for every rung and every training seed; the interval takes all rollouts of a rung for independent, which those
of one training seed are not quite. The core-minutes of heat maps that rungs share count for each of them."""


def cells(rows: Iterable[EvaluationRow]) -> Iterator[tuple[EvaluationRow, list[EvaluationRow]]]:
    """The rows of each policy, in the order of the paper's tasks, with one of them."""
    found: dict[tuple[object, ...], list[EvaluationRow]] = {}
    for row in rows:
        if row.constraints == BASELINE_CONSTRAINTS and row.arch != FOREIGN.name:
            key = (row.task, row.recipe, row.arch != BASELINE_ARCH, row.arch, row.demos, row.shield)
            found.setdefault(key, []).append(row)
    order = [*paper().levels, *sorted({row.task for row in rows} - {*paper().levels})]
    for _, group in sorted(found.items(), key=lambda item: (order.index(str(item[0][0])), *item[0][1:])):
        kept, _ = newest(group)
        yield kept[0], list(kept)


def of_paper(row: EvaluationRow) -> float | None:
    """The paper's figure for the same task, architecture and number of demonstrations; an oracle has none."""
    if row.observation == "state":
        return None
    if row.arch == BASELINE_ARCH:
        return paper().baseline.get(row.task, {}).get(row.demos)
    return paper().architectures.get(row.arch, {}).get(row.task) if row.demos == paper().demos[-1] else None


def strict(group: Sequence[EvaluationRow]) -> tuple[str, str]:
    """The share of the scenes that succeeded, and its 95 % interval."""
    rate = wilson(sum(row.success for row in group), len(group))
    return f"**{percent(rate.value)}**", f"{100 * rate.low:.0f} to {100 * rate.high:.0f}"


def line(row: EvaluationRow, group: list[EvaluationRow]) -> tuple[str, ...]:
    known = configured().get(row.task)
    figure, cost = of_paper(row), core_minutes(group)
    return (
        title_of(row.task, configured()),
        str(known.agents if known else paper().levels[row.task]),
        row.arch + ", shielded" * row.shield,
        row.recipe,
        str(row.demos),
        *strict(group),
        str(len(group)),
        percent(fmean(r.success_paper for r in group)),
        "-" if figure is None else percent(figure),
        percent(fmean(r.violations > 0 for r in group)),
        f"{cost:.1f}" if cost else "",
        str(row.queries or "-"),
    )


@cache
def rungs() -> list[str]:
    """The recipes of the ladder, `fast` first."""
    return str(OmegaConf.load(LADDER).hydra.sweeper.params.policy).replace(",", " ").split()


def step(recipe: str) -> str:
    """What the first line of a recipe says it does otherwise than `fast`, which says nothing so."""
    comment = (ROOT / "conf" / "policy" / f"{recipe}.yaml").read_text("utf-8").splitlines()[1:3]
    told = " ".join(line.removeprefix("# ") for line in comment if line.startswith("#"))
    return "" if recipe == rungs()[0] else re.split(r"\.(?: [A-Z]|$)", told.partition("): ")[2])[0]


def ladder(rows: Iterable[EvaluationRow]) -> list[str]:
    """What each step of the recipe gives: a table a task, a line a rung, all training seeds together."""
    alone, node = rungs()[1:], OmegaConf.load(LADDER)
    found: dict[tuple[str, str], list[EvaluationRow]] = {}
    for row in rows:
        plain = row.arch == BASELINE_ARCH and row.constraints == BASELINE_CONSTRAINTS and not row.shield
        if plain and row.demos == node.demos and row.recipe in rungs():
            found.setdefault((row.task, row.recipe), []).append(row)
    parts = []
    for task in paper().levels:
        if not any((task, recipe) in found for recipe in alone):
            continue
        lines = [
            rung(recipe, list(newest(found[task, recipe])[0]))
            for recipe in rungs()
            if (task, recipe) in found
        ]
        parts += ["", f"{title_of(task, configured())}, {node.demos} demonstrations:", ""]
        parts += markdown_rows(RUNG, lines)
    return parts


def rung(recipe: str, group: list[EvaluationRow]) -> tuple[str, ...]:
    """The line of a rung."""
    seeds = sorted({row.train_seed for row in group})
    each = [fmean(row.success for row in group if row.train_seed == seed) for seed in seeds]
    return (
        recipe,
        step(recipe),
        *strict(group),
        ", ".join(f"{100 * share:.0f}" for share in each),
        str(len(group)),
        percent(fmean(row.violations > 0 for row in group)),
        f"{core_minutes(group):.1f}",
    )


def failures(row: EvaluationRow, group: list[EvaluationRow]) -> str:
    """What failed most often, in one line."""
    kinds = Counter(r.account.kind for r in group if not r.success)
    told = "; ".join(f"{count} times {kind}" for kind, count in kinds.most_common(MOST))
    more = sum(kinds.values()) - sum(count for _, count in kinds.most_common(MOST))
    name = f"{title_of(row.task, configured())}, {row.arch}, {row.recipe}, {row.demos}"
    return f"- **{name}{', shielded' * row.shield}**: {told}{f'; {more} others' if more else ''}."


def of_table(row: EvaluationRow) -> bool:
    """Whether it is by our recipe, with as many demonstrations as the paper's table of architectures."""
    return row.recipe == "fast" and row.demos == paper().demos[-1] and not row.shield


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def architectures(found: Mapping[tuple[str, str], list[EvaluationRow]]) -> list[str]:
    """The paper's second table: strict, its figure behind; a dash where nothing was measured."""
    known = paper().architectures
    asked = {task for each in known.values() for task in each}
    asked |= {task for task, arch in found if arch in known and arch != BASELINE_ARCH}
    tasks = [task for task in paper().levels if task in asked]
    rows = []
    for arch, figures in known.items():
        cells = [arch]
        for task in tasks:
            group, theirs = found.get((task, arch)), figures.get(task)
            ours = f"**{percent(fmean(r.success for r in group))}**" if group else "-"
            cells.append(ours if theirs is None else f"{ours} ({percent(theirs)})")
        rows.append(cells)
    return markdown_rows(("architecture", *(title_of(task, configured()) for task in tasks)), rows)


def document() -> str:
    rows = load(ROOT).evaluation
    groups = list(cells(row for row in rows if row.recipe not in rungs()[1:]))
    parts = [
        INTRODUCTION,
        "## Success",
        "",
        *markdown_rows(HEADING, (line(row, group) for row, group in groups)),
    ]
    ours = {(row.task, row.demos) for row, _ in groups if row.arch == BASELINE_ARCH and row.recipe == "fast"}
    missing = [
        f"{title_of(task, configured())} ({', '.join(map(str, counts))})"
        for task in paper().levels
        if (counts := [demos for demos in paper().demos if (task, demos) not in ours])
    ]
    if missing:
        parts += ["", f"Not measured yet, recipe `fast`, `{BASELINE_ARCH}`: {'; '.join(missing)}."]
    parts += [
        "",
        f"The paper's architectures, recipe `fast`, {paper().demos[-1]} demonstrations (its own figures):",
    ]
    of_all = {(row.task, row.arch): group for row, group in groups if of_table(row)}
    parts += ["", *architectures(of_all)]
    if steps := ladder(rows):
        parts += ["", "## What each step gives", "", STEPS, *steps]
    failed = [failures(row, group) for row, group in groups if not all(r.success for r in group)]
    if failed:
        parts += [
            "",
            "## What failed",
            "",
            "Conditions that did not hold at the end, and what came before.",
            "",
        ]
    commits = sorted({row.commit for row in rows})
    parts += [*failed, "", f"Made by the code of commits {', '.join(commits)}." if commits else ""]
    return "\n".join(parts).rstrip() + "\n"


def readme() -> str:
    """The README with the rates of our recipe at the largest number of demonstrations beside the paper's."""
    found = {
        row.task: (row, group)
        for row, group in cells(load(ROOT).evaluation)
        if row.arch == BASELINE_ARCH and of_table(row)
    }
    lines = []
    for task, agents in paper().levels.items():
        if task in found:
            row, group = found[task]
            rate, figure = fmean(r.success for r in group), of_paper(row)
            ours, theirs = f"**{percent(rate)}**", percent(figure) if figure is not None else "-"
            lines.append((title_of(task, configured()), str(agents), ours, theirs))
    before, _, rest = README.read_text("utf-8").partition(BEGIN)
    return "\n".join(
        [
            before + BEGIN,
            *markdown_rows(("task", "arms", "rf_exp", "paper"), lines),
            END + rest.partition(END)[2],
        ]
    )


if __name__ == "__main__":
    (Path(__file__).parent / "policies.md").write_text(document(), "utf-8")
    README.write_text(readme(), "utf-8")
