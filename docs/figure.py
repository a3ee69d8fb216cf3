"""Figure of docs/policies.md and README.md: success over the number of demonstrations, one panel per task."""

import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rf_exp.ablation import Estimate

# The background is transparent; these colours are legible on light and on dark pages.
INK, FAINT, OURS, PAPER = "#768390", "#76839055", "#2f81f7", "#d9702e"
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: searchable and comparable
    "svg.hashsalt": "policies",
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": FAINT,
    "xtick.color": INK,
    "ytick.color": INK,
}
COLUMNS = 4
# title, number of demonstrations -> our rate, number of demonstrations -> the paper's rate
Panel = tuple[str, Mapping[int, Estimate], Mapping[int, float]]


def figure(panels: Sequence[Panel]) -> str:
    """SVG text; the last cell holds the legend, and its description the plotted values (`described`)."""
    with rc_context(STYLE):
        rows = len(panels) // COLUMNS + 1
        drawing = Figure((9.2, 1.75 * rows), layout="constrained")
        grid = drawing.subplots(rows, COLUMNS, sharex=True, sharey=True).ravel()
        for axes, panel in zip(grid, panels, strict=False):
            _panel(axes, panel)
        for axes in grid[len(panels) :]:
            axes.axis("off")
        for axes in grid[-COLUMNS : len(panels)]:
            axes.set_xlabel("demonstrations")
        handles, labels = grid[0].get_legend_handles_labels()
        grid[-1].legend(handles, labels, loc="center", frameon=False)
        buffer = io.StringIO()
        metadata = {"Date": None, "Description": described(panels)}
        drawing.savefig(buffer, format="svg", metadata=metadata, transparent=True)
    return re.sub(r" +$", "", buffer.getvalue(), flags=re.MULTILINE)


def described(panels: Sequence[Panel]) -> str:
    """Plotted values as text: by number of demonstrations our rate, interval, the paper's in brackets."""
    lines = []
    for title, ours, paper in panels:
        rates = (
            f"{n}: {rate.value:.1%}, {rate.low:.1%} to {rate.high:.1%} ({paper[n]:.0%})"
            for n, rate in sorted(ours.items())
        )
        lines.append(f"{title}: {'; '.join(rates)}")
    return "Strict success. " + " | ".join(lines)


def _panel(axes: Axes, panel: Panel) -> None:
    title, ours, paper = panel
    demos = sorted(ours)
    paper_style: dict[str, Any] = {"color": PAPER, "mfc": "none", "ms": 4.5, "lw": 1.1, "label": "the paper"}
    axes.plot(sorted(paper), [100 * paper[n] for n in sorted(paper)], "D--", **paper_style)
    our_style: dict[str, Any] = {"color": OURS, "ms": 5, "lw": 1.8, "label": "rf_exp, strict, 95 % interval"}
    axes.plot(demos, [100 * ours[n].value for n in demos], "o-", **our_style)
    for n in demos:
        axes.plot([n, n], [100 * ours[n].low, 100 * ours[n].high], color=OURS, lw=1.4)
    axes.set_title(title, fontsize=9.5, fontweight="bold", loc="left")
    axes.set_ylim(-4, 104)
    axes.set_xlim(min(paper) - 15, max(paper) + 15)
    axes.set_xticks(sorted(paper))
    axes.set_yticks([0, 50, 100], ["0 %", "50 %", "100 %"])
