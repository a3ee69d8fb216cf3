"""Writes one recording: what happened at each control step, and why."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun.components import FillMode, MarkerShape

from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.findings import Violation
from rf_exp.statements import Proposal
from rf_exp.transforms import Matrix
from rf_exp.types import (
    ARM_JOINTS,
    CONTROL_DT_S,
    GRIPPER_CLOSED,
    GRIPPER_OPEN,
    CameraModel,
    Schedule,
    Sight,
    Trajectory,
)
from rf_exp.viz import text
from rf_exp.viz.figures import Coordination, Mask, Pair, coordination, coordination_size_px
from rf_exp.viz.layout import (
    AGENT_COLOURS,
    CHECKS,
    CONDITIONS,
    CONTACTS,
    DIAGRAMS,
    DISTANCES,
    HOLDS,
    JOINT_COLOURS,
    MARGINS,
    MOTIONS,
    NOT_YET,
    OBJECT,
    PATHS,
    PROPOSALS,
    VERDICT,
    VIOLATED,
    WAITS,
    Panels,
    Rgb,
    agent_colour,
    blueprint,
    camera_entity,
    primitive_colour,
    shade,
)
from rf_exp.viz.shading import creased, srgb

rr.set_strict_mode(True)  # else rerun drops what it cannot take, with a warning

JPEG_QUALITY = 80
FLUSH_S = 5.0  # rows are written in batches; few large ones load faster than many small
MARK_STEPS = 10  # control steps that the mark of a violation stays in the scene: half a second
MARK_RADIUS_M = 0.05  # stands out of a gripper
OPEN_MM = 80.0  # between the Panda's fingers when fully open
FRUSTUM_M = 0.07  # length of the drawn cameras
VOXEL_ALPHA = 110  # of 255: the arm inside stays visible
VOXEL_EDGE_M = 0.0004
NOW: Rgb = (255, 255, 255)
NOW_POINTS = 4.0  # radius on the screen, however far the picture is zoomed
FAINT = 110  # alpha of commanded curves, next to measured ones
GOES_PX, SEEN_PX = 5.0, 2.0  # radii of the points that heat maps see, where an agent goes next and others
NO_FAULT = ("not yet", "waits")  # states of a lane
PREDICTED_PX = 1.5  # size of the dots that stand for what was predicted


@dataclass(frozen=True)
class Mesh:
    """Triangles in the frame of their entity, metres.

    `colour`: linear RGB in [0, 1], (3,) for all or (V, 3) for each vertex. None: an arm takes the
    colour of its agent, anything else grey.
    """

    vertices: NDArray[np.floating]  # (V, 3)
    faces: NDArray[np.integer]  # (F, 3) indices into vertices, counter-clockwise from outside
    colour: ArrayLike | None = None


class Recorder:
    """Writes one recording. A context manager: the file is complete also after an exception.

    `cameras`: camera name -> CameraModel; empty without rendering. `moving`: the cameras whose pose
    each step is told under `camera_entity(name)`. `meshes`: entity path (`link_entity`,
    `object_entity`) -> Mesh; an entity that never gets a pose stands in the world frame. An existing
    file at `path` is replaced, missing folders are made. `panels`: whether the layout shows plans and
    their checks, or what a policy predicted and how it was judged.

    Raises ArgumentError for a value of the wrong shape, type or name, naming it; StageError when
    the file cannot be written or was closed.
    """

    def __init__(
        self,
        path: Path,
        *,
        task: str,
        title: str,
        agents: int,
        cameras: Mapping[str, CameraModel],
        meshes: Mapping[str, Mesh],
        moving: Collection[str] = (),
        panels: Panels = "plan",
    ) -> None:
        if path.suffix != ".rrd":
            raise ArgumentError(f"recording {path}: the viewer opens only names that end in .rrd")
        if agents < 1:
            raise ArgumentError(f"recording of {agents} agents; expected at least 1")
        self._path, self._agents, self._cameras, self._step = path, agents, dict(cameras), 0
        for name in moving:
            if name not in cameras:
                raise choices("moving camera", name, cameras)
        self._moving = frozenset(moving)
        self._posed = {*meshes, *map(camera_entity, moving)}  # entities that a step may place
        self._motions: list[dict[str, Rgb]] = [{} for _ in range(agents)]  # states of each agent's lane
        self._checks: dict[str, bool] = {}  # lanes seen -> they have a state now
        self._documents: dict[str, list[str]] = {}  # entity -> texts, newest first
        self._marks: list[tuple[str, NDArray[np.float64]]] = []  # (check, where) now in the scene
        self._marked_step = 0
        self._coordination: Coordination | None = None
        self._curved: dict[str, int] = {}  # group -> curves in it so far
        self._styled: set[str] = set()  # entities that have their style
        self._closed = False

        batches = rr.ChunkBatcherConfig.DEFAULT()
        batches.flush_tick = FLUSH_S
        # One application per task and kind: the viewer keeps one layout for each, and tasks differ in agents.
        kind = "" if panels == "plan" else f" {panels}"
        self._stream = rr.RecordingStream(f"rf_exp {task}{kind}", batcher_config=batches)
        self._stream.set_log_time_enabled(False)  # the machine's clock is no part of an episode
        self._stream.set_log_tick_enabled(False)
        pairs = agents * (agents - 1) // 2
        layout = blueprint(agents, tuple(cameras), panels, coordination_size_px(pairs) if pairs else None)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(path, default_blueprint=layout)
        except (OSError, RuntimeError) as error:
            raise StageError(f"cannot write the recording {path}: {error}") from error
        try:
            self._stream.send_recording_name(title)
            self._static(cameras, meshes)
            self._set_time(0)
            self.note(title)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and not self._closed:
            self.note(f"ended by {type(error).__name__}: {error}", level="ERROR")
        self.close()

    def close(self) -> None:
        """Write everything that waits, and the footer. Nothing can be recorded afterwards."""
        self._closed = True
        self._stream.flush()
        self._stream.disconnect()

    def step(
        self,
        step: int,
        *,
        poses: Mapping[str, Matrix],
        qpos: NDArray[np.floating],
        action: NDArray[np.floating] | None = None,
        pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    ) -> None:
        """Record one control step; everything recorded until the next call belongs to it.

        `poses`: entity path -> world_from_entity (4, 4) of links, objects and moving cameras; who is
        left out stays. `qpos` (N, 9) rad and metres; `action` (N, 8) rad and gripper command, None
        when nothing is commanded any more. `pictures`: camera -> (H, W, 3) sRGB. Steps do not go back.
        """
        self._check_step(step, poses, qpos, action, pictures or {})
        self._set_time(step)
        if self._marks and step - self._marked_step >= MARK_STEPS:
            self._marks.clear()
            self._log("world/violations", rr.Clear(recursive=False))
        for entity, pose in poses.items():
            self._log(entity, _placed(pose))
        for agent in range(1, self._agents + 1):
            row = qpos[agent - 1]
            self._log(f"joints/agent{agent}/measured", rr.Scalars(row[:ARM_JOINTS]))
            self._log(f"gripper/agent{agent}/measured", rr.Scalars(1000.0 * row[ARM_JOINTS:].sum()))
            if action is not None:
                target = action[agent - 1]
                self._log(f"joints/agent{agent}/target", rr.Scalars(target[:ARM_JOINTS]))
                self._log(f"gripper/agent{agent}/target", rr.Scalars(_opening_mm(target)))
        for name, picture in (pictures or {}).items():
            self._log(camera_entity(name), _compressed(picture))

    def occupancy(self, owner: str, centres_m: NDArray[np.floating] | None, size_m: float = 0.05) -> None:
        """Show the voxels that `owner` (`agent<k>` or an object) occupies, from now on.

        `centres_m` (K, 3) in the world, cubes of edge `size_m`. None or no rows: shows none.
        """
        colour = self._colour(owner)
        entity = f"world/occupancy/{rr.escape_entity_path_part(owner)}"
        if centres_m is None or len(centres_m) == 0:
            self._log(entity, rr.Clear(recursive=False))
            return
        _expect(f"centres_m of {owner}", centres_m, (len(centres_m), 3))
        voxels = rr.Boxes3D(
            centers=centres_m,
            half_sizes=np.full((len(centres_m), 3), 0.5 * size_m),
            colors=[(*colour, VOXEL_ALPHA)],
            radii=VOXEL_EDGE_M,
            fill_mode=FillMode.TransparentFillMajorWireframe,
        )
        self._log(entity, voxels)

    def verdict(self, check: str, ok: bool, reason: str) -> None:
        """What a check says now. Its lane on the timeline keeps this state until its next verdict."""
        lane = f"checks/{rr.escape_entity_path_part(check)}"
        if check not in self._checks:
            style = rr.StateConfiguration(values=["holds", "violated"], colors=[HOLDS, VIOLATED])
            self._log(lane, style, static=True)
        self._checks[check] = True
        line = rr.TextLog(f"{check}: {reason}", level="INFO" if ok else "ERROR")
        self._log(lane, line, rr.StateChange(state="holds" if ok else "violated"))

    def checked(self, results: Sequence[text.CheckResult]) -> None:
        """The check code of a plan with the evidence of each check; other checks have nothing to say now."""
        names = {_lane(result.code): result for result in results}
        for check, going_on in self._checks.items():
            if going_on and check not in names:
                self._checks[check] = False
                self._log(f"checks/{rr.escape_entity_path_part(check)}", rr.StateChange(state=""))
        for name, result in names.items():
            self.verdict(name, result.ok, result.reason)
        parts = text.summary(results), text.judged_code(results), text.verdicts(results)
        self._document(CHECKS, "Check code", "\n\n".join(parts))

    def violation(self, violation: Violation, places_m: ArrayLike | None = None) -> None:
        """A violated check with its evidence, marked for half a second at `places_m` (K, 3) if known."""
        places = np.zeros((0, 3)) if places_m is None else np.asarray(places_m, dtype=float)
        _expect("places_m", places, (len(places), 3))
        line = text.violation(violation)
        self.verdict(violation.check, False, line)
        self._document(CHECKS, "Violation", f"**{violation.check}**: {line}")
        if not len(places):
            return
        if self._marked_step < self._step:
            self._marks.clear()
        self._marked_step = self._step
        self._marks += [(violation.check, place) for place in places]
        checks, where = zip(*self._marks, strict=True)
        marks = rr.Points3D(where, radii=MARK_RADIUS_M, colors=[VIOLATED], labels=checks, show_labels=True)
        self._log("world/violations", marks)

    def motion(self, agent: int, subgoal: str, primitive: str) -> None:
        """What an agent (from 1) does from now on. No primitive: it waits; no subgoal: it has no plan."""
        self._colour(f"agent{agent}")
        state = f"{primitive}: {subgoal}" if primitive else "waits" if subgoal else ""
        lane, seen = f"{MOTIONS}/agent{agent}", self._motions[agent - 1]
        if state and state not in seen:
            seen[state] = primitive_colour(primitive) if primitive else WAITS
            # The style of a lane lists its states, so it is written anew with each new one.
            style = rr.StateConfiguration(values=list(seen), colors=list(seen.values()))
            self._log(lane, style, static=True)
        self._log(lane, rr.StateChange(state=state))

    def proposal(self, proposal: Proposal) -> None:
        """RoboBrain's answer as a document, and its subgoals in the log."""
        self._document(PROPOSALS, "Proposal", text.proposal(proposal))
        for goal in proposal.subgoals:
            self.note(f"agent {goal.agent} is to {goal.text}")

    def coordination(
        self,
        trajectories: Sequence[Trajectory],
        schedule: Schedule,
        close: Mapping[Pair, Mask],
        ordered: Mapping[Pair, Mask],
    ) -> None:
        """The coordination diagrams of a plan, see `figures.coordination`."""
        if not close:
            return
        self._coordination = coordination(trajectories, schedule, close, ordered)
        _, png = cv2.imencode(".png", self._coordination.picture[..., ::-1])
        self._log(DIAGRAMS, rr.EncodedImage(contents=png.tobytes(), media_type="image/png"))

    def positions(self, positions: NDArray[np.integer]) -> None:
        """Where all agents (N,) are on their paths now: a point in every coordination diagram."""
        if self._coordination is not None:
            where = self._coordination.at(positions)
            now = rr.Points2D(where, radii=rr.Radius.ui_points(NOW_POINTS), colors=[NOW], draw_order=1.0)
            self._log(f"{DIAGRAMS}/now", now)

    # -- what a policy does and how it is judged ---------------------------------------------------

    def predicted(self, agent: int, first: int, targets: NDArray[np.floating]) -> None:
        """What a policy predicts for an agent from step `first` on: (T, 8) rad and gripper command."""
        self._colour(f"agent{agent}")
        _expect("targets", targets, (len(targets), ARM_JOINTS + 1))
        entity, colour = f"joints/agent{agent}/predicted", agent_colour(agent)
        if entity not in self._styled:
            self._styled.add(entity)
            dots = [(*each, 255) for each in JOINT_COLOURS]
            self._points(entity, dots, ["predicted"] * ARM_JOINTS)
            self._points(f"gripper/agent{agent}/predicted", [(*colour, 255)], [f"agent {agent} predicted"])
        now = self._step
        for step, target in enumerate(targets, start=first):
            self._set_time(step)
            self._log(entity, rr.Scalars(target[:ARM_JOINTS]))
            self._log(f"gripper/agent{agent}/predicted", rr.Scalars(_opening_mm(target)))
        self._set_time(now)

    def seen(self, sights: Sequence[Sight]) -> None:
        """What heat maps see, in the pictures of the cameras: large where an agent goes next."""
        for camera, model in self._cameras.items():
            ours = [sight for sight in sights if sight.camera == camera]
            if not ours:
                continue
            entity = f"{camera_entity(camera)}/seen"
            places = [(sight.x * model.width_px, sight.y * model.height_px) for sight in ours]
            colours = [self._colour(f"agent{sight.agent}") for sight in ours]
            radii = rr.Radius.ui_points([GOES_PX if sight.goes else SEEN_PX for sight in ours])
            self._log(entity, rr.Points2D(places, colors=colours, radii=radii, draw_order=1.0))

    def path(self, agent: int, kind: str, places_m: NDArray[np.floating]) -> None:
        """A path of an agent's hand (K, 3) in the scene: `predicted` is pale."""
        colour = self._colour(f"agent{agent}")
        _expect("places_m", places_m, (len(places_m), 3))
        shown = shade(colour, 3.0) if kind == "predicted" else colour
        radius = rr.Radius.ui_points(3.0 if kind == "predicted" else 2.0)
        strip = rr.LineStrips3D([places_m], colors=[shown], radii=radius)
        self._log(f"{PATHS}/agent{agent}/{rr.escape_entity_path_part(kind)}", strip)

    def distance(self, a: int, b: int, distance_m: float) -> None:
        """How far two arms are from one another, drawn in cm."""
        self._curve(DISTANCES, f"agents {a} and {b}", 100 * distance_m)

    def contact(self, what: str, force_n: float) -> None:
        """With which force something is pushed now, 0 when it no longer is."""
        self._curve(CONTACTS, what, force_n)

    def margin(self, condition: str, value: float) -> None:
        """A condition's number as a part of its bound: 1 is where it begins to hold, or ends."""
        self._curve(MARGINS, condition, value)

    def condition(
        self, name: str, holds: bool, line: str, states: tuple[str, str] = ("holds", "not yet")
    ) -> None:
        """A condition of success as a lane, from now on; the line goes to the log."""
        lane = f"{CONDITIONS}/{_lane(name)}"
        if lane not in self._styled:
            self._styled.add(lane)
            colours = [HOLDS, NOT_YET if states[1] in NO_FAULT else VIOLATED]
            self._log(lane, rr.StateConfiguration(values=list(states), colors=colours), static=True)
        self._log(
            lane, rr.TextLog(line, level="INFO"), rr.StateChange(state=states[0] if holds else states[1])
        )

    def judged(self, markdown: str) -> None:
        """What the judge says, from now on."""
        self._log(VERDICT, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))

    def note(self, line: str, level: str = "INFO") -> None:
        """A line in the log: INFO, WARN or ERROR."""
        self._log("log", rr.TextLog(line, level=level))

    def _check_step(
        self,
        step: int,
        poses: Mapping[str, Matrix],
        qpos: NDArray[np.floating],
        action: NDArray[np.floating] | None,
        pictures: Mapping[str, NDArray[np.uint8]],
    ) -> None:
        if step < self._step:
            raise ArgumentError(f"step {step} comes after step {self._step}; steps do not go back")
        for entity, pose in poses.items():
            if entity not in self._posed:
                raise choices("entity in poses", entity, self._posed)
            _expect(f"poses[{entity!r}]", pose, (4, 4))
        _expect("qpos", qpos, (self._agents, ARM_JOINTS + 2))
        if action is not None:
            _expect("action", action, (self._agents, ARM_JOINTS + 1))
        for name, picture in pictures.items():
            if name not in self._cameras:
                raise choices("camera in pictures", name, self._cameras)
            shape = (self._cameras[name].height_px, self._cameras[name].width_px, 3)
            _expect(f"pictures[{name!r}]", picture, shape, np.dtype(np.uint8))

    def _set_time(self, step: int) -> None:
        self._step = step
        self._stream.set_time("step", sequence=step)
        self._stream.set_time("time", duration=step * CONTROL_DT_S)

    def _log(self, entity: str, *values: rr.AsComponents, static: bool = False) -> None:
        if self._closed:
            raise StageError(f"the recording {self._path} is closed; nothing more can be recorded in it")
        first, *rest = values
        self._stream.log(entity, first, *rest, static=static)

    def _document(self, entity: str, title: str, markdown: str) -> None:
        """Add to a document that shows everything so far, newest first: attempts share a step."""
        texts = self._documents.setdefault(entity, [])
        number = 1 + sum(each.startswith(f"## {title} ") for each in texts)
        texts.insert(0, f"## {title} {number}, step {self._step}\n\n{markdown}")
        self._log(entity, rr.TextDocument("\n\n".join(texts), media_type=rr.MediaType.MARKDOWN))

    def _colour(self, owner: str) -> Rgb:
        """The colour of `agent<k>` or of an object. Raises for an agent that does not exist."""
        number = owner.removeprefix("agent")
        if number == owner or not number.isdigit():
            return OBJECT
        if not 1 <= int(number) <= self._agents:
            raise choices("agent", owner, (f"agent{agent}" for agent in range(1, self._agents + 1)))
        return agent_colour(int(number))

    def _static(self, cameras: Mapping[str, CameraModel], meshes: Mapping[str, Mesh]) -> None:
        """What never changes: axes, cameras, meshes, the style of the curves."""
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, camera in cameras.items():
            self._log(camera_entity(name), _pinhole(camera), static=True)
            if name not in self._moving:
                _expect(f"world_from_camera of camera {name!r}", camera.world_from_camera, (4, 4))
                self._log(camera_entity(name), _placed(camera.world_from_camera), static=True)
        for entity, mesh in meshes.items():
            self._log(entity, self._mesh(entity, mesh), static=True)
        faint = [(*colour, FAINT) for colour in JOINT_COLOURS]
        names = [f"q{joint}" for joint in range(1, ARM_JOINTS + 1)]
        for agent in range(1, self._agents + 1):
            colour, name = agent_colour(agent), f"agent {agent}"
            self._curves(f"joints/agent{agent}/measured", JOINT_COLOURS, names, 2)
            # One name for all targets: one line in the legend.
            self._curves(f"joints/agent{agent}/target", faint, ["target"] * ARM_JOINTS, 1)
            self._curves(f"gripper/agent{agent}/measured", [colour], [name], 2)
            self._curves(f"gripper/agent{agent}/target", [(*colour, FAINT)], [f"{name} target"], 1)

    def _curves(self, entity: str, colours: Iterable[tuple[int, ...]], names: list[str], width: int) -> None:
        lines = rr.SeriesLines(colors=list(colours), names=names, widths=[width] * len(names))
        self._log(entity, lines, static=True)

    def _points(self, entity: str, colours: Iterable[tuple[int, ...]], names: list[str]) -> None:
        dots = rr.SeriesPoints(
            colors=list(colours),
            names=names,
            marker_sizes=[PREDICTED_PX] * len(names),
            markers=[MarkerShape.Circle] * len(names),
        )
        self._log(entity, dots, static=True)

    def _curve(self, group: str, name: str, value: float) -> None:
        """A number now, in a group of curves that are told apart by their colours."""
        entity = f"{group}/{rr.escape_entity_path_part(name)}"
        if entity not in self._styled:
            self._styled.add(entity)
            index = self._curved[group] = self._curved.get(group, -1) + 1
            self._curves(entity, [AGENT_COLOURS[index % len(AGENT_COLOURS)]], [name], 2)
        self._log(entity, rr.Scalars(value))

    def _mesh(self, entity: str, mesh: Mesh) -> rr.Mesh3D:
        count = len(mesh.vertices)
        _expect(f"vertices of {entity!r}", mesh.vertices, (count, 3))
        _expect(f"faces of {entity!r}", mesh.faces, (len(mesh.faces), 3))
        if mesh.colour is None:
            tint = np.array(shade(self._colour(entity.split("/")[1]), 1.5))
        else:
            tint = srgb(mesh.colour)
        if tint.shape not in ((3,), (count, 3)):
            found = "x".join(map(str, tint.shape))
            raise ArgumentError(f"colour of {entity!r} has shape {found}; expected 3 or {count}x3")
        vertices, normals, faces = creased(mesh.vertices, mesh.faces)
        return rr.Mesh3D(
            vertex_positions=mesh.vertices[vertices],
            triangle_indices=faces,
            vertex_normals=normals,
            vertex_colors=np.broadcast_to(tint, (count, 3))[vertices].astype(np.uint8),
        )


