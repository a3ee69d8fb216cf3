"""Selection and order of the rows of tables, and the cells computed from them.

Every attempt of the newest version of the criteria counts, failed ones too.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import filterfalse
from statistics import fmean

from rf_exp.ablation.results import Results
from rf_exp.ablation.rows import EvaluationRow, GenerationRow, grouped, newest
from rf_exp.ablation.statistics import mean, wilson
from rf_exp.ablation.tables.inputs import paper
from rf_exp.ablation.tables.table import Length, Rate, Violations
from rf_exp.types import FOREIGN, UNVARIED

BASELINE_ARCH = "separate_local"  # the paper's fourth, used for its benchmark
COORDINATED_ARCH = "separate_coordinated"  # ours
BASELINE_CONSTRAINTS = "full"  # of the demonstrations that the paper's policies learn from
BASELINE_BRAIN = "scripted"


def tasks_of(known: Iterable[str], rows: Iterable[GenerationRow | EvaluationRow]) -> list[str]:
    """The known tasks in their order, then any further one that has rows."""
    listed = list(dict.fromkeys(known))
    return listed + sorted({row.task for row in rows} - set(listed))


def unshielded(results: Results) -> list[EvaluationRow]:
    """The rollouts without a shield; shielded ones have a table of their own."""
    return [row for row in results.evaluation if not row.shield]


def without_foreign(results: Results) -> Results:
    """The results without rollouts of foreign policies."""
    return replace(results, evaluation=tuple(row for row in results.evaluation if row.arch != FOREIGN.name))


def varies(row: EvaluationRow) -> bool:
    """Whether the scenes varied, or those of the demonstrations."""
    return {row.variation, row.learned_on} != {UNVARIED}


def without_variation(results: Results) -> Results:
    """The results of scenes and policies without variation, for all tables but `robustness`."""
    generation = tuple(row for row in results.generation if row.variation == UNVARIED)
    return replace(results, generation=generation, evaluation=tuple(filterfalse(varies, results.evaluation)))


def without_final(results: Results) -> Results:
    """The results without final scenes, which `final` alone counts."""
    return replace(results, evaluation=tuple(row for row in results.evaluation if not row.final))


def is_baseline(row: EvaluationRow) -> bool:
    return (row.arch, row.constraints) == (BASELINE_ARCH, BASELINE_CONSTRAINTS)


def with_all_constraints(rows: Iterable[EvaluationRow]) -> list[EvaluationRow]:
    """The rollouts of policies that learnt from demonstrations under all constraints."""
    return [row for row in rows if row.constraints == BASELINE_CONSTRAINTS]


def demos_of(rows: Iterable[EvaluationRow]) -> list[int]:
    """The paper's numbers of demonstrations and any further one that has rows."""
    return sorted({*paper().demos, *(row.demos for row in rows if is_baseline(row))})


def recipes_of(rows: Iterable[EvaluationRow]) -> list[str]:
    """The recipes that have rows: first the one with the most, last those given the privileged state.

    Of equally many, the ones that profiles choose come first, as others are derived from them.
    """
    privileged = {row.recipe: row.observation == "state" for row in rows}
    counts = Counter(row.recipe for row in rows)
    key = {name: (privileged[name], -counts[name], name not in ("fast", "paper"), name) for name in counts}
    return sorted(counts, key=key.__getitem__) or ["paper"]


def recipe_suffix(recipe: str, recipes: Sequence[str]) -> str:
    """The suffix of line keys for recipes after the first."""
    return "" if recipe == recipes[0] else f"-{recipe}"


def group_attempts(results: Results) -> dict[tuple[str, str, str, bool], list[GenerationRow]]:
    """The attempts by task, constraints, brain, and whether the demonstration is disturbed."""
    return grouped(
        results.generation, lambda row: (row.task, row.constraints, row.brain, row.disturbance_rad > 0)
    )


