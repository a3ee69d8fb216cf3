"""Recordings are written, read back with rerun's own reader, and checked for what a viewer shows."""

from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
import rerun.chunk as rrc
import trimesh

from rf_exp import viz
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Account, Cause, CheckName, Closest, Finding, Unmet, Violation
from rf_exp.statements import Proposal, Together
from rf_exp.transforms import from_axes, planar, transform
from rf_exp.types import (
    CameraModel,
    Measured,
    Rollout,
    Schedule,
    Segment,
    Subgoal,
    Trajectory,
    Verdict,
)
from rf_exp.viz import HOLDS, VIOLATED, Film, text
from rf_exp.viz.figures import coordination, coordination_size_px, lanes
from rf_exp.viz.layout import AGENT_COLOURS, OBJECT, ORDERED, PRIMITIVES, WAITS, primitive_colour
from rf_exp.viz.shading import creased, srgb

BARRIER = viz.object_entity("barrier")
LINKS = [viz.link_entity(agent, link) for agent in (1, 2) for link in ("panda_link0", "panda_hand")]
EYE_M = np.array([1.05, 0.0, 0.75])
CAMERAS = {
    "global": CameraModel(32, 24, np.deg2rad(70), from_axes(EYE_M, z=-EYE_M, y=(0, 0, -1))),
    "agent1": CameraModel(32, 24, np.deg2rad(70), np.eye(4)),  # on the wrist: moves
}
QPOS = np.tile([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8, 0.04, 0.04], (2, 1))
ACTION = np.tile([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8, -1.0], (2, 1))
PICTURE = np.full((24, 32, 3), (200, 30, 90), np.uint8)
POSES = {LINKS[0]: planar(0.0, -0.75, np.pi / 2), BARRIER: planar(0.1, 0.0, 0.3, 0.05)}


def box(size_m: tuple[float, float, float]) -> viz.Mesh:
    shape = trimesh.creation.box(size_m)
    return viz.Mesh(shape.vertices, shape.faces)


def open_recorder(path: Path, **changed) -> viz.Recorder:
    meshes = {BARRIER: box((0.9, 0.05, 0.1)), **{link: box((0.1, 0.1, 0.3)) for link in LINKS}}
    given = {
        "task": "lift_barrier",
        "title": "lift barrier, full, seed 7",
        "agents": 2,
        "cameras": CAMERAS,
        "meshes": meshes,
        "moving": ["agent1"] if "agent1" in changed.get("cameras", CAMERAS) else [],
    }
    return viz.Recorder(path, **{**given, **changed})


class Content:
    """What a file holds, entity by entity."""

    def __init__(self, path: Path, store: rrc.StoreEntry | None = None) -> None:
        self.reader = rrc.RrdReader(path)
        self.blueprints = self.reader.blueprints()
        self.batches: dict[str, list[pa.RecordBatch]] = defaultdict(list)
        self.timelines: dict[str, set[str]] = defaultdict(set)
        for chunk in self.reader.stream(store=store or self.reader.recordings()[0]):
            self.batches[chunk.entity_path].append(chunk.to_record_batch())
            self.timelines[chunk.entity_path] |= set(chunk.timeline_names)

    def rows(self, entity: str, component: str) -> list[tuple[int | None, list]]:
        """(step, value) of every row that has the component, in the order of logging; static: no step."""
        found = []
        for batch in self.batches[entity]:
            names = batch.schema.names
            if component in names:
                values = batch.column(component).to_pylist()
                steps = batch.column("step").to_pylist() if "step" in names else [None] * len(values)
                order = [bytes(row) for row in batch.column(names[0]).to_pylist()]
                found += [row for row in zip(order, steps, values, strict=True) if row[2] is not None]
        return [(step, value) for _, step, value in sorted(found, key=lambda row: row[0])]

    def column(self, entity: str, component: str) -> list:
        """Every logged value of a component, in the order of logging."""
        return [value for _, value in self.rows(entity, component)]

    def steps(self, entity: str, component: str) -> list[int]:
        """The step of every row that has the component."""
        return [step for step, _ in self.rows(entity, component) if step is not None]

    def texts(self, entity: str) -> list[str]:
        return [text for row in self.column(entity, "TextLog:text") for text in row]


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "recordings" / "lift_barrier" / "full" / "generate-7.rrd"


