"""What everything in a recording is called, which colour it has, and how the viewer lays it out."""

import rerun.blueprint as rrb

Rgb = tuple[int, int, int]  # sRGB, 0..255

# Okabe and Ito (2008): told apart with every common colour blindness, here in the order that reads
# best on the viewer's dark ground. Vermillion is kept for violations.
AGENT_COLOURS: tuple[Rgb, ...] = (
    (86, 180, 233),  # sky blue
    (230, 159, 0),  # orange
    (0, 158, 115),  # bluish green
    (204, 121, 167),  # reddish purple
    (240, 228, 66),  # yellow
    (0, 114, 178),  # blue
)
VIOLATED: Rgb = (213, 94, 0)  # vermillion
HOLDS: Rgb = (84, 130, 110)  # muted green: what is fine should not shout
OBJECT: Rgb = (150, 150, 150)
JOINT_COLOURS: tuple[Rgb, ...] = (*AGENT_COLOURS, (235, 235, 235))  # seven joints

EYE_M = (1.7, -0.8, 1.3)  # looks the way the tasks' global cameras do, from higher and further
LOOK_AT_M = (0.0, 0.0, 0.15)
PICTURE_COLUMNS = 3


def agent_colour(agent: int) -> Rgb:
    """The colour of an agent (from 1), the same in every view and every recording."""
    return AGENT_COLOURS[(agent - 1) % len(AGENT_COLOURS)]


def shade(colour: Rgb, factor: float) -> Rgb:
    """Darker below 1, paler above: scaled towards black, or by as much towards white."""
    end, part = (0, 1 - factor) if factor < 1 else (255, 1 - 1 / factor)
    red, green, blue = (round((1 - part) * value + part * end) for value in colour)
    return red, green, blue


def link_entity(agent: int, link: str) -> str:
    """Entity path of a link of an agent (from 1)."""
    return f"world/agent{agent}/{link}"


def object_entity(name: str) -> str:
    """Entity path of an object."""
    return f"world/objects/{name}"


def camera_entity(name: str) -> str:
    """Entity path of a camera; its pictures lie there too."""
    return f"world/cameras/{name}"


def blueprint(agents: int, cameras: tuple[str, ...]) -> rrb.Blueprint:
    """How the viewer opens: the scene large on the left, curves below it, evidence on the right."""
    scene = rrb.Spatial3DView(
        name="scene",
        origin="world",
        background=[28, 30, 34],
        line_grid=rrb.LineGrid3D(spacing=0.25, stroke_width=0.5, color=[90, 90, 90, 120]),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=EYE_M, look_target=LOOK_AT_M, eye_up=(0.0, 0.0, 1.0)
        ),
    )
    joints = [
        rrb.TimeSeriesView(name=f"agent {agent} joints (rad)", origin=f"joints/agent{agent}")
        for agent in range(1, agents + 1)
    ]
    grippers = rrb.TimeSeriesView(name="grippers (mm open)", origin="gripper")
    curves = rrb.Horizontal(rrb.Tabs(*joints, active_tab=0), grippers, column_shares=[2, 1])

    pictures = [rrb.Spatial2DView(name=name, origin=camera_entity(name)) for name in cameras]
    lanes = rrb.StateTimelineView(name="subgoals and checks", contents=["subgoals/**", "checks/**"])
    log = rrb.TextLogView(
        name="log",
        contents=["log/**", "subgoals/**", "checks/**"],
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["loglevel", "body"]),
    )
    documents = [
        rrb.TextDocumentView(name="proposals", origin="plan/proposals"),
        rrb.TextDocumentView(name="check code", origin="plan/checks"),
    ]
    evidence: list[rrb.View | rrb.Container] = [lanes, rrb.Tabs(log, *documents, active_tab=0)]
    shares = [0.5 + 0.2 * agents, 1.0]  # a lane for each agent
    if pictures:
        columns = min(len(pictures), PICTURE_COLUMNS)
        evidence.insert(0, rrb.Grid(*pictures, grid_columns=columns))
        shares.insert(0, 0.75 * -(-len(pictures) // columns))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, curves, row_shares=[3.0, 1.2]),
            rrb.Vertical(*evidence, row_shares=shares),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="time", loop_mode="all"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
