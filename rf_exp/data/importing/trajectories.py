"""Import of files of ManiSkill's RecordEpisode, the raw demonstrations of the authors' release.

Poses of objects, arms and cameras are in `env_states` and `sensor_param`. Cameras and objects that some
trajectory lacks are left out of all: a store has the same arrays for each episode.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.artifacts import plain, read_json
from rf_exp.data.formats import success_flags
from rf_exp.data.importing import hdf5
from rf_exp.data.importing.poses import ABSOLUTE_TOLERANCE, CameraPose, camera_spec, planar_pose
from rf_exp.data.importing.source import (
    Contents,
    Source,
    action_and_executed,
    assumed_qpos,
    bounds_note,
    checked_name,
    counted_subgoals,
    digest_commands,
    finite_float32,
    listed,
    require,
    scene_seeds,
    sort_cameras,
)
from rf_exp.data.importing.trajectory import Survey, Trajectory
from rf_exp.data.recordepisode import CONTROL_MODE, ROOT_SIZE, SUCCESS
from rf_exp.data.release import QPOS_SIZE, task_of, within_limits
from rf_exp.store import POSE, Description
from rf_exp.tasks import camera_from_release
from rf_exp.types import CONTROL_HZ, UNITS, CameraModel, Episode, Judged

FORM = "trajectories of ManiSkill's RecordEpisode"

_TRAJECTORY = re.compile(r"traj_(\d{1,9})")


class Trajectories(Source):
    """Source of the trajectories of a file, but for those known to fail."""

    def __init__(self, path: Path, file: Any, task: str, metadata: Mapping[str, Any]) -> None:
        """`metadata` is the content of the JSON file, empty without one. Raises StageError."""
        self._path, self._file, self._notes = path, file, list[str]()
        entries, survey = _entries(path, metadata), Survey(path, file)
        names = hdf5.member_names(path, file)
        numbered = sorted((int(match[1]), match[0]) for match in map(_TRAJECTORY.fullmatch, names) if match)
        surveyed = [survey.survey_trajectory(name, entries.pop(number, {})) for number, name in numbered]
        self._trajectories = [trajectory for trajectory in surveyed if not trajectory.rejection]
        left_out = [
            f"{trajectory.name} ({trajectory.rejection})" for trajectory in surveyed if trajectory.rejection
        ]
        count = len(surveyed)
        require(
            bool(self._trajectories),
            path,
            f"none of its {count} trajectories can be taken: {listed(left_out)}",
        )
        agents = sorted({trajectory.commands.shape[1] for trajectory in self._trajectories})
        require(len(agents) == 1, path, f"its trajectories have commands of {agents} arms")
        shortened = [
            f"{trajectory.name} ({trajectory.shortfall})"
            for trajectory in self._trajectories
            if trajectory.shortfall
        ]
        if others := [name for name in names if not _TRAJECTORY.fullmatch(name)]:
            self._notes.append(f"what is no trajectory was left out: {listed(others)}")
        if left_out:
            self._notes.append(f"{len(left_out)} of {count} trajectories were left out: {listed(left_out)}")
        if shortened:
            self._notes.append(
                f"{len(shortened)} of {count} trajectories have shorter arrays: {listed(shortened)}"
            )
        if surplus_rows := sum(trajectory.rows_after_success for trajectory in self._trajectories):
            self._notes.append(f"{surplus_rows} rows after the first success were left out")
        if entries:
            self._notes.append(f"{path.name} lacks {len(entries)} trajectories of which its JSON file tells")
        self._cameras = self._choose_cameras(agents[0])  # camera -> its name in the file
        self._objects = self._names_in_all("object", [trajectory.bodies for trajectory in self._trajectories])
        self._notes += survey.notes
        self.contents = self._contents(task, agents[0])

    def close(self) -> None:
        self._file.close()

    def episode(self, index: int) -> Episode:
        contents, trajectory = self.contents, self._trajectories[index]
        steps = len(trajectory.commands)
        qpos, qvel = self._joints(trajectory, steps)
        action, executed = action_and_executed(trajectory.commands, trajectory.executed, contents.disturbed)
        subgoal, texts = counted_subgoals(trajectory.commands)
        certificate: dict[str, Any] = {"imported": trajectory.name, "subgoals": texts}
        if contents.scene and not _same_calibration(trajectory, self._trajectories[0]):
            certificate["calibration"] = self._calibration(trajectory)
        description = contents.description
        return Episode(
            task=contents.task,
            seed=contents.seeds[index],
            qpos=qpos,
            qvel=qvel,
            action=action,
            executed=executed,
            images={
                camera: self._rows(trajectory.rgb[name], steps) for camera, name in self._cameras.items()
            },
            poses={
                name: self._read(trajectory.bodies[name], steps)[:, : len(POSE)] for name in self._objects
            },
            subgoal=subgoal,
            certificate=certificate,
            judged=_judged(steps) if description else None,
            extras=self._depth(trajectory, steps) if description and description.depth else {},
        )

    def _rows(self, dataset: Any, steps: int) -> NDArray[Any]:
        return hdf5.read_rows(self._path, dataset, 0, steps)

    def _read(self, dataset: Any, steps: int) -> NDArray[np.float32]:
        return finite_float32(self._path, dataset.name, self._rows(dataset, steps))

    def _joints(self, trajectory: Trajectory, steps: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """qpos and qvel (T, N, 9): observed, else from the simulator's state, else as commanded."""
        if trajectory.joints:
            qpos, qvel = zip(*trajectory.joints, strict=True)
            measured = [[self._read(dataset, steps) for dataset in datasets] for datasets in (qpos, qvel)]
            return np.stack(measured[0], axis=1), np.stack(measured[1], axis=1)
        if trajectory.states:
            states = np.stack([self._read(arm_states, steps) for arm_states in trajectory.states], axis=1)
            return states[..., ROOT_SIZE : ROOT_SIZE + QPOS_SIZE], states[..., ROOT_SIZE + QPOS_SIZE :]
        assumed = assumed_qpos(trajectory.commands)
        return assumed, np.zeros_like(assumed)

    def _depth(self, trajectory: Trajectory, steps: int) -> dict[str, NDArray[np.uint16]]:
        pictures = {
            camera: self._rows(trajectory.depth[name], steps) for camera, name in self._cameras.items()
        }
        return {
            f"depth_{camera}": np.maximum(depth, 0).astype(np.uint16)[..., 0]
            for camera, depth in pictures.items()
        }

    def _names_in_all(self, kind: str, groups: Sequence[Mapping[str, Any]]) -> list[str]:
        """Names that all trajectories have and that an array name may contain."""
        names = sorted(set[str]().union(*groups))
        common = [
            name for name in names if all(name in group for group in groups) and hdf5.NAME.fullmatch(name)
        ]
        if left_out := [name for name in names if name not in common]:
            why = "not every trajectory has it, or its name cannot be kept"
            self._notes += [f"{kind} {name} was left out: {why}" for name in left_out]
        return common

    def _choose_cameras(self, agents: int) -> dict[str, str]:
        """Camera -> its name in the file; all have the size of the first agent's camera, or the first's."""
        cameras: dict[str, str] = {}
        for name in self._names_in_all("camera", [trajectory.rgb for trajectory in self._trajectories]):
            camera = camera_from_release(name, agents)
            if (first_name := cameras.setdefault(camera, name)) != name:
                self._notes.append(f"camera {name} was left out: {first_name} is camera {camera} already")
        order = sort_cameras(cameras, agents)
        sizes = {
            name: {trajectory.rgb[name].shape[1:3] for trajectory in self._trajectories}
            for name in cameras.values()
        }
        size = sizes[cameras["agent1" if "agent1" in cameras else order[0]]] if cameras else set()
        for name in [name for name in cameras.values() if sizes[name] != size or len(size) > 1]:
            self._notes.append(f"camera {name} was left out: its pictures are {sorted(sizes[name])} px")
        return {
            camera: cameras[camera] for camera in order if sizes[cameras[camera]] == size and len(size) == 1
        }

    def _contents(self, task: str, agents: int) -> Contents:
        trajectories = self._trajectories
        seeds, seeds_known = scene_seeds([trajectory.seed for trajectory in trajectories])
        commands = [trajectory.commands for trajectory in trajectories]
        bases_known, success_known = (
            all(trajectory.bases for trajectory in trajectories),
            all(trajectory.ends_in_success for trajectory in trajectories),
        )
        names = self._cameras.values()
        camera_poses = {
            camera: trajectories[0].camera_poses[name]
            for camera, name in self._cameras.items()
            if all(name in trajectory.camera_poses for trajectory in trajectories)
        }
        measured = all(trajectory.joints or trajectory.states for trajectory in trajectories)
        missing = {
            "pictures": not names,
            "poses": not self._objects,
            "calibration": not bases_known or len(camera_poses) < len(names),
            "measured joints": not measured,
            "velocities": not measured,
            "success": not success_known,
            "seeds": not seeds_known,
            "subgoals": True,
            "certificates": True,
        }
        height, width = next((trajectories[0].rgb[name].shape[1:3] for name in names), (0, 0))
        depth_present = [name in trajectory.depth for trajectory in trajectories for name in names]
        depth = bool(depth_present) and all(depth_present)
        if any(depth_present) and not (depth and success_known):
            why = "not every camera of every trajectory has it" if success_known else "success is not known"
            self._notes.append(f"depth was left out: {why}")
        scene = {
            "robots": [planar_pose(base) for base in trajectories[0].bases],
            "cameras": {camera: plain(camera_spec(pose).identity) for camera, pose in camera_poses.items()},
        }
        return Contents(
            form=FORM,
            task=task,
            agents=agents,
            episodes=[trajectory.name for trajectory in trajectories],
            seeds=seeds,
            steps=[*map(len, commands)],
            cameras=[*self._cameras],
            size_px=(height, width),
            objects=self._objects,
            commands_digest=digest_commands(commands, seeds),
            disturbed=any(
                trajectory.executed is not None or within_limits(trajectory.commands)[1]
                for trajectory in trajectories
            ),
            scene=scene if bases_known else {},
            description=_description(task, trajectories[0], camera_poses, (width, height), depth)
            if success_known
            else None,
            missing=[item for item, is_missing in missing.items() if is_missing],
            notes=[*self._notes, *bounds_note(commands)],
        )

    def _calibration(self, trajectory: Trajectory) -> dict[str, Any]:
        """Calibration of a trajectory, as in a certificate."""
        cameras = {
            camera: {"fov_deg": pose.fov_deg, "parent_from_camera": plain(pose.world_from_camera)}
            for camera, name in self._cameras.items()
            if (pose := trajectory.camera_poses.get(name)) is not None
        }
        return {"world_from_base": [plain(base) for base in trajectory.bases], "cameras": cameras}