def test_every_step_is_there_on_both_timelines(path):
    with open_recorder(path) as recorder:
        for step in range(5):
            moving = {viz.camera_entity("agent1"): transform((0, 0, 0.5 + 0.01 * step))}
            recorder.step(
                step,
                poses={**POSES, **moving},
                qpos=QPOS + 0.01 * step,
                action=ACTION,
                pictures={"global": PICTURE, "agent1": PICTURE},
            )
    content = Content(path)
    for entity in (*LINKS, BARRIER):
        assert len(content.column(f"/{entity}", "Mesh3D:triangle_indices")) == 1, entity
    for entity in (LINKS[0], BARRIER, viz.camera_entity("agent1")):
        steps = content.steps(f"/{entity}", "Transform3D:translation")
        assert sorted(steps) == [0, 1, 2, 3, 4], entity
        assert content.timelines[f"/{entity}"] == {"step", "time"}
    for camera in CAMERAS:
        assert len(content.column(f"/world/cameras/{camera}", "EncodedImage:blob")) == 5
    for agent in (1, 2):
        for curve in (f"/joints/agent{agent}/measured", f"/joints/agent{agent}/target"):
            assert [len(row) for row in content.column(curve, "Scalars:scalars")] == [7] * 5
        assert content.column(f"/gripper/agent{agent}/target", "Scalars:scalars") == [[0.0]] * 5
    np.testing.assert_allclose(content.column("/gripper/agent2/measured", "Scalars:scalars")[0], [80.0])
    times = [t for batch in content.batches[f"/{BARRIER}"] if "time" in batch.schema.names
             for t in batch.column("time").cast(pa.int64()).to_pylist()]  # fmt: skip
    assert sorted(times) == [50_000_000 * step for step in range(5)]  # ns at 20 Hz


