"""Writes one recording: what happened at each control step, and why."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from rf_exp.findings import Violation
from rf_exp.robots import Robot
from rf_exp.statements import Proposal
from rf_exp.texts.markdown import Markdown
from rf_exp.texts.markdown import text as words
from rf_exp.transforms import Matrix
from rf_exp.types import CameraModel, KeypointDetection, Schedule, Trajectory, fingers_of
from rf_exp.viz import text
from rf_exp.viz.elements import Mesh, compressed, dots, expect, lane, opening_mm, placed, voxels
from rf_exp.viz.figures import Coordination, Mask, Pair, coordination
from rf_exp.viz.layout import (
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
    PATHS,
    PROPOSALS,
    VERDICT,
    VIOLATED,
    WAITS,
    Panels,
    Rgb,
    agent_colour,
    camera_entity,
    primitive_colour,
    shade,
)
from rf_exp.viz.stream import Stream

MARK_STEPS = 10  # control steps that the mark of a violation stays in the scene: half a second
MARK_RADIUS_M = 0.05  # stands out of a gripper
NOW: Rgb = (255, 255, 255)
NOW_POINTS = 4.0  # radius on the screen, however far the picture is zoomed
NEXT_PX, DETECTED_PX = 5.0, 2.0  # radii of detected keypoints: where an agent goes next, and others
NO_FAULT = ("not yet", "waits")  # states of a lane


class Recorder(Stream):
    """Writes one recording. A context manager: the file is complete also after an exception.

    `cameras`: camera name -> CameraModel; empty without rendering. `moving`: the cameras whose pose
    each step is told under `camera_entity(name)`. `meshes`: entity path (`link_entity`,
    `object_entity`) -> Mesh; an entity that never gets a pose stands in the world frame. An existing
    file at `path` is replaced, missing folders are made. `panels`: whether the layout shows plans and
    their checks, or what a policy predicted and how it was judged. `robots`: of the agents, the usual
    one unless given.

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
        super().__init__(
            path,
            task=task,
            title=title,
            agents=agents,
            cameras=cameras,
            meshes=meshes,
            moving=moving,
            panels=panels,
            robots=robots,
        )
        self._motions: list[dict[str, Rgb]] = [{} for _ in range(agents)]  # states of each agent's lane
        self._checks: dict[str, bool] = {}  # lanes seen -> they have a state now
        self._marks: list[tuple[str, NDArray[np.float64]]] = []  # (check, where) now in the scene
        self._marked_step = 0
        self._coordination: Coordination | None = None

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
        left out stays. `qpos` (N, D) rad and metres; `action` (N, A) rad and gripper command, None
        when nothing is commanded any more. `pictures`: camera -> (H, W, 3) sRGB. Steps do not go back.
        """
        self._check_step(step, poses, qpos, action, pictures or {})
        self._set_time(step)
        if self._marks and step - self._marked_step >= MARK_STEPS:
            self._marks.clear()
            self._log("world/violations", rr.Clear(recursive=False))
        for entity, pose in poses.items():
            self._log(entity, placed(pose))
        for agent in range(1, self._agents + 1):
            row, robot = qpos[agent - 1], self._robots[agent - 1]
            self._log(f"joints/agent{agent}/measured", rr.Scalars(row[: robot.dof]))
            self._log(f"gripper/agent{agent}/measured", rr.Scalars(1000.0 * fingers_of(row).sum()))
            if action is not None:
                target = action[agent - 1]
                self._log(f"joints/agent{agent}/target", rr.Scalars(target[: robot.dof]))
                self._log(f"gripper/agent{agent}/target", rr.Scalars(opening_mm(robot, target)))
        for name, picture in (pictures or {}).items():
            self._log(camera_entity(name), compressed(picture))

    def occupancy(self, owner: str, centres_m: NDArray[np.floating] | None, size_m: float = 0.05) -> None:
        """Show the voxels that `owner` (`agent<k>` or an object) occupies, from now on.

        `centres_m` (K, 3) in the world, cubes of edge `size_m`. None or no rows: shows none.
        """
        colour = self._colour(owner)
        entity = f"world/occupancy/{rr.escape_entity_path_part(owner)}"
        if centres_m is None or len(centres_m) == 0:
            self._log(entity, rr.Clear(recursive=False))
            return
        expect(f"centres_m of {owner}", centres_m, (len(centres_m), 3))
        self._log(entity, voxels(centres_m, size_m, colour))

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
        names = {lane(result.code): result for result in results}
        for check, going_on in self._checks.items():
            if going_on and check not in names:
                self._checks[check] = False
                self._log(f"checks/{rr.escape_entity_path_part(check)}", rr.StateChange(state=""))
        for name, result in names.items():
            self.verdict(name, result.ok, result.reason)
        parts = text.summary(results), text.judged_code(results), text.verdicts(results)
        self._document(CHECKS, "Check code", Markdown("\n\n".join(parts)))

    def violation(self, violation: Violation, places_m: ArrayLike | None = None) -> None:
        """A violated check with its evidence, marked for half a second at `places_m` (K, 3) if known."""
        places = np.zeros((0, 3)) if places_m is None else np.asarray(places_m, dtype=float)
        expect("places_m", places, (len(places), 3))
        line = text.violation(violation)
        self.verdict(violation.check, False, line)
        self._document(CHECKS, "Violation", Markdown(f"**{violation.check}**: {words(line)}"))
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
        """What a policy predicts for an agent from step `first` on: (T, A) rad and gripper command."""
        self._colour(f"agent{agent}")
        robot = self._robots[agent - 1]
        expect("targets", targets, (len(targets), self._dof + 1))
        entity, colour = f"joints/agent{agent}/predicted", agent_colour(agent)
        if entity not in self._styled:
            self._styled.add(entity)
            opaque = [(*each, 255) for each in JOINT_COLOURS[: robot.dof]]
            self._log(entity, dots(opaque, ["predicted"] * robot.dof), static=True)
            gripper = dots([(*colour, 255)], [f"agent {agent} predicted"])
            self._log(f"gripper/agent{agent}/predicted", gripper, static=True)
        now = self._step
        for step, target in enumerate(targets, start=first):
            self._set_time(step)
            self._log(entity, rr.Scalars(target[: robot.dof]))
            self._log(f"gripper/agent{agent}/predicted", rr.Scalars(opening_mm(robot, target)))
        self._set_time(now)

    def detections(self, keypoints: Sequence[KeypointDetection]) -> None:
        """Detected keypoints, in the pictures of the cameras: large where an agent goes next."""
        for camera, model in self._cameras.items():
            ours = [each for each in keypoints if each.camera == camera]
            if not ours:
                continue
            entity = f"{camera_entity(camera)}/seen"
            places = [(each.x * model.width_px, each.y * model.height_px) for each in ours]
            colours = [self._colour(f"agent{each.agent}") for each in ours]
            radii = rr.Radius.ui_points([NEXT_PX if each.is_next else DETECTED_PX for each in ours])
            self._log(entity, rr.Points2D(places, colors=colours, radii=radii, draw_order=1.0))

    def path(self, agent: int, kind: str, places_m: NDArray[np.floating]) -> None:
        """A path of an agent's hand (K, 3) in the scene: `predicted` is pale."""
        colour = self._colour(f"agent{agent}")
        expect("places_m", places_m, (len(places_m), 3))
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
        entity = f"{CONDITIONS}/{lane(name)}"
        if entity not in self._styled:
            self._styled.add(entity)
            colours = [HOLDS, NOT_YET if states[1] in NO_FAULT else VIOLATED]
            self._log(entity, rr.StateConfiguration(values=list(states), colors=colours), static=True)
        self._log(
            entity, rr.TextLog(line, level="INFO"), rr.StateChange(state=states[0] if holds else states[1])
        )

    def judged(self, markdown: Markdown) -> None:
        """What the judge says, from now on."""
        self._log(VERDICT, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))