def split_by_shield(rows: Sequence[EvaluationRow]) -> tuple[list[EvaluationRow], list[EvaluationRow]]:
    """Rows without and with a shield: of the scenes that have both, or all rows if no scene has.

    Rows are of one version of the criteria.
    """
    scenes_by_shield = [
        {(r.train_seed, r.scene_seed) for r in rows if r.shield is shield} for shield in (False, True)
    ]
    shared_scenes = scenes_by_shield[0] & scenes_by_shield[1]
    compared = [r for r in rows if not shared_scenes or (r.train_seed, r.scene_seed) in shared_scenes]
    return [r for r in compared if not r.shield], [r for r in compared if r.shield]


def core_minutes(rows: Iterable[EvaluationRow]) -> float:
    """CPU minutes of learning behind the rollouts of one architecture, the mean of its training seeds."""
    return fmean({row.train_seed: row.core_s for row in rows}.values()) / 60


def rate(rows: Iterable[GenerationRow | EvaluationRow], paper_value: float | None) -> Rate:
    """The rate of strict success over every attempt, also without a violation, with Wilson's intervals."""
    counted, note = newest(rows)
    if not counted:
        return Rate(paper=paper_value)
    estimate = wilson(sum(row.success for row in counted), len(counted))
    seeds = {row.train_seed for row in counted if isinstance(row, EvaluationRow)}
    seeds_note = f"{len(seeds)} training seeds together" if len(seeds) > 1 else ""
    return Rate(
        value=estimate.value,
        n=len(counted),
        interval=estimate.interval,
        paper=paper_value,
        note="; ".join(filter(None, [note, seeds_note])),
        success_paper=sum(row.success_paper for row in counted) / len(counted),
        version=counted[0].version,
        clean=wilson(sum(row.success and not row.violations for row in counted), len(counted)),
    )


def length(rows: Iterable[GenerationRow], paper_value: float | None) -> Length:
    """Mean control steps of the successful episodes, with Student's t interval."""
    counted, note = newest(rows)
    if not counted:
        return Length(paper=paper_value)
    version, steps = counted[0].version, [float(row.steps) for row in counted if row.success]
    if not steps:
        message = "; ".join(filter(None, [f"no success in {len(counted)} attempts", note]))
        return Length(placeholder="no success", paper=paper_value, note=message, version=version)
    estimate = mean(steps)
    interval = estimate.interval if len(steps) > 1 else None
    return Length(estimate.value, len(steps), interval, note, version, paper=paper_value)


def violations(rows: Iterable[GenerationRow | EvaluationRow], field: str = "violations") -> Violations:
    """The share of attempts with at least one violation, with Wilson's interval, and the mean number.

    `field` may name another field to be counted alike.
    """
    counted, note = newest(rows)
    if not counted:
        return Violations()
    counts = [getattr(row, field) for row in counted]
    share = wilson(sum(count > 0 for count in counts), len(counted))
    version = counted[0].version
    return Violations(share.value, share.n, share.interval, note, version, mean_violations=fmean(counts))


def rates(
    rows: Sequence[GenerationRow | EvaluationRow], paper_value: float | None = None
) -> tuple[Rate, Violations]:
    """The rate of success, and the violations of the same attempts."""
    return rate(rows, paper_value), violations(rows)


def lengths(rows: Sequence[GenerationRow], paper_value: float | None) -> tuple[Length, Violations]:
    """The length of the successful episodes, and the violations on the way to them."""
    mean_length = length(rows, paper_value)
    if mean_length.placeholder:
        return mean_length, Violations(placeholder=mean_length.placeholder, version=mean_length.version)
    return mean_length, violations([row for row in newest(rows)[0] if row.success])


def average(cells: Sequence[Rate | Violations], paper_value: float | None) -> Rate | Violations:
    """The mean of the figures of a level; missing until every task of it was measured."""
    values = [cell.value for cell in cells if cell.value is not None]
    note = f"{len(values)} of {len(cells)} tasks measured" if values else ""
    missing = len(values) < len(cells)
    value, n, note = (None, 0, note) if missing else (fmean(values), sum(cell.n for cell in cells), "")
    means = [cell.mean_violations for cell in cells if isinstance(cell, Violations)]
    if not means:
        return Rate(value, n, note=note, paper=paper_value)
    measured = [each for each in means if each is not None]
    return Violations(
        value, n, note=note, mean_violations=None if missing or not measured else fmean(measured)
    )