def _description(
    task: str,
    first: Trajectory,
    camera_poses: Mapping[str, CameraPose],
    size_px: tuple[int, int],
    depth: bool,
) -> Description:
    """Description of a store whose trajectories all end in success; `size_px`: width, height of pictures."""
    models = {
        camera: CameraModel(*size_px, float(np.deg2rad(pose.fov_deg)), pose.world_from_camera)
        for camera, pose in camera_poses.items()
    }
    return Description(
        language={
            "title": task.replace("_", " ").title(),
            "description": f"Demonstrations of {task}, imported.",
            "target_condition": "Their environment said when it was done.",
        },
        conditions=(SUCCESS,),
        world_from_base=[plain(base) for base in first.bases],
        camera_models={
            camera: {
                "intrinsics": plain(model.intrinsics),
                "world_from_camera": plain(model.world_from_camera),
            }
            for camera, model in models.items()
        },
        depth=depth,
    )


def _same_calibration(first: Trajectory, second: Trajectory) -> bool:
    """Whether arms and cameras have the same poses in two trajectories."""
    pairs = list(zip(first.bases, second.bases, strict=True))
    for name in first.camera_poses.keys() & second.camera_poses.keys():
        a, b = first.camera_poses[name], second.camera_poses[name]
        if abs(a.fov_deg - b.fov_deg) > ABSOLUTE_TOLERANCE:
            return False
        pairs.append((a.world_from_camera, b.world_from_camera))
    return all(np.abs(a - b).max() <= ABSOLUTE_TOLERANCE for a, b in pairs)


