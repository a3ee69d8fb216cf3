"""Entity names, colours and viewer layout of recordings."""

from typing import Literal

import rerun.blueprint as rrb

Rgb = tuple[int, int, int]  # sRGB, 0..255
Panels = Literal["plan", "rollout"]  # what a recording shows beside the scene

# Okabe and Ito (2008): distinguishable with every common colour blindness, ordered for the viewer's dark
# background. Vermillion is reserved for violations.
AGENT_COLOURS: tuple[Rgb, ...] = (
    (86, 180, 233),  # sky blue
    (230, 159, 0),  # orange
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (240, 228, 66),  # yellow
    (0, 114, 178),  # blue
)
VIOLATED: Rgb = (213, 94, 0)  # vermillion
HOLDS: Rgb = (84, 130, 110)  # muted green, as it needs no attention
NOT_YET: Rgb = (128, 92, 60)  # a condition of success that does not hold, which is no violation
OBJECT: Rgb = (150, 150, 150)
JOINT_COLOURS: tuple[Rgb, ...] = (*AGENT_COLOURS, (235, 235, 235))  # seven joints

BACKGROUND: Rgb = (28, 30, 34)
INK: Rgb = (215, 215, 215)
ORDERED: Rgb = (62, 76, 112)  # cells of a coordination diagram that an order forbids
WAITS: Rgb = (70, 72, 78)
# Blue: motion with an empty gripper; yellow: fingers; green: motion with a load; purple: contact.
PRIMITIVES: dict[str, Rgb] = {
    "move": (62, 104, 158),
    "approach": (84, 146, 196),
    "retreat": (46, 76, 120),
    "close": (176, 136, 32),
    "open": (132, 104, 48),
    "lift": (44, 128, 86),
    "carry": (70, 156, 104),
    "lower": (34, 98, 72),
    "press": (150, 92, 158),
    "strike": (116, 68, 140),
    "shut": (134, 80, 149),
}

EYE_M = (1.7, -0.8, 1.3)  # direction of the tasks' global cameras, from higher and further away
LOOK_AT_M = (0.0, 0.0, 0.15)
PICTURE_COLUMNS = 3

PROPOSALS, CHECKS, DIAGRAMS, MOTIONS = "plan/proposals", "plan/checks", "plan/diagrams", "motions"
CONDITIONS, MARGINS, VERDICT = "conditions", "margins", "verdict"
LEGENDS = "legends"
LEGEND_ROWS = 10  # that fit in a legend
DISTANCES, CONTACTS = "arms/distances", "contacts"
PATHS = "world/paths"


def agent_colour(agent: int) -> Rgb:
    """The colour of an agent (from 1), the same in every view and every recording."""
    return AGENT_COLOURS[(agent - 1) % len(AGENT_COLOURS)]


def primitive_colour(primitive: str) -> Rgb:
    """The colour of a motion primitive; grey for one that has none of its own."""
    return PRIMITIVES.get(primitive, OBJECT)


def pale(colour: Rgb) -> Rgb:
    """The colour mixed with two parts of white."""
    red, green, blue = (round((value + 2 * 255) / 3) for value in colour)
    return red, green, blue


def link_entity(agent: int, link: str) -> str:
    """Entity path of a link of an agent (from 1)."""
    return f"world/agent{agent}/{link}"


def object_entity(name: str) -> str:
    """Entity path of an object."""
    return f"world/objects/{name}"


def camera_entity(name: str) -> str:
    """Entity path of a camera and of its pictures."""
    return f"world/cameras/{name}"


