"""Which rows a table is of: whose demonstrations, which policies, and in which order."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, GenerationRow
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables.published import paper
from rf_exp.types import FOREIGN, UNVARIED

BASELINE_ARCH = "separate_local"  # the paper's fourth, used for its benchmark
COORDINATED_ARCH = "separate_coordinated"  # ours
BASELINE_CONSTRAINTS = "full"  # whose demonstrations the paper's policies learn from
BASELINE_BRAIN = "scripted"


def tasks_of(known: Iterable[str], rows: Iterable[GenerationRow | EvaluationRow]) -> list[str]:
    """The known tasks in their order, then any further one that has rows."""
    listed = list(dict.fromkeys(known))
    return listed + sorted({row.task for row in rows} - set(listed))


def agents_of(task: str, suite: Suite) -> int | None:
    known = suite.get(task)
    return known.agents if known else paper().levels.get(task)


def unshielded(results: Results) -> Results:
    """The results without shielded rollouts, which have a table of their own."""
    return replace(results, evaluation=tuple(row for row in results.evaluation if not row.shield))


def ours(results: Results) -> Results:
    """The results without rollouts of policies that are somebody else's."""
    return replace(results, evaluation=tuple(row for row in results.evaluation if row.arch != FOREIGN.name))


def unvaried(results: Results) -> Results:
    """The results of scenes and policies without variation, of which all tables are but `robustness`."""
    generated = tuple(row for row in results.generation if row.variation == UNVARIED)
    acted = (row for row in results.evaluation if {row.variation, row.learned_on} == {UNVARIED})
    return replace(results, generation=generated, evaluation=tuple(acted))


def others(results: Results) -> Results:
    """The results with these rollouts alone."""
    return replace(results, evaluation=tuple(row for row in results.evaluation if row.arch == FOREIGN.name))


def is_baseline(row: EvaluationRow) -> bool:
    return (row.arch, row.constraints) == (BASELINE_ARCH, BASELINE_CONSTRAINTS)


def demos_of(results: Results) -> list[int]:
    """The paper's numbers of demonstrations and any further one that has rows."""
    used = {row.demos for row in results.evaluation if is_baseline(row)}
    return sorted({*paper().demos, *used})


def recipes_of(rows: Iterable[EvaluationRow]) -> list[str]:
    """The recipes that have rows: first the one with the most, last those that are told the state.

    Of those with as many, the ones that profiles choose come first: others differ from them.
    """
    privileged = {row.recipe: row.observation == "state" for row in rows}
    counts = Counter(row.recipe for row in rows)
    of_profiles = ("fast", "paper")
    key = {name: (privileged[name], -counts[name], name not in of_profiles, name) for name in counts}
    return sorted(counts, key=key.__getitem__) or ["paper"]


def but_first(recipe: str, recipes: Sequence[str]) -> str:
    """What the key of a line of a further recipe ends with."""
    return "" if recipe == recipes[0] else f"-{recipe}"


def generated(
    results: Results, task: str, constraints: str, brain: str, disturbed: bool = False
) -> list[GenerationRow]:
    wanted = (task, constraints, brain, disturbed)
    return [
        row
        for row in results.generation
        if (row.task, row.constraints, row.brain, row.disturbance_rad > 0) == wanted
    ]


def both_ways(rows: Sequence[EvaluationRow]) -> tuple[list[EvaluationRow], list[EvaluationRow]]:
    """Rows without and with a shield: of the scenes that have both, or all where none has.

    Rows are of one version of the criteria.
    """
    scenes = [{(r.train_seed, r.scene_seed) for r in rows if r.shield is way} for way in (False, True)]
    both = scenes[0] & scenes[1]
    compared = [r for r in rows if not both or (r.train_seed, r.scene_seed) in both]
    return [r for r in compared if not r.shield], [r for r in compared if r.shield]


def core_minutes(rows: Iterable[EvaluationRow]) -> float:
    """CPU time of learning behind the rollouts of one architecture, the mean of its training seeds."""
    return fmean({row.train_seed: row.core_s for row in rows}.values()) / 60