def _judged(steps: int) -> Judged:
    """Conditions of an episode that succeeds with its last action."""
    holds = success_flags(steps)[:, None]
    value = holds.astype(np.float32)
    unit = np.full(holds.shape, UNITS.index(""), np.uint8)
    return Judged((SUCCESS,), value, np.ones_like(value), unit, holds)


def read(path: Path, file: Any, task: str | None) -> Trajectories:
    """Source of an open file, with the JSON file beside it if any. Raises StageError, ArgumentError."""
    json_path, metadata = path.with_suffix(".json"), {}
    if json_path.is_file():
        metadata = read_json(json_path, "restore it from a copy, or import the .h5 from a folder without it")
    require(isinstance(metadata, dict), path, f"{json_path.name} holds no object")
    info = _as_object(metadata.get("env_info"))
    kwargs = _as_object(info.get("env_kwargs"))
    _expect_joint_targets(path, kwargs.get("control_mode"))
    rate = _as_object(kwargs.get("sim_config")).get("control_freq", CONTROL_HZ)
    require(rate == CONTROL_HZ, path, f"its control rate is {rate} Hz; a store is of {CONTROL_HZ}")
    names = info.get("env_id"), path.parent.parent.name, path.parent.name, path.stem
    task_name = next(filter(None, (task_of(str(name)) for name in names)), "")
    return Trajectories(path, file, checked_name(path, task or task_name), metadata)


def _as_object(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _entries(path: Path, metadata: Mapping[str, Any]) -> dict[int, Mapping[str, Any]]:
    """Trajectory number -> its entry in the JSON file."""
    episodes = metadata.get("episodes", [])
    require(isinstance(episodes, list), path, "episodes of its JSON file is no list")
    entries: dict[int, Mapping[str, Any]] = {}
    for entry in episodes:
        number: Any = _as_object(entry).get("episode_id")
        require(type(number) is int, path, "an episode of its JSON file has no episode_id")
        require(number not in entries, path, f"its JSON file has two episodes {number}")
        entries[number] = entry
        _expect_joint_targets(path, entry.get("control_mode"))
    return entries


def _expect_joint_targets(path: Path, mode: object) -> None:
    """Raises StageError for another declared control mode; undeclared ones are judged by joint limits."""
    for value in mode.values() if isinstance(mode, dict) else [mode]:
        require(
            value in (None, CONTROL_MODE), path, f"its control mode is {value!r}; expected {CONTROL_MODE}"
        )
