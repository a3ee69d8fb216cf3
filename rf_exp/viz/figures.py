"""Figures of plans: the timeline of the agents' motions, and coordination diagrams with the schedule."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from rf_exp.types import CONTROL_DT_S, Schedule, Trajectory, spans
from rf_exp.viz.layout import BACKGROUND, INK, ORDERED, VIOLATED, WAITS, Rgb, agent_colour, primitive_colour

Pair = tuple[int, int]  # agents i < j
Mask = NDArray[np.bool_]

DPI = 150
TILE_IN = 2.9  # side of one coordination diagram
LEGEND_IN = 0.35
COLUMNS = 3
WIDTH_IN, LANE_IN = 10.0, 0.5  # width of the timeline, height of a lane
LANE_CHARACTERS = 170  # characters of subgoals that fit along a lane
RIBBON_WIDTH = 0.035  # width of the coloured path beside a diagram, as a part of its side


def _hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


FACE, TEXT = _hex(BACKGROUND), _hex(INK)
STYLE: dict[Any, Any] = {
    **{"font.size": 9, "legend.frameon": False},
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), FACE),
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), TEXT),
}


@dataclass(frozen=True, eq=False)
class Coordination:
    """The coordination diagrams of all pairs of agents in one picture."""

    picture: NDArray[np.uint8]  # (H, W, 3) sRGB
    pairs: tuple[Pair, ...]
    origins_px: NDArray[np.float64]  # (K, 2) x right, y down: start of both agents of each pair
    steps_px: NDArray[np.float64]  # (K, 2) per path position of agent i, of agent j

    def at(self, positions: NDArray[np.integer]) -> NDArray[np.float64]:
        """(K, 2) pixels of path positions (N,) in the diagrams of all pairs."""
        places = np.array([[positions[i - 1], positions[j - 1]] for i, j in self.pairs]).reshape(-1, 2)
        return self.origins_px + self.steps_px * places


def coordination(
    trajectories: Sequence[Trajectory],
    schedule: Schedule,
    close: Mapping[Pair, Mask],
    ordered: Mapping[Pair, Mask],
) -> Coordination:
    """One diagram per pair in `close`: path position of i to the right, of j upwards, with the schedule.

    `close` (P_i, P_j): positions too close to each other; `ordered`: those that temporal constraints forbid.
    """
    pairs = tuple(sorted(close))
    columns, rows = _tiles(len(pairs))
    with rc_context(STYLE):
        figure = Figure(_size_in(len(pairs)), dpi=DPI, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, (i, j) in zip(grid, pairs, strict=False):
            forbidden = [(ordered[i, j], ORDERED)] if (i, j) in ordered else []
            _diagram(axes, trajectories[i - 1], trajectories[j - 1], [*forbidden, (close[i, j], VIOLATED)])
            line = schedule.positions[:, [i - 1, j - 1]] * CONTROL_DT_S
            axes.plot(line[:, 0], line[:, 1], color="white", lw=1.6)
        for axes in grid[len(pairs) :]:
            axes.set_axis_off()
        handles = [
            Patch(color=_hex(VIOLATED), label="too close"),
            Patch(color=_hex(ORDERED), label="order forbids"),
            Line2D([], [], color="white", label="schedule"),
        ]
        legend_style = {"ncols": 3, "fontsize": 8, "handlelength": 1.2, "columnspacing": 1.2}
        figure.legend(handles=handles, loc="outside lower center", **legend_style)
        picture = _render(figure)
        cell = [[0.0, 0.0], [CONTROL_DT_S, CONTROL_DT_S]]  # two opposite corners
        corners = np.array([axes.transData.transform(cell) for axes in grid[: len(pairs)]])
    (origins, ends), flip = corners.swapaxes(0, 1), np.array([1.0, -1.0])  # y of axes is upwards
    return Coordination(picture, pairs, origins * flip + (0.0, len(picture)), (ends - origins) * flip)


def coordination_size_px(pairs: int) -> tuple[int, int]:
    """Width and height of the picture of the diagrams of `pairs` pairs."""
    width_in, height_in = _size_in(pairs)
    return int(width_in * DPI), int(height_in * DPI)


def timeline(trajectories: Sequence[Trajectory], schedule: Schedule) -> NDArray[np.uint8]:
    """Timeline (H, W, 3) sRGB: one lane per agent, segments coloured by primitive, waiting in grey."""
    with rc_context(STYLE):
        size = WIDTH_IN, LANE_IN * len(trajectories) + 0.9
        figure = Figure(size, dpi=DPI, layout="constrained")
        axes = figure.add_subplot()
        for trajectory in trajectories:
            _lane(axes, trajectory, schedule)
        axes.set_yticks(
            [trajectory.agent for trajectory in trajectories], [f"agent {t.agent}" for t in trajectories]
        )
        for label, trajectory in zip(axes.get_yticklabels(), trajectories, strict=True):
            label.set_color(_hex(agent_colour(trajectory.agent)))
        axes.set_xlim(0.0, max(len(schedule), 1) * CONTROL_DT_S)
        axes.set_ylim(len(trajectories) + 0.6, 0.4)
        axes.set_xlabel("s since the start of the plan")
        for side in ("left", "right", "top"):
            axes.spines[side].set_visible(False)
        names = dict.fromkeys(
            segment.primitive for trajectory in trajectories for segment in trajectory.segments
        )
        handles = [Patch(color=_hex(primitive_colour(name)), label=name) for name in names]
        handles += [Patch(color=_hex(WAITS), label="waits")]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), handlelength=1.2)
        return _render(figure)


def _tiles(pairs: int) -> tuple[int, int]:
    columns = min(COLUMNS, pairs)
    return columns, -(-pairs // columns)


def _size_in(pairs: int) -> tuple[float, float]:
    columns, rows = _tiles(pairs)
    return TILE_IN * columns, TILE_IN * rows + LEGEND_IN


def _lane(axes: Axes, trajectory: Trajectory, schedule: Schedule) -> None:
    """Draws the lane of one agent."""
    row, motion_spans = trajectory.agent, spans(trajectory, schedule)
    end_s = (motion_spans[-1].ends if motion_spans else 0) * CONTROL_DT_S
    axes.broken_barh([(0.0, end_s)], (row - 0.2, 0.4), facecolor=_hex(WAITS))
    begins: dict[str, float] = {}
    for span in motion_spans:
        first, last = span.begins * CONTROL_DT_S, span.ends * CONTROL_DT_S
        colour = _hex(primitive_colour(span.segment.primitive))
        axes.broken_barh([(first, last - first)], (row - 0.2, 0.4), facecolor=colour, edgecolor=FACE, lw=0.6)
        begins.setdefault(span.segment.subgoal.text, first)
    total_s = max(len(schedule), 1) * CONTROL_DT_S
    for (text, first), until in zip(begins.items(), [*begins.values(), total_s][1:], strict=True):
        characters = int(LANE_CHARACTERS * (until - first) / total_s)
        shown = text if len(text) <= characters else f"{text[: max(0, characters - 1)]}…"
        axes.plot([first, first], [row - 0.42, row + 0.2], color=TEXT, lw=0.8)
        axes.text(first, row - 0.27, f" {shown}", va="bottom", fontsize=7.5, clip_on=True)


def _diagram(axes: Axes, i: Trajectory, j: Trajectory, forbidden: Iterable[tuple[Mask, Rgb]]) -> None:
    """Draws one pair: forbidden cells, and the path of each agent as a ribbon along its axis."""
    half = CONTROL_DT_S / 2  # a cell is as wide as a control step, with its position in the middle
    right, top = len(i) * CONTROL_DT_S + half, len(j) * CONTROL_DT_S + half
    for mask, colour in forbidden:
        shown = np.zeros((*mask.T.shape, 4), np.uint8)
        shown[mask.T] = (*colour, 255)
        axes.imshow(shown, origin="lower", extent=(-half, right, -half, top), interpolation="nearest")
    for trajectory, across in ((i, True), (j, False)):
        draw = axes.axvspan if across else axes.axhspan
        for segment, begin, end in trajectory.intervals:
            colour, ribbon = _hex(primitive_colour(segment.primitive)), (1.0, 1.0 + RIBBON_WIDTH)
            draw(begin * CONTROL_DT_S, end * CONTROL_DT_S, *ribbon, clip_on=False, color=colour)
    # The half cell keeps the axis of an agent that does not move from being empty.
    axes.set(xlim=(-half, right), ylim=(-half, top), aspect="auto", box_aspect=1.0)
    axes.set_xlabel(f"agent {i.agent}, s along its path", color=_hex(agent_colour(i.agent)))
    axes.set_ylabel(f"agent {j.agent}, s along its path", color=_hex(agent_colour(j.agent)))


def _render(figure: Figure) -> NDArray[np.uint8]:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
