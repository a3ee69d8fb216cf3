"""A recorder of two arms and a barrier, data to record, and a reader of the files."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun.chunk as rrc
import trimesh

from rf_exp import viz
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.transforms import from_axes, planar
from rf_exp.types import CameraModel, Schedule, Segment, Subgoal, Trajectory
from rf_exp.viz import text

BARRIER = viz.object_entity("barrier")
LINKS = [viz.link_entity(agent, link) for agent in (1, 2) for link in ("panda_link0", "panda_hand")]
EYE_M = np.array([1.05, 0.0, 0.75])
CAMERAS = {
    "global": CameraModel(32, 24, np.deg2rad(70), from_axes(EYE_M, z=-EYE_M, y=(0, 0, -1))),
    "agent1": CameraModel(32, 24, np.deg2rad(70), np.eye(4)),  # moves with the wrist
}
QPOS = np.tile([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8, 0.04, 0.04], (2, 1))
ACTION = np.tile([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8, -1.0], (2, 1))
PICTURE = np.full((24, 32, 3), (200, 30, 90), np.uint8)
POSES = {LINKS[0]: planar(0.0, -0.75, np.pi / 2), BARRIER: planar(0.1, 0.0, 0.3, 0.05)}


def box(size_m: tuple[float, float, float]) -> viz.Mesh:
    shape = trimesh.creation.box(size_m)
    return viz.Mesh(shape.vertices, shape.faces, (0.3, 0.3, 0.3))


def open_recorder(path: Path, **overrides) -> viz.Recorder:
    meshes = {BARRIER: box((0.9, 0.05, 0.1)), **{link: box((0.1, 0.1, 0.3)) for link in LINKS}}
    defaults = {
        "task": "lift_barrier",
        "title": "lift barrier, full, seed 7",
        "agents": 2,
        "cameras": CAMERAS,
        "meshes": meshes,
        "moving": ["agent1"] if "agent1" in overrides.get("cameras", CAMERAS) else [],
    }
    return viz.Recorder(path, **{**defaults, **overrides})


class Content:
    """The content of a recording, by entity."""

    def __init__(self, path: Path, store: rrc.StoreEntry | None = None) -> None:
        self.reader = rrc.RrdReader(path)
        self.blueprints = self.reader.blueprints()
        self.batches: dict[str, list[pa.RecordBatch]] = defaultdict(list)
        self.timelines: dict[str, set[str]] = defaultdict(set)
        for chunk in self.reader.stream(store=store or self.reader.recordings()[0]):
            self.batches[chunk.entity_path].append(chunk.to_record_batch())
            self.timelines[chunk.entity_path] |= set(chunk.timeline_names)

    def rows(self, entity: str, component: str) -> list[tuple[int | None, list]]:
        """(step, value) of every row with the component, in the order of logging; step is None if static."""
        matches = []
        for batch in self.batches[entity]:
            names = batch.schema.names
            if component in names:
                values = batch.column(component).to_pylist()
                steps = batch.column("step").to_pylist() if "step" in names else [None] * len(values)
                order = [bytes(row) for row in batch.column(names[0]).to_pylist()]
                matches += [row for row in zip(order, steps, values, strict=True) if row[2] is not None]
        return [(step, value) for _, step, value in sorted(matches, key=lambda row: row[0])]

    def column(self, entity: str, component: str) -> list:
        """All logged values of a component, in the order of logging."""
        return [value for _, value in self.rows(entity, component)]

    def steps(self, entity: str, component: str) -> list[int]:
        """The step of every row with the component."""
        return [step for step, _ in self.rows(entity, component) if step is not None]

    def texts(self, entity: str) -> list[str]:
        return [text for row in self.column(entity, "TextLog:text") for text in row]


BLOCKED = Violation(
    check=CheckName.MOTION, cause=Cause.SPACE, finding=Finding.NO_PATH, time_s=0.2, agents=(1,),
    subgoals=("go home",),
)  # fmt: skip
RESULTS = (
    text.CheckResult("VI(Agent_1, barrier, left)", "said", True, 0.0021, 0.01, "m", 1.5, "2 mm | off"),
    text.CheckResult("VSO(Agent_1)", "said", False, 0.004, 0.01, "m", 2.0, "too near"),
    text.CheckResult("VSO(Agent_2, objects)", "said", True, np.inf, 0.003, "m", 0.0, "nothing to avoid"),
)


def motionless(agent: int, *parts: tuple[str, int]) -> Trajectory:
    """Segments without motion: figures of plans only use the numbers of steps."""
    segments = tuple(
        Segment(agent, Subgoal(agent, "grasp", "barrier", "left"), name, np.zeros((steps, 7)), np.ones(steps))
        for name, steps in parts
    )
    return Trajectory(agent, np.zeros(7), 1.0, segments)


TWO = (motionless(1, ("approach", 20), ("close", 10)), motionless(2, ("approach", 20)))
# Agent 2 waits at its start while agent 1 makes ten steps, then both move.
TIMED = Schedule(np.array([[t, 0] for t in range(10)] + [[10 + t, t] for t in range(21)]), 30)
