"""Tables, report, and where to look: pure functions of the rows that are there."""

from rf_exp.ablation import configured, facts, publish, show
from rf_exp.experiment import Experiment
from rf_exp.progress import console
from rf_exp.stages.cell import owned

SHOWN = ("architectures", "recipes", "shield", "robustness", "final", "ablation_success", "ablation_length")


def write_tables(experiment: Experiment) -> None:
    """Writes tables and report, prints the tables that have figures, names the recordings."""
    with owned(experiment.out / "report.html"):
        tables, report = publish(experiment.out, {**configured(), **facts(experiment.tasks)})
    for name in SHOWN:
        if name in tables and tables[name].lines:
            show(tables[name], console)
    recordings = sorted((experiment.out / "recordings").rglob("*.rrd"))
    console.print(f"report: {report}")
    for path in recordings:
        console.print(f"recording: {path}")
    if recordings:
        console.print(f"look at one: rerun {recordings[-1]}")
