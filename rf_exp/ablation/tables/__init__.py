"""Tables from rows: the paper's tables with its figures beside ours. Pure functions.

A cell counts every attempt of the newest version of the success criteria, failed ones too; a note names
what is left out. Every success rate and episode length has the violations of the same attempts beside it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from rf_exp.ablation.results import Results
from rf_exp.ablation.tables.brains import brains
from rf_exp.ablation.tables.counting import ours, trial, unvaried
from rf_exp.ablation.tables.expert import ablation_length, ablation_success
from rf_exp.ablation.tables.known import Suite
from rf_exp.ablation.tables.notes import learnt_from
from rf_exp.ablation.tables.overview import benchmark, comparison, tasks
from rf_exp.ablation.tables.policies import architectures, final, foreign, recipes, shield
from rf_exp.ablation.tables.robustness import robustness
from rf_exp.ablation.tables.table import Table

TABLES: Mapping[str, Callable[[Results, Suite], Table]] = {
    builder.__name__: builder
    for builder in (
        *(tasks, comparison, benchmark, architectures, recipes, shield),
        *(ablation_success, ablation_length, foreign),
    )
}


def build(results: Results, suite: Suite) -> dict[str, Table]:
    """Every table, by name, for a suite of tasks; `robustness`, `final`, `brains` only if they have lines."""
    of_trial = trial(results)
    usual = unvaried(of_trial)
    own = ours(usual)  # without rollouts of foreign policies
    tables = {name: builder(usual if builder is foreign else own, suite) for name, builder in TABLES.items()}
    notes = learnt_from(own)
    tables = {name: replace(table, notes=(*table.notes, *notes)) for name, table in tables.items()}
    unseen = final(ours(unvaried(results)), suite)
    further = robustness(of_trial, suite), unseen, brains(usual, suite)
    return {**tables, **{table.name: table for table in further if table.lines}}
