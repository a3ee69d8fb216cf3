"""Recorder: writes what happened at each control step, and why, to a rerun file."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Self

import cv2
import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from rf_exp.errors import ArgumentError, StageError, unknown_choice
from rf_exp.findings import Violation
from rf_exp.robots import DEFAULT, Robot
from rf_exp.statements import Proposal
from rf_exp.texts.markdown import Markdown
from rf_exp.texts.markdown import text as words
from rf_exp.transforms import Matrix
from rf_exp.types import (
    CONTROL_DT_S,
    FINGERS,
    CameraModel,
    KeypointDetection,
    Schedule,
    Trajectory,
    fingers_of,
)
from rf_exp.viz import figures, layout, text
from rf_exp.viz.elements import (
    Mesh,
    dots,
    lines,
    mesh3d,
    opening_mm,
    path_part,
    pinhole,
    require_array,
    transform,
)
from rf_exp.viz.figures import Coordination, Mask, Pair
from rf_exp.viz.layout import HOLDS, VIOLATED, Panels, Rgb, agent_colour, camera_entity

rr.set_strict_mode(True)  # otherwise rerun drops invalid values with a warning

FLUSH_S = 5.0  # rows are written in batches; few large ones load faster than many small
FAINT = 110  # alpha of commanded curves, next to measured ones
JPEG_QUALITY = 80
VOXEL_ALPHA = 110  # of 255: the arm inside stays visible
VOXEL_EDGE_M = 0.0004
MARK_STEPS = 10  # control steps that the mark of a violation stays in the scene: half a second
MARK_RADIUS_M = 0.05  # visible around a gripper
NOW: Rgb = (255, 255, 255)
NOW_POINTS = 4.0  # radius on the screen, at any zoom
NEXT_PX, DETECTED_PX = 5.0, 2.0  # radii of detected keypoints: the next one of an agent, and others
NO_FAULT = ("not yet", "waits")  # states of a lane


class Recorder:
    """Writer of one recording. A context manager: the file is complete also after an exception.

    `cameras`: camera name -> CameraModel; empty without rendering. `moving`: the cameras whose pose
    is passed to each step under `camera_entity(name)`. `meshes`: entity path (`link_entity`,
    `object_entity`) -> Mesh; an entity that never gets a pose is in the world frame. An existing
    file at `path` is replaced, missing folders are made. `panels`: whether the layout shows plans and
    their checks, or a policy's predictions and how they were judged. `robots`: those of the agents,
    all `DEFAULT` unless given.

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
        robots: Sequence[Robot] = (),
    ) -> None:
        if path.suffix != ".rrd":
            raise ArgumentError(f"recording {path}: the viewer opens only names that end in .rrd")
        if agents < 1:
            raise ArgumentError(f"recording of {agents} agents; expected at least 1")
        self._path, self._agents, self._cameras, self._step = path, agents, dict(cameras), 0
        self._robots = tuple(robots) or (DEFAULT,) * agents
        self._dof = max(robot.dof for robot in self._robots)
        for name in moving:
            if name not in cameras:
                raise unknown_choice("moving camera", name, cameras)
        self._moving = tuple(moving)
        self._posed = {*meshes, *map(camera_entity, moving)}  # entities whose pose a step may set
        self._documents: dict[str, list[str]] = {}  # entity -> texts, newest first
        self._styled: set[str] = set()  # entities whose style is logged
        # group of curves -> their colours and names
        self._legends: dict[str, list[tuple[tuple[int, ...], str]]] = {}
        self._closed = False
        self._motions: list[dict[str, Rgb]] = [{} for _ in range(agents)]  # states of each agent's lane
        self._checks: dict[str, bool] = {}  # check -> whether its lane has a state now
        self._marks: list[tuple[str, NDArray[np.float64]]] = []  # (check, place) now in the scene
        self._marked_step = 0
        self._coordination: Coordination | None = None

        # One application per task and kind: the viewer keeps one layout for each, and tasks differ in agents.
        batches = rr.ChunkBatcherConfig.DEFAULT()
        batches.flush_tick = FLUSH_S
        application = f"rf_exp {task}{'' if panels == 'plan' else f' {panels}'}"
        self._stream = rr.RecordingStream(application, batcher_config=batches)
        self._stream.set_log_time_enabled(False)  # the machine's clock is no part of an episode
        self._stream.set_log_tick_enabled(False)
        pairs = agents * (agents - 1) // 2
        diagrams_px = figures.coordination_size_px(pairs) if pairs else None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(
                path, default_blueprint=layout.blueprint(agents, tuple(cameras), panels, diagrams_px)
            )
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

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not self._closed:
            self.note(f"ended by {type(error).__name__}: {error}", level="ERROR")
        self.close()

    def close(self) -> None:
        """Write pending rows and the footer. Nothing can be recorded afterwards."""
        self._closed = True
        self._stream.flush()
        self._stream.disconnect()

    def note(self, line: str, level: str = "INFO") -> None:
        """A line in the log: INFO, WARN or ERROR."""
        self._log("log", rr.TextLog(line, level=level))

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

        `poses`: entity path -> world_from_entity (4, 4) of links, objects and moving cameras; others
        keep theirs. `qpos` (N, D) rad and metres; `action` (N, A) rad and gripper command, None
        when nothing is commanded any more. `pictures`: camera -> (H, W, 3) sRGB. Steps do not go back.
        """
        pictures = pictures or {}
        if step < self._step:
            raise ArgumentError(f"step {step} comes after step {self._step}; steps do not go back")
        for entity, pose in poses.items():
            if entity not in self._posed:
                raise unknown_choice("entity in poses", entity, self._posed)
            require_array(f"poses[{entity!r}]", pose, (4, 4))
        require_array("qpos", qpos, (self._agents, self._dof + FINGERS))
        if action is not None:
            require_array("action", action, (self._agents, self._dof + 1))
        for name, picture in pictures.items():
            if name not in self._cameras:
                raise unknown_choice("camera in pictures", name, self._cameras)
            shape = (self._cameras[name].height_px, self._cameras[name].width_px, 3)
            require_array(f"pictures[{name!r}]", picture, shape, np.dtype(np.uint8))
        self._set_time(step)
        if self._marks and step - self._marked_step >= MARK_STEPS:
            self._marks.clear()
            self._log("world/violations", rr.Clear(recursive=False))
        for entity, pose in poses.items():
            self._log(entity, transform(pose))
        for agent in range(1, self._agents + 1):
            row, robot = qpos[agent - 1], self._robots[agent - 1]
            self._log(f"joints/agent{agent}/measured", rr.Scalars(row[: robot.dof]))
            self._log(f"gripper/agent{agent}/measured", rr.Scalars(1000.0 * fingers_of(row).sum()))
            if action is not None:
                target = action[agent - 1]
                self._log(f"joints/agent{agent}/target", rr.Scalars(target[: robot.dof]))
                self._log(f"gripper/agent{agent}/target", rr.Scalars(opening_mm(robot, target)))
        for name, picture in pictures.items():
            _, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            image = rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
            self._log(camera_entity(name), image)

    def occupancy(self, owner: str, centres_m: NDArray[np.floating] | None, size_m: float = 0.05) -> None:
        """Show the voxels that `owner` (`agent<k>` or an object) occupies, from now on.

        `centres_m` (K, 3) in the world, cubes of edge `size_m`. None or no rows: shows none.
        """
        colour = self._colour(owner)
        entity = f"world/occupancy/{rr.escape_entity_path_part(owner)}"
        if centres_m is None or len(centres_m) == 0:
            self._log(entity, rr.Clear(recursive=False))
            return
        require_array(f"centres_m of {owner}", centres_m, (len(centres_m), 3))
        cubes = rr.Boxes3D(
            centers=centres_m,
            half_sizes=np.full((len(centres_m), 3), 0.5 * size_m),
            colors=[(*colour, VOXEL_ALPHA)],
            radii=VOXEL_EDGE_M,
            fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
        )
        self._log(entity, cubes)

    def verdict(self, check: str, ok: bool, reason: str) -> None:
        """Record the verdict of a check. Its lane on the timeline keeps this state until the next one."""
        lane = f"checks/{rr.escape_entity_path_part(check)}"
        self._style(lane, rr.StateConfiguration(values=["holds", "violated"], colors=[HOLDS, VIOLATED]))
        self._checks[check] = True
        line = rr.TextLog(f"{check}: {reason}", level="INFO" if ok else "ERROR")
        self._log(lane, line, rr.StateChange(state="holds" if ok else "violated"))

    def plan_checks(self, results: Sequence[text.CheckResult]) -> None:
        """The check code of a plan with the evidence of each check; lanes of other checks become empty."""
        results_by_check = {path_part(result.code): result for result in results}
        for check, has_state in self._checks.items():
            if has_state and check not in results_by_check:
                self._checks[check] = False
                self._log(f"checks/{rr.escape_entity_path_part(check)}", rr.StateChange(state=""))
        for name, result in results_by_check.items():
            self.verdict(name, result.ok, result.reason)
        parts = text.summary(results), text.code_with_values(results), text.verdicts(results)
        self._document(layout.CHECKS, "Check code", Markdown("\n\n".join(parts)))

    def violation(self, violation: Violation, places_m: ArrayLike | None = None) -> None:
        """A violated check with its evidence, marked for half a second at `places_m` (K, 3) if known."""
        places = np.zeros((0, 3)) if places_m is None else np.asarray(places_m, dtype=float)
        require_array("places_m", places, (len(places), 3))
        line = text.violation(violation)
        self.verdict(violation.check, False, line)
        self._document(layout.CHECKS, "Violation", Markdown(f"**{violation.check}**: {words(line)}"))
        if not len(places):
            return
        if self._marked_step < self._step:
            self._marks.clear()
        self._marked_step = self._step
        self._marks += [(violation.check, place) for place in places]
        checks, positions = zip(*self._marks, strict=True)
        marks = rr.Points3D(
            positions, radii=MARK_RADIUS_M, colors=[VIOLATED], labels=checks, show_labels=True
        )
        self._log("world/violations", marks)

    def motion(self, agent: int, subgoal: str, primitive: str) -> None:
        """Motion of an agent (from 1) from now on. No primitive: it waits; no subgoal: it has no plan."""
        self._colour(f"agent{agent}")
        state = f"{primitive}: {subgoal}" if primitive else "waits" if subgoal else ""
        lane, colours = f"{layout.MOTIONS}/agent{agent}", self._motions[agent - 1]
        if state and state not in colours:
            colours[state] = layout.primitive_colour(primitive) if primitive else layout.WAITS
            # The style of a lane lists its states, so it is written anew with each new one.
            style = rr.StateConfiguration(values=list(colours), colors=list(colours.values()))
            self._log(lane, style, static=True)
        self._log(lane, rr.StateChange(state=state))

    def proposal(self, proposal: Proposal) -> None:
        """RoboBrain's answer as a document, and its subgoals in the log."""
        self._document(layout.PROPOSALS, "Proposal", text.proposal(proposal))
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
        self._coordination = figures.coordination(trajectories, schedule, close, ordered)
        _, png = cv2.imencode(".png", self._coordination.picture[..., ::-1])
        self._log(layout.DIAGRAMS, rr.EncodedImage(contents=png.tobytes(), media_type="image/png"))

    def path_positions(self, path_positions: NDArray[np.integer]) -> None:
        """Path positions of all agents (N,) now: a point in every coordination diagram."""
        if self._coordination is not None:
            pixels = self._coordination.at(path_positions)
            marks = rr.Points2D(pixels, radii=rr.Radius.ui_points(NOW_POINTS), colors=[NOW], draw_order=1.0)
            self._log(f"{layout.DIAGRAMS}/now", marks)

    def predicted_targets(self, agent: int, first: int, targets: NDArray[np.floating]) -> None:
        """A policy's predicted targets for an agent from step `first` on: (T, A) rad and gripper command."""
        self._colour(f"agent{agent}")
        robot = self._robots[agent - 1]
        require_array("targets", targets, (len(targets), self._dof + 1))
        joints, gripper = f"joints/agent{agent}/predicted", f"gripper/agent{agent}/predicted"
        opaque = [(*colour, 255) for colour in layout.JOINT_COLOURS[: robot.dof]]
        self._style(joints, dots(opaque, ["predicted"] * robot.dof))
        self._style(gripper, dots([(*agent_colour(agent), 255)], [f"agent {agent} predicted"]))
        for group in (f"joints/agent{agent}", "gripper"):
            self._legend(group, [(layout.INK, "dots: predicted")])
        current_step = self._step
        for step, target in enumerate(targets, start=first):
            self._set_time(step)
            self._log(joints, rr.Scalars(target[: robot.dof]))
            self._log(gripper, rr.Scalars(opening_mm(robot, target)))
        self._set_time(current_step)

    def detections(self, keypoints: Sequence[KeypointDetection]) -> None:
        """Detected keypoints in the pictures of the cameras; the next one of an agent is large."""
        for camera, model in self._cameras.items():
            camera_keypoints = [keypoint for keypoint in keypoints if keypoint.camera == camera]
            if not camera_keypoints:
                continue
            entity = f"{camera_entity(camera)}/seen"
            pixels = [
                (keypoint.x * model.width_px, keypoint.y * model.height_px) for keypoint in camera_keypoints
            ]
            colours = [self._colour(f"agent{keypoint.agent}") for keypoint in camera_keypoints]
            radii = rr.Radius.ui_points(
                [NEXT_PX if keypoint.is_next else DETECTED_PX for keypoint in camera_keypoints]
            )
            self._log(entity, rr.Points2D(pixels, colors=colours, radii=radii, draw_order=1.0))

    def path(self, agent: int, kind: str, places_m: NDArray[np.floating]) -> None:
        """A path of an agent's gripper (K, 3) in the scene: `predicted` is pale."""
        colour = self._colour(f"agent{agent}")
        require_array("places_m", places_m, (len(places_m), 3))
        path_colour = layout.pale(colour) if kind == "predicted" else colour
        radius = rr.Radius.ui_points(3.0 if kind == "predicted" else 2.0)
        strip = rr.LineStrips3D([places_m], colors=[path_colour], radii=radius)
        self._log(f"{layout.PATHS}/agent{agent}/{rr.escape_entity_path_part(kind)}", strip)

    def distance(self, a: int, b: int, distance_m: float) -> None:
        """Distance between two arms now, plotted in cm."""
        self._curve(layout.DISTANCES, f"agents {a} and {b}", 100 * distance_m)

    def contact(self, what: str, force_n: float) -> None:
        """Contact force on something now, 0 when the contact has ended."""
        self._curve(layout.CONTACTS, what, force_n)

    def margin(self, condition: str, value: float) -> None:
        """Value of a condition as a part of its bound: at 1 it begins or ceases to hold."""
        self._curve(layout.MARGINS, condition, value)

    def condition(
        self, name: str, holds: bool, line: str, states: tuple[str, str] = ("holds", "not yet")
    ) -> None:
        """State of a condition of success from now on, as a lane; the line goes to the log."""
        entity = f"{layout.CONDITIONS}/{path_part(name)}"
        colours = [HOLDS, layout.NOT_YET if states[1] in NO_FAULT else VIOLATED]
        self._style(entity, rr.StateConfiguration(values=list(states), colors=colours))
        state = rr.StateChange(state=states[0] if holds else states[1])
        self._log(entity, rr.TextLog(line, level="INFO"), state)

    def judgement(self, markdown: Markdown) -> None:
        """The judge's verdict from now on."""
        self._log(layout.VERDICT, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))

    def _set_time(self, step: int) -> None:
        self._step = step
        self._stream.set_time("step", sequence=step)
        self._stream.set_time("time", duration=step * CONTROL_DT_S)

    def _log(self, entity: str, *values: rr.AsComponents, static: bool = False) -> None:
        if self._closed:
            raise StageError(f"the recording {self._path} is closed; nothing more can be recorded in it")
        first, *rest = values
        self._stream.log(entity, first, *rest, static=static)

    def _style(self, entity: str, style: rr.AsComponents) -> None:
        """Log the style of an entity once."""
        if entity not in self._styled:
            self._styled.add(entity)
            self._log(entity, style, static=True)

    def _document(self, entity: str, title: str, markdown: Markdown) -> None:
        """Add to a document that shows everything so far, newest first: attempts share a step."""
        texts = self._documents.setdefault(entity, [])
        number = 1 + sum(entry.startswith(f"## {title} ") for entry in texts)
        texts.insert(0, f"## {title} {number}, step {self._step}\n\n{markdown}")
        self._log(entity, rr.TextDocument("\n\n".join(texts), media_type=rr.MediaType.MARKDOWN))

    def _colour(self, owner: str) -> Rgb:
        """The colour of `agent<k>` or of an object. Raises for an agent that does not exist."""
        number = owner.removeprefix("agent")
        if number == owner or not number.isdigit():
            return layout.OBJECT
        if not 1 <= int(number) <= self._agents:
            raise unknown_choice("agent", owner, (f"agent{agent}" for agent in range(1, self._agents + 1)))
        return agent_colour(int(number))

    def _static(self, cameras: Mapping[str, CameraModel], meshes: Mapping[str, Mesh]) -> None:
        """Log static data: axes, cameras, meshes, the style of the curves."""
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, camera in cameras.items():
            self._log(camera_entity(name), pinhole(camera), static=True)
            if name not in self._moving:
                require_array(f"world_from_camera of camera {name!r}", camera.world_from_camera, (4, 4))
                self._log(camera_entity(name), transform(camera.world_from_camera), static=True)
        for entity, mesh in meshes.items():
            self._log(entity, mesh3d(entity, mesh), static=True)
        for agent, robot in enumerate(self._robots, start=1):
            colour, name, colours = agent_colour(agent), f"agent {agent}", layout.JOINT_COLOURS[: robot.dof]
            names = [f"q{joint}" for joint in range(1, robot.dof + 1)]
            target_entry = layout.INK, "thin: target"
            self._legend(f"joints/agent{agent}", [*zip(colours, names, strict=True), target_entry])
            self._log(f"joints/agent{agent}/measured", lines(colours, names, 2), static=True)
            faint_colours = [(*colour, FAINT) for colour in colours]
            # One name for all targets: one line in the legend.
            self._log(
                f"joints/agent{agent}/target", lines(faint_colours, ["target"] * robot.dof, 1), static=True
            )
            self._log(f"gripper/agent{agent}/measured", lines([colour], [name], 2), static=True)
            self._legend(
                "gripper", [(colour, name)] if agent < self._agents else [(colour, name), target_entry]
            )
            target = lines([(*colour, FAINT)], [f"{name} target"], 1)
            self._log(f"gripper/agent{agent}/target", target, static=True)

    def _curve(self, group: str, name: str, value: float) -> None:
        """Log a number now, in a group of curves with different colours."""
        entity = f"{group}/{rr.escape_entity_path_part(name)}"
        if entity not in self._styled:
            count = len(self._legends.get(group, ()))
            colour = layout.AGENT_COLOURS[count % len(layout.AGENT_COLOURS)]
            self._style(entity, lines([colour], [name], 2))
            self._legend(group, [(colour, name)])
        self._log(entity, rr.Scalars(value))

    def _legend(self, group: str, rows: Sequence[tuple[tuple[int, ...], str]]) -> None:
        """Add rows to the legend of a group of curves."""
        entries = self._legends.setdefault(group, [])
        if not (new_entries := [row for row in rows if row not in entries]):
            return
        entries += new_entries
        colours, names = zip(*entries, strict=True)
        places = [(0.0, float(row)) for row in range(len(entries))]
        points = rr.Points2D(places, colors=colours, labels=names, radii=0.0, show_labels=True)
        self._log(f"{layout.LEGENDS}/{group}", points, static=True)
