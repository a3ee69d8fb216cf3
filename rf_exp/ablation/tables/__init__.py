"""Tables from rows: the paper's tables with its figures beside ours. Pure functions.

A cell counts every attempt of the newest version of the success criteria, failed ones too; a note names
what is left out. Every success rate and episode length has the violations of the same attempts beside it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from rf_exp.ablation.results import Results
from rf_exp.ablation.tables.brains import brains
from rf_exp.ablation.tables.counting import without_final, without_foreign, without_variation
from rf_exp.ablation.tables.expert import ablation_length, ablation_success
from rf_exp.ablation.tables.inputs import Suite
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
    trial = without_final(results)
    nominal = without_variation(trial)
    own_results = without_foreign(nominal)  # without rollouts of foreign policies
    tables = {
        name: builder(nominal if builder is foreign else own_results, suite)
        for name, builder in TABLES.items()
    }
    notes = learnt_from(own_results)
    tables = {name: replace(table, notes=(*table.notes, *notes)) for name, table in tables.items()}
    final_table = final(without_foreign(without_variation(results)), suite)
    optional = robustness(trial, suite), final_table, brains(nominal, suite)
    return {**tables, **{table.name: table for table in optional if table.lines}}