def test_poses_and_pictures_come_back_as_given(path):
    with open_recorder(path) as recorder:
        recorder.step(0, poses=POSES, qpos=QPOS, pictures={"global": PICTURE})
    content = Content(path)
    [[translation]] = content.column(f"/{BARRIER}", "Transform3D:translation")
    [[columns]] = content.column(f"/{BARRIER}", "Transform3D:mat3x3")
    np.testing.assert_allclose(translation, POSES[BARRIER][:3, 3], atol=1e-6)
    np.testing.assert_allclose(np.reshape(columns, (3, 3)).T, POSES[BARRIER][:3, :3], atol=1e-6)
    [[blob]] = content.column("/world/cameras/global", "EncodedImage:blob")
    picture = np.asarray(cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
    assert np.abs(picture.astype(int) - PICTURE).max() <= 6  # red stays red


def test_the_camera_sees_what_its_model_says(path):
    with open_recorder(path):
        pass
    [[intrinsics]] = Content(path).column("/world/cameras/global", "Pinhole:image_from_camera")
    image_from_camera = np.reshape(intrinsics, (3, 3)).T
    top = image_from_camera @ [0.0, -np.tan(np.deg2rad(35)), 1.0]  # half the vertical angle up
    np.testing.assert_allclose(top[:2] / top[2], [16.0, 0.0], atol=1e-3)


def test_verdicts_and_violations_say_why(path):
    with open_recorder(path) as recorder:
        recorder.violation(CLASH, [(0.0, 0.1, 0.3), (0.0, -0.1, 0.3)])
        recorder.violation(CLASH, [(0.0, 0.2, 0.3)])
        recorder.violation(BLOCKED)
        recorder.step(3, poses=POSES, qpos=QPOS)
        recorder.verdict("ValidateSpatialOccupancy", True, "no shared voxel over 4.2 s")
    content = Content(path)
    lane = "/checks/ValidateSpatialOccupancy"
    why = "agent 1 and agent 2: Agent_1 and Agent_2 touch each other with 31 N (31 N, bound 1 N, at 1.35 s)"
    assert content.texts(lane)[0] == f"ValidateSpatialOccupancy: {why}"
    assert content.texts(lane)[-1] == "ValidateSpatialOccupancy: no shared voxel over 4.2 s"
    assert content.texts("/checks/Motion") == [
        "Motion: agent 1: Agent_1 cannot go home: no free path (at 0.20 s)"
    ]
    assert content.column(lane, "StateChange:state") == [["violated"], ["violated"], ["holds"]]
    assert content.steps(lane, "StateChange:state") == [0, 0, 3]
    assert content.column(lane, "StateConfiguration:values") == [["holds", "violated"]]
    marks = content.column("/world/violations", "Points3D:positions")[-1]
    np.testing.assert_allclose(marks, [[0.0, 0.1, 0.3], [0.0, -0.1, 0.3], [0.0, 0.2, 0.3]], atol=1e-6)


def test_lanes_tell_motions_from_waiting(path):
    with open_recorder(path) as recorder:
        recorder.motion(1, "grasp barrier at left", "approach")
        recorder.step(3, poses=POSES, qpos=QPOS)
        recorder.motion(1, "lift barrier by 0.2 m", "")
        recorder.step(4, poses=POSES, qpos=QPOS)
        recorder.motion(1, "lift barrier by 0.2 m", "lift")
        recorder.motion(1, "", "")
    content, lane = Content(path), "/motions/agent1"
    states = [state for row in content.column(lane, "StateChange:state") for state in row]
    shown = ["approach: grasp barrier at left", "waits", "lift: lift barrier by 0.2 m"]
    assert states == [*shown, ""]
    assert content.steps(lane, "StateChange:state") == [0, 3, 4, 4]
    assert content.column(lane, "StateConfiguration:values")[-1] == shown
    colours = [PRIMITIVES["approach"], WAITS, PRIMITIVES["lift"]]
    written = content.column(lane, "StateConfiguration:colors")[-1]
    assert [(each >> 24, each >> 16 & 255, each >> 8 & 255) for each in written] == colours


CLASH = Violation(
    check=CheckName.OCCUPANCY, cause=Cause.SPACE, finding=Finding.TOUCHING, value=31.0, bound=1.0, unit="N",
    time_s=1.35, agents=(1, 2), measured=True,
)  # fmt: skip
BLOCKED = Violation(
    check=CheckName.MOTION, cause=Cause.SPACE, finding=Finding.NO_PATH, time_s=0.2, agents=(1,),
    subgoals=("go home",),
)  # fmt: skip
RESULTS = (
    text.CheckResult("VI(Agent_1, barrier, left)", "said", True, 0.0021, 0.01, "m", 1.5, "2 mm | off"),
    text.CheckResult("VSO(Agent_1)", "said", False, 0.004, 0.01, "m", 2.0, "too near"),
    text.CheckResult("VSO(Agent_2, objects)", "said", True, np.inf, 0.003, "m", 0.0, "nothing to avoid"),
)


def test_the_check_code_shows_its_evidence_and_replaces_what_was_checked_before(path):
    with open_recorder(path) as recorder:
        recorder.violation(BLOCKED)
        recorder.checked(RESULTS)
        recorder.step(5, poses=POSES, qpos=QPOS)
        recorder.checked(RESULTS[:1])
    content = Content(path)
    [refused], [first], [both] = content.column("/plan/checks", "TextDocument:text")
    assert (
        refused
        == "## Violation 1, step 0\n\n**Motion**: agent 1: Agent_1 cannot go home: no free path (at 0.20 s)"
    )
    assert first.startswith("## Check code 1, step 0")
    assert both.endswith(first)
    assert both.startswith("## Check code 2, step 5\n\n**True**: all 1 checks hold.")
    assert "**False**: 1 of 3 checks are violated." in first
    assert "and VSO(Agent_1)  # VIOLATED: 0.004 m, bound 0.01 m\n" in first
    assert "| **violated** | `VSO(Agent_1)` | 0.004 m | 0.01 m | 2.00 s | too near |" in first
    assert "| `VSO(Agent_2, objects)` | none | 0.003 m |" in first
    assert "2 mm \\| off" in first  # else it would end the cell

    def lane(name: str) -> list[str]:
        return [state for row in content.column(f"/checks/{name}", "StateChange:state") for state in row]

    assert lane("VI-Agent_1-barrier-left") == ["holds", "holds"]
    assert lane("VSO-Agent_1") == ["violated", ""]
    assert lane("Motion") == ["violated", ""]


def test_the_mark_of_a_violation_leaves_after_half_a_second(path):
    with open_recorder(path) as recorder:
        recorder.violation(CLASH, [(0.0, 0.1, 0.3)])
        for step in (5, 9, 10, 11):
            recorder.step(step, poses=POSES, qpos=QPOS)
    content = Content(path)
    assert content.steps("/world/violations", "Clear:is_recursive") == [10]


def test_occupancy_has_the_colour_of_its_agent(path):
    centres = np.array([[0.025, 0.025, 0.025], [0.075, 0.025, 0.025]])
    with open_recorder(path) as recorder:
        recorder.occupancy("agent2", centres)
        recorder.occupancy("barrier", centres[:1], size_m=0.1)
        recorder.step(1, poses=POSES, qpos=QPOS)
        recorder.occupancy("agent2", None)
    content = Content(path)
    [boxes] = content.column("/world/occupancy/agent2", "Boxes3D:centers")
    np.testing.assert_allclose(boxes, centres)
    [[colour]] = content.column("/world/occupancy/agent2", "Boxes3D:colors")
    assert (colour >> 24, colour >> 16 & 255, colour >> 8 & 255) == AGENT_COLOURS[1]
    assert 0 < colour & 255 < 255  # translucent
    [[half]] = content.column("/world/occupancy/barrier", "Boxes3D:half_sizes")
    assert half == pytest.approx([0.05] * 3)
    assert content.steps("/world/occupancy/agent2", "Clear:is_recursive") == [1]


def test_documents_show_every_attempt_newest_first(path):
    goals = (Subgoal(1, "grasp", "barrier", "left"), Subgoal(2, "grasp", "barrier", "right"))
    proposal = Proposal(goals, (Together((1, 2), "lift", "barrier"),))
    with open_recorder(path) as recorder:
        recorder.proposal(proposal)
        recorder.proposal(proposal)
    content = Content(path)
    [shown] = content.column("/plan/proposals", "TextDocument:text")[-1]
    assert shown.index("Proposal 2, step 0") < shown.index("Proposal 1, step 0")
    assert "1. grasp barrier at left" in shown
    assert "- *temporal*, agents 1, 2: Agent_1 and Agent_2 must lift barrier simul" in shown
    assert "agent 2 is to grasp barrier at right" in content.texts("/log")


def still(agent: int, *parts: tuple[str, int]) -> Trajectory:
    """Segments of so many steps that do not move: pictures of plans only count steps."""
    segments = tuple(
        Segment(agent, Subgoal(agent, "grasp", "barrier", "left"), name, np.zeros((steps, 7)), np.ones(steps))
        for name, steps in parts
    )
    return Trajectory(agent, np.zeros(7), 1.0, segments)


TWO = (still(1, ("approach", 20), ("close", 10)), still(2, ("approach", 20)))
# Agent 2 waits at its start while agent 1 makes ten steps, then both go on.
TIMED = Schedule(np.array([[t, 0] for t in range(10)] + [[10 + t, t] for t in range(21)]), 30)


def colour_at(picture: np.ndarray, pixel: np.ndarray) -> tuple[int, ...]:
    column, row = np.floor(pixel).astype(int)
    return tuple(picture[row, column].tolist())


def test_diagrams_colour_what_is_forbidden_where_the_schedule_is_drawn():
    close, ordered = np.zeros((31, 21), bool), np.zeros((31, 21), bool)
    close[24:29, 3:8], ordered[2:7, 12:18] = True, True
    found = coordination(TWO, TIMED, {(1, 2): close}, {(1, 2): ordered})
    assert found.pairs == ((1, 2),)
    assert found.picture.shape[1::-1] == coordination_size_px(1)

    def at(i: int, j: int) -> tuple[int, ...]:
        [pixel] = found.at(np.array([i, j]))
        return colour_at(found.picture, pixel)

    assert at(26, 5) == VIOLATED
    assert at(4, 15) == ORDERED
    assert at(5, 0) == at(20, 10) == (255, 255, 255)  # the schedule
    assert at(5, 26 % 21) != VIOLATED  # the axes are not swapped


def test_every_pair_has_a_diagram_of_its_own():
    three = (*TWO, still(3, ("lift", 40)))
    positions = np.column_stack([np.minimum(np.arange(41), 30), np.minimum(np.arange(41), 20), np.arange(41)])
    pairs = ((1, 2), (1, 3), (2, 3))
    free = {(i, j): np.zeros((len(three[i - 1]) + 1, len(three[j - 1]) + 1), bool) for i, j in pairs}
    free[2, 3][15:20, 0:6] = True
    found = coordination(three, Schedule(positions, 40), free, {})
    pixels = found.at(np.array([17, 17, 3]))
    hits = [colour_at(found.picture, pixel) == VIOLATED for pixel in pixels]
    assert found.pairs == pairs
    assert hits == [False, False, True]


def test_the_picture_of_lanes_shows_motion_and_waiting():
    picture = lanes(TWO, TIMED)
    shown = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert {PRIMITIVES["approach"], PRIMITIVES["close"], WAITS} <= shown
    assert PRIMITIVES["lift"] not in shown
    legend = picture.shape[0] // 4  # above the rows
    waiting = (picture[legend:] == WAITS).all(axis=-1).any(axis=0)
    assert (
        0.25 < waiting.sum() / picture.shape[1] < 0.4
    )  # agent 2, 10 of 30 steps of nine tenths of the width


def test_a_primitive_without_a_colour_is_grey():
    assert primitive_colour("juggle") == OBJECT


def test_the_point_in_the_diagram_moves_with_the_plan(path):
    with open_recorder(path) as recorder:
        recorder.positions(np.array([0, 0]))  # no plan yet: nothing to show
        recorder.coordination(TWO, TIMED, {(1, 2): np.zeros((31, 21), bool)}, {})
        for step in range(3):
            recorder.step(step, poses=POSES, qpos=QPOS)
            recorder.positions(TIMED.positions[10 + step])
    content = Content(path)
    assert len(content.column("/plan/diagrams", "EncodedImage:blob")) == 1
    places = np.array(content.column("/plan/diagrams/now", "Points2D:positions"))[:, 0]
    assert content.steps("/plan/diagrams/now", "Points2D:positions") == [0, 1, 2]
    right, down = np.diff(places, axis=0).T
    assert (right > 0).all() and (down < 0).all()  # both agents go on


def test_what_is_predicted_belongs_to_the_steps_to_come(path):
    chunk = np.tile(ACTION[0], (3, 1)) + np.arange(3)[:, None] * 0.1
    with open_recorder(path, panels="rollout") as recorder:
        recorder.step(4, poses=POSES, qpos=QPOS)
        recorder.predicted(1, 5, chunk)
        recorder.path(1, "predicted", np.zeros((3, 3)))
        recorder.note("now")
    content = Content(path)
    dots = "/joints/agent1/predicted"
    assert content.steps(dots, "Scalars:scalars") == [5, 6, 7]
    np.testing.assert_allclose(content.column(dots, "Scalars:scalars"), chunk[:, :7])
    opening = content.column("/gripper/agent1/predicted", "Scalars:scalars")
    np.testing.assert_allclose(opening, [[0.0], [4.0], [8.0]], atol=1e-9)  # mm, of -1, -0.9, -0.8
    assert content.steps("/log", "TextLog:text")[-1] == 4  # time goes on from where it was
    assert content.steps("/world/paths/agent1/predicted", "LineStrips3D:strips") == [4]


def test_conditions_are_lanes_and_numbers_are_curves(path):
    with open_recorder(path, panels="rollout") as recorder:
        recorder.condition("held by both arms", False, "held by both arms: not yet")
        recorder.condition("arms apart", True, "arms apart: holds", ("holds", "touching"))
        recorder.step(2, poses=POSES, qpos=QPOS)
        recorder.condition("held by both arms", True, "held by both arms: holds")
        recorder.condition("arms apart", False, "arms apart: touching", ("holds", "touching"))
        for name, value in (("lifted (> 0.15 m)", 0.5), ("level (< 5 deg)", 2.0)):
            recorder.margin(name, value)
        recorder.distance(1, 2, 0.125)
        recorder.contact("agent 1 on barrier", 7.5)
        recorder.judged("so far")
    content = Content(path)

    def lane(name: str, component: str) -> list:
        return content.column(f"/conditions/{name}", component)

    assert lane("held-by-both-arms", "StateChange:state") == [["not yet"], ["holds"]]
    assert lane("held-by-both-arms", "TextLog:text")[-1] == ["held by both arms: holds"]
    colours = {
        name: lane(name, "StateConfiguration:colors")[0] for name in ("held-by-both-arms", "arms-apart")
    }
    red = [[each >> 24, each >> 16 & 255, each >> 8 & 255] for each in (pair[1] for pair in colours.values())]
    assert red[0] != red[1] == list(VIOLATED)  # a condition that is not there yet is no violation
    assert content.column("/margins/lifted\\ \\(\\>\\ 0.15\\ m\\)", "Scalars:scalars") == [[0.5]]
    assert content.column("/arms/distances/agents\\ 1\\ and\\ 2", "Scalars:scalars") == [[12.5]]  # cm
    assert content.column("/contacts/agent\\ 1\\ on\\ barrier", "Scalars:scalars") == [[7.5]]
    assert content.column("/verdict", "TextDocument:text") == [["so far"]]


def test_the_verdict_is_a_table_and_its_end_a_list():
    up = Measured(False, 0.02, 0.15, "m", above=True)
    verdict = Verdict(False, False, {"held": True, "up": False}, {"up": up}, {"steak": "dropped"})
    lines = text.conditions(verdict, {"held": 20, "up": 0}).splitlines()
    rows = ["| holds | held |  |  | 1.00 s |", "| **not yet** | up | 0.02 m | > 0.15 | 0.00 s |"]
    assert lines[2:] == [*rows, "", "- steak is dropped"]
    account = Account(unmet=(Unmet("up; or down", 0.0),), closest=Closest(1, 2, 1.0, 0))
    ended = text.outcome(Rollout(3, False, False, 84, 2, 1, account))
    assert ended.startswith("**Failed after 4.20 s**")
    assert "2 steps with a violation, 1 with contact between arms." in ended
    assert ended.endswith("- failed: up; or down (never)\n- at best 1 of 2 (1.00 s)")


def test_a_film_that_cannot_be_written_says_so(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with (
        pytest.raises(StageError, match=r"cannot write the film .*x\.mp4"),
        Film(tmp_path / "file/x.mp4") as film,
    ):
        for _ in range(100):
            film.add(np.zeros((240, 320, 3), np.uint8))


def test_the_layout_of_a_rollout_is_in_the_file_and_all_its_views_are_filled(path):
    with open_recorder(path, panels="rollout") as recorder:
        recorder.step(
            0, poses=POSES, qpos=QPOS, action=ACTION, pictures={"global": PICTURE, "agent1": PICTURE}
        )
        recorder.predicted(1, 1, ACTION[:1])
        recorder.condition("up", False, "up: not yet")
        recorder.margin("up", 0.1)
        recorder.distance(1, 2, 0.3)
        recorder.contact("agent 1 on barrier", 3.0)
        recorder.judged("so far")
    origins, names, classes = layout(path)
    assert classes.count("2D") == len(CAMERAS)  # and no diagrams
    assert {"conditions over time", "distance of arms (cm)", "contacts (N)", "verdict"} <= set(names)
    recorded = Content(path).batches
    for origin in origins:
        assert any(entity.startswith(f"/{origin.strip('/')}") for entity in recorded), origin


def layout(path: Path) -> tuple[list[str], list[str], list[str]]:
    """Origin, name and class of every view in the layout of a file."""
    [entry] = Content(path).blueprints
    content = Content(path, entry)
    views = [entity for entity in content.batches if entity.startswith("/view/") and entity.count("/") == 2]
    fields = ("space_origin", "display_name", "class_identifier")
    origins, names, classes = (
        [row[0] for view in views for row in content.column(view, f"ViewBlueprint:{name}")] for name in fields
    )
    return origins, names, classes


@pytest.mark.parametrize("cameras", [CAMERAS, {}], ids=["rendered", "without pictures"])
def test_the_layout_is_in_the_file(path, cameras):
    with open_recorder(path, cameras=cameras) as recorder:
        recorder.step(0, poses=POSES, qpos=QPOS)
        recorder.proposal(Proposal((), ()))
        recorder.checked(RESULTS)
        recorder.motion(1, "home", "move")
        recorder.coordination(TWO, TIMED, {(1, 2): np.zeros((31, 21), bool)}, {})
    origins, names, classes = layout(path)
    assert classes.count("2D") == len(cameras) + 1  # and the diagrams
    assert classes.count("3D") == 2  # with and without occupancy
    assert {"agent 1 joints (rad)", "agent 2 joints (rad)", "grippers (mm open)", "log"} <= set(names)
    recorded = Content(path).batches
    for origin in origins:  # a view of an entity that is never written would stay empty
        assert any(entity.startswith(f"/{origin.strip('/')}") for entity in recorded), origin


def test_the_file_is_complete_after_an_exception(path):
    with pytest.raises(RuntimeError, match="arm lost"), open_recorder(path) as recorder:
        recorder.step(4, poses=POSES, qpos=QPOS)
        raise RuntimeError("arm lost")
    content = Content(path)
    assert content.steps(f"/{BARRIER}", "Transform3D:translation") == [4]
    assert content.texts("/log") == ["lift barrier, full, seed 7", "ended by RuntimeError: arm lost"]
    content.reader.store()  # raises without the footer, which is written last


def test_two_recordings_at_once_stay_apart(path, tmp_path):
    other_path = tmp_path / "other.rrd"
    with open_recorder(path) as recorder, open_recorder(other_path) as other:
        recorder.step(1, poses=POSES, qpos=QPOS)
        other.step(2, poses=POSES, qpos=QPOS)
        recorder.note("first")
    first, second = Content(path), Content(other_path)
    assert first.steps("/log", "TextLog:text") == [0, 1]
    assert second.steps(f"/{BARRIER}", "Transform3D:translation") == [2]
    identifiers = {reader.recordings()[0].recording_id for reader in (first.reader, second.reader)}
    assert len(identifiers) == 2


def test_nothing_is_lost_silently_after_close(path):
    recorder = open_recorder(path)
    recorder.close()
    recorder.close()
    with pytest.raises(StageError, match=r"generate-7\.rrd is closed; nothing more can be recorded"):
        recorder.note("too late")


WRONG = {
    "pose shape": (
        {"poses": {BARRIER: np.eye(3)}},
        "poses['world/objects/barrier'] has shape 3x3; expected 4x4",
    ),
    "pose value": (
        {"poses": {BARRIER: np.full((4, 4), np.nan)}},
        "poses['world/objects/barrier'] holds nan; expected finite numbers",
    ),
    "pose name": (
        {"poses": {"world/objects/barier": np.eye(4)}},
        "unknown entity in poses 'world/objects/barier'; available: world/agent1/panda_hand, ",
    ),
    "fixed camera": (
        {"poses": {"world/cameras/global": np.eye(4)}},
        "unknown entity in poses 'world/cameras/global'; available: world/agent1/panda_hand, ",
    ),
    "qpos": ({"qpos": QPOS[:1]}, "qpos has shape 1x9; expected 2x9"),
    "action": ({"action": QPOS}, "action has shape 2x9; expected 2x8"),
    "picture size": (
        {"pictures": {"global": PICTURE[:, :16]}},
        "pictures['global'] has shape 24x16x3; expected 24x32x3",
    ),
    "picture type": (
        {"pictures": {"global": PICTURE / 255.0}},
        "pictures['global'] is float64; expected uint8",
    ),
    "picture name": (
        {"pictures": {"agent2": PICTURE}},
        "unknown camera in pictures 'agent2'; available: agent1, global",
    ),
}


@pytest.mark.parametrize("changed, message", WRONG.values(), ids=WRONG)
def test_a_wrong_term_of_a_step_is_named(path, changed, message):
    with open_recorder(path) as recorder, pytest.raises(ArgumentError) as error:
        recorder.step(0, **{"poses": POSES, "qpos": QPOS, **changed})
    assert message in str(error.value)


def test_other_wrong_values_are_named(path):
    with open_recorder(path) as recorder:
        recorder.step(5, poses=POSES, qpos=QPOS)
        with pytest.raises(ArgumentError, match="step 4 comes after step 5; steps do not go back"):
            recorder.step(4, poses=POSES, qpos=QPOS)
        with pytest.raises(ArgumentError, match="unknown agent 'agent3'; available: agent1, agent2"):
            recorder.occupancy("agent3", np.zeros((1, 3)))
        with pytest.raises(ArgumentError, match="centres_m of agent1 has shape 4x2; expected 4x3"):
            recorder.occupancy("agent1", np.zeros((4, 2)))
        with pytest.raises(ArgumentError, match="places_m has shape 1x2; expected 1x3"):
            recorder.violation(BLOCKED, [(0.0, 1.0)])
        with pytest.raises(ArgumentError, match="unknown agent 'agent0'; available: agent1, agent2"):
            recorder.motion(0, "home", "move")


def test_wrong_recordings_are_refused_with_the_reason(path, tmp_path):
    with pytest.raises(ArgumentError, match=r"generate-7\.mp4: the viewer opens only .* \.rrd"):
        open_recorder(path.with_suffix(".mp4"))
    with pytest.raises(ArgumentError, match="recording of 0 agents; expected at least 1"):
        open_recorder(path, agents=0)
    with pytest.raises(ArgumentError, match="unknown moving camera 'agent9'; available: agent1, global"):
        open_recorder(path, moving=["agent9"])
    bad = viz.Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), colour=np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="colour of 'world/objects/bad' has shape 2x3; expected 3 or 3x3"):
        open_recorder(path, meshes={viz.object_entity("bad"): bad})
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StageError, match=r"cannot write the recording .*file/x\.rrd: "):
        open_recorder(tmp_path / "file" / "x.rrd")


