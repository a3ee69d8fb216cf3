"""One recording as a file that is written while things happen: its time, its documents, its styles."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError, StageError, choices
from rf_exp.robots import DEFAULT, Robot
from rf_exp.texts.markdown import Markdown
from rf_exp.transforms import Matrix
from rf_exp.types import CONTROL_DT_S, FINGERS, CameraModel
from rf_exp.viz.elements import Mesh, expect, lines, mesh3d, pinhole, placed
from rf_exp.viz.figures import coordination_size_px
from rf_exp.viz.layout import (
    AGENT_COLOURS,
    JOINT_COLOURS,
    OBJECT,
    Panels,
    Rgb,
    agent_colour,
    blueprint,
    camera_entity,
)

rr.set_strict_mode(True)  # else rerun drops what it cannot take, with a warning

FLUSH_S = 5.0  # rows are written in batches; few large ones load faster than many small
FAINT = 110  # alpha of commanded curves, next to measured ones


class Stream:
    """The file of a recording, and what is common to all that is logged in it. See `Recorder`."""

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
                raise choices("moving camera", name, cameras)
        self._moving = frozenset(moving)
        self._posed = {*meshes, *map(camera_entity, moving)}  # entities that a step may place
        self._documents: dict[str, list[str]] = {}  # entity -> texts, newest first
        self._curved: dict[str, int] = {}  # group -> curves in it so far
        self._styled: set[str] = set()  # entities that have their style
        self._closed = False

        # One application per task and kind: the viewer keeps one layout for each, and tasks differ in agents.
        self._stream = _opened(f"rf_exp {task}{'' if panels == 'plan' else f' {panels}'}")
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
            expect(f"poses[{entity!r}]", pose, (4, 4))
        expect("qpos", qpos, (self._agents, self._dof + FINGERS))
        if action is not None:
            expect("action", action, (self._agents, self._dof + 1))
        for name, picture in pictures.items():
            if name not in self._cameras:
                raise choices("camera in pictures", name, self._cameras)
            shape = (self._cameras[name].height_px, self._cameras[name].width_px, 3)
            expect(f"pictures[{name!r}]", picture, shape, np.dtype(np.uint8))

    def _set_time(self, step: int) -> None:
        self._step = step
        self._stream.set_time("step", sequence=step)
        self._stream.set_time("time", duration=step * CONTROL_DT_S)

    def _log(self, entity: str, *values: rr.AsComponents, static: bool = False) -> None:
        if self._closed:
            raise StageError(f"the recording {self._path} is closed; nothing more can be recorded in it")
        first, *rest = values
        self._stream.log(entity, first, *rest, static=static)

    def _document(self, entity: str, title: str, markdown: Markdown) -> None:
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
            self._log(camera_entity(name), pinhole(camera), static=True)
            if name not in self._moving:
                expect(f"world_from_camera of camera {name!r}", camera.world_from_camera, (4, 4))
                self._log(camera_entity(name), placed(camera.world_from_camera), static=True)
        for entity, mesh in meshes.items():
            self._log(entity, mesh3d(entity, mesh, self._colour(entity.split("/")[1])), static=True)
        for agent, robot in enumerate(self._robots, start=1):
            colour, name, colours = agent_colour(agent), f"agent {agent}", JOINT_COLOURS[: robot.dof]
            names = [f"q{joint}" for joint in range(1, robot.dof + 1)]
            self._log(f"joints/agent{agent}/measured", lines(colours, names, 2), static=True)
            faint = [(*colour, FAINT) for colour in colours]
            # One name for all targets: one line in the legend.
            self._log(f"joints/agent{agent}/target", lines(faint, ["target"] * robot.dof, 1), static=True)
            self._log(f"gripper/agent{agent}/measured", lines([colour], [name], 2), static=True)
            target = lines([(*colour, FAINT)], [f"{name} target"], 1)
            self._log(f"gripper/agent{agent}/target", target, static=True)

    def _curve(self, group: str, name: str, value: float) -> None:
        """A number now, in a group of curves that are told apart by their colours."""
        entity = f"{group}/{rr.escape_entity_path_part(name)}"
        if entity not in self._styled:
            self._styled.add(entity)
            index = self._curved[group] = self._curved.get(group, -1) + 1
            colour = AGENT_COLOURS[index % len(AGENT_COLOURS)]
            self._log(entity, lines([colour], [name], 2), static=True)
        self._log(entity, rr.Scalars(value))


def _opened(application: str) -> rr.RecordingStream:
    batches = rr.ChunkBatcherConfig.DEFAULT()
    batches.flush_tick = FLUSH_S
    stream = rr.RecordingStream(application, batcher_config=batches)
    stream.set_log_time_enabled(False)  # the machine's clock is no part of an episode
    stream.set_log_tick_enabled(False)
    return stream