def blueprint(
    agents: int, cameras: tuple[str, ...], panels: Panels, diagrams_px: tuple[int, int] | None
) -> rrb.Blueprint:
    """Layout of the viewer: the scene and the motions of each agent on the left, evidence on the right.

    `diagrams_px`: width and height of the picture of coordination diagrams, None without one.
    """
    series = [_curves(f"agent {k} joints (rad)", f"joints/agent{k}") for k in range(1, agents + 1)]
    series.append(_curves("grippers (mm open)", "gripper"))
    log = rrb.TextLogView(
        name="log",
        contents=["log/**", f"{MOTIONS}/**", "checks/**", f"{CONDITIONS}/**"],
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["loglevel", "body"]),
    )
    right: list[rrb.View | rrb.Container]
    if panels == "plan":  # motions over time; coordination diagrams, proposals, checks
        motions = rrb.StateTimelineView(name="who does what when", origin=MOTIONS)
        below, low = _tabs(motions, *series), 0.35 + 0.2 * agents
        document = rrb.TextDocumentView(name="check code and evidence", origin=CHECKS)
        right = [_tabs(*_reasons(diagrams_px)), _tabs(document, log)]
        shares = [1.15, 1.0]
    else:  # predicted, commanded and measured joints; conditions; distances of arms; the verdict
        conditions = rrb.StateTimelineView(name="conditions over time", origin=CONDITIONS)
        margins = _curves("value / bound", MARGINS)
        below, low = rrb.Horizontal(_tabs(*series), _tabs(conditions, margins)), 1.6
        near = forces = _curves("contacts (N)", CONTACTS, 0.55)
        if agents > 1:
            distances = _curves("distance of arms (cm)", DISTANCES, 0.55)
            near = rrb.Horizontal(distances, forces)
        verdict = rrb.TextDocumentView(name="verdict", origin=VERDICT)
        right = [near, _tabs(verdict, log)]
        shares = [0.8, 1.0]
    pictures = [rrb.Spatial2DView(name=name, origin=camera_entity(name)) for name in cameras]
    if pictures:
        columns = min(len(pictures), PICTURE_COLUMNS)
        right.insert(0, rrb.Grid(*pictures, grid_columns=columns))
        shares.insert(0, 0.5 * -(-len(pictures) // columns))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_scene(), below, row_shares=[3.0, low]),
            rrb.Vertical(*right, row_shares=shares),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="time", loop_mode="all"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _curves(name: str, origin: str, legend: float = 0.35) -> rrb.Horizontal:
    """Curves with a legend of this width beside them: the viewer's own would cover them."""
    bounds = rrb.VisualBounds2D(x_range=[-1.0, 1.0], y_range=[-1.0, LEGEND_ROWS - 1.0])
    return rrb.Horizontal(
        rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(visible=False)),
        rrb.Spatial2DView(
            name="legend", origin=f"{LEGENDS}/{origin}", background=BACKGROUND, visual_bounds=bounds
        ),
        column_shares=[1.0, legend],
        name=name,
    )


def _scene() -> rrb.Tabs:
    """The scene, and in a second tab the same with the checked occupancy, which hides much."""
    views = [
        rrb.Spatial3DView(
            name=name,
            origin="world",
            background=BACKGROUND,
            line_grid=rrb.LineGrid3D(spacing=0.25, stroke_width=0.5, color=[90, 90, 90, 120]),
            eye_controls=rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital, position=EYE_M, look_target=LOOK_AT_M, eye_up=(0.0, 0.0, 1.0)
            ),
            overrides={"world/occupancy": rrb.EntityBehavior(visible=visible)},
        )
        for name, visible in (("scene", False), ("scene with occupancy", True))
    ]
    return _tabs(*views)


def _reasons(diagrams_px: tuple[int, int] | None) -> list[rrb.View]:
    """Reasons for the schedule: coordination diagrams, proposals, verdicts over time."""
    views: list[rrb.View] = [
        rrb.TextDocumentView(name="proposals", origin=PROPOSALS),
        rrb.StateTimelineView(name="verdicts in time", origin="checks"),
    ]
    if diagrams_px is not None:
        width, height = diagrams_px
        diagrams = rrb.Spatial2DView(
            name="coordination diagrams",
            origin=DIAGRAMS,
            background=BACKGROUND,
            visual_bounds=rrb.VisualBounds2D(x_range=[0, width], y_range=[0, height]),
        )
        views.insert(0, diagrams)
    return views


def _tabs(*views: rrb.View | rrb.Container) -> rrb.Tabs:
    return rrb.Tabs(*views, active_tab=0)