def test_a_hundred_steps_with_three_pictures_stay_small(path):
    """Pictures without any flat ground: blobs of 20 pixels in all colours."""
    rng = np.random.default_rng(0)
    noise = cv2.resize(rng.integers(0, 256, (12, 16, 3), dtype=np.uint8), (320, 240))
    cameras = {name: CameraModel(320, 240, 1.2, np.eye(4)) for name in ("global", "agent1", "agent2")}
    with open_recorder(path, cameras=cameras) as recorder:
        for step in range(100):
            pictures = {name: np.roll(noise, step, axis=1).astype(np.uint8) for name in cameras}
            recorder.step(step, poses=POSES, qpos=QPOS, action=ACTION, pictures=pictures)
    assert path.stat().st_size < 4e6  # raw pictures alone are 69 MB


def test_boxes_keep_sharp_edges_and_balls_stay_smooth():
    shape = trimesh.creation.box((1.0, 2.0, 3.0))
    kept, normals, faces = creased(shape.vertices, shape.faces)
    assert len(kept) == 24  # each corner once for each of its three sides
    corners = shape.vertices[kept][faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(normals[faces], np.repeat(outward[:, None], 3, axis=1), atol=1e-9)

    ball = trimesh.creation.icosphere(subdivisions=3)
    kept, normals, faces = creased(ball.vertices, ball.faces)
    assert len(kept) == len(ball.vertices)
    np.testing.assert_allclose(normals, ball.vertices[kept], atol=0.02)
    np.testing.assert_array_equal(ball.vertices[kept][faces], ball.vertices[ball.faces])


def test_linear_light_becomes_srgb():
    assert srgb((0.0, 0.2140, 1.0)).tolist() == [0, 127, 255]  # middle grey


def test_colours_of_agents_differ_from_one_another_and_from_verdicts():
    colours = np.array([*(viz.agent_colour(agent) for agent in range(1, 5)), VIOLATED, HOLDS], dtype=float)
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + 1e3 * np.eye(len(colours))
    assert apart.min() > 50
