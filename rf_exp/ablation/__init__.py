"""Result rows, statistics, the paper's tables and the report. Never needs torch or a simulator."""

from rf_exp.ablation.formats import show
from rf_exp.ablation.plots import read_curves
from rf_exp.ablation.report import publish
from rf_exp.ablation.results import (
    PUBLISHED,
    Published,
    Results,
    load,
    read_published,
    read_rows,
    write_published,
)
from rf_exp.ablation.rollouts import FILM, PICTURE, of_training_seed, rollout_name, rows_file, worth_seeing
from rf_exp.ablation.rows import EvaluationRow, GenerationRow, append_row, newest, row_of
from rf_exp.ablation.statistics import Estimate, Paired, difference, mean, paired, wilson
from rf_exp.ablation.suite import configured, facts
from rf_exp.ablation.tables import (
    BASELINE_ARCH,
    BASELINE_CONSTRAINTS,
    Paper,
    both_ways,
    core_minutes,
    is_baseline,
    paper,
    robustness,
    title_of,
    unvaried,
)

__all__ = [
    "BASELINE_ARCH",
    "BASELINE_CONSTRAINTS",
    "FILM",
    "PICTURE",
    "PUBLISHED",
    "Estimate",
    "EvaluationRow",
    "GenerationRow",
    "Paired",
    "Paper",
    "Published",
    "Results",
    "append_row",
    "both_ways",
    "configured",
    "core_minutes",
    "difference",
    "facts",
    "is_baseline",
    "load",
    "mean",
    "newest",
    "of_training_seed",
    "paired",
    "paper",
    "publish",
    "read_curves",
    "read_published",
    "read_rows",
    "robustness",
    "rollout_name",
    "row_of",
    "rows_file",
    "show",
    "title_of",
    "unvaried",
    "wilson",
    "worth_seeing",
    "write_published",
]