def _expect(name: str, value: object, shape: tuple[int, ...], dtype: np.dtype | None = None) -> None:
    """Raise ArgumentError naming `name` unless `value` is an array of that shape, type and finite."""
    array = np.asarray(value)
    if array.shape != shape:
        found = "x".join(map(str, array.shape)) or "of one number"
        raise ArgumentError(f"{name} has shape {found}; expected {'x'.join(map(str, shape))}")
    if dtype is not None and array.dtype != dtype:
        raise ArgumentError(f"{name} is {array.dtype}; expected {dtype}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name} holds {array[~np.isfinite(array)][0]}; expected finite numbers")


def _opening_mm(target: NDArray[np.floating]) -> float:
    """Between the fingers, for a commanded target (8,)."""
    return OPEN_MM * float(target[ARM_JOINTS] - GRIPPER_CLOSED) / (GRIPPER_OPEN - GRIPPER_CLOSED)


def _lane(code: str) -> str:
    """Check code or a condition as an entity path shows it without escapes."""
    return re.sub(r"\W+", "-", code).strip("-")


def _placed(pose: Matrix) -> rr.Transform3D:
    return rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])


def _pinhole(camera: CameraModel) -> rr.Pinhole:
    return rr.Pinhole(
        image_from_camera=camera.intrinsics,
        width=camera.width_px,
        height=camera.height_px,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=FRUSTUM_M,
    )


def _compressed(picture: NDArray[np.uint8]) -> rr.EncodedImage:
    _, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
