"""Survey of single trajectories of ManiSkill's RecordEpisode. The layout: `rf_exp.data.recordepisode`.

Row t is measured before action t. Rows up to the first success are imported, and no more than the shortest
array has: merged files may lack frames.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.data.importing import hdf5
from rf_exp.data.importing.poses import CameraPose, base_pose, camera_pose
from rf_exp.data.importing.source import LARGEST_PX, MOST_AGENTS, checked_commands, finite_float32, require
from rf_exp.data.recordepisode import ROOT_SIZE, SUCCESS
from rf_exp.data.release import COMMAND_SIZE, QPOS_SIZE
from rf_exp.store import POSE
from rf_exp.transforms import Matrix

SCENERY = ("ground", "table-workspace")  # bodies that are not objects of a task
PARAMETERS = {"extrinsic_cv": (3, 4), "cam2world_gl": (4, 4), "intrinsic_cv": (3, 3)}

_ARM = re.compile(r"panda(?:_wristcam)?(?:(?:-agent)?-(\d{1,2}))?")  # a single arm may have no number


@dataclass
class Trajectory:
    """One trajectory, as far as it is imported: the first T rows of its h5py datasets."""

    name: str
    commands: NDArray[np.float32]  # (T, N, 8)
    seed: int | None
    rejection: str = ""  # reason why it cannot be imported
    shortfall: str = ""  # which array is shorter than the commands, and its length
    rows_after_success: int = 0  # rows after its first success
    ends_in_success: bool = False  # whether its last row is known to be its first success
    executed: NDArray[np.float32] | None = None  # (T, N, 8) where it is kept beside the intended actions
    joints: list[tuple[Any, Any]] = field(default_factory=list)  # (qpos, qvel) of each arm; may be empty
    states: list[Any] = field(default_factory=list)  # state of each arm, ends with both; may be empty
    rgb: dict[str, Any] = field(default_factory=dict)  # name of a camera in the file -> pictures
    depth: dict[str, Any] = field(default_factory=dict)
    bodies: dict[str, Any] = field(default_factory=dict)  # object -> its states
    bases: list[Matrix] = field(default_factory=list)  # world_from_base (4, 4) of each arm; empty: not known
    camera_poses: dict[str, CameraPose] = field(default_factory=dict)  # name in the file -> pose if known


class Survey:
    """Surveys the trajectories of a file, without reading pictures."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self.notes: dict[str, None] = {}  # what was left out of some trajectory or is unknown

    def survey_trajectory(self, name: str, entry: Mapping[str, Any]) -> Trajectory:
        """Surveys one trajectory; `entry` is its entry in the JSON file. Raises StageError."""
        path, group = self._path, hdf5.subgroup(self._path, self._file, name)
        require(group is not None, path, f"{name} is missing")
        arms = self._arms(group)
        command_datasets = [
            hdf5.required_array(path, group, f"actions{arm}", (COMMAND_SIZE,), "f") for arm in arms
        ]
        trajectory = Trajectory(name, np.zeros((0, len(arms), COMMAND_SIZE), np.float32), _seed(entry))
        self._bodies(group, len(arms), trajectory)
        pairs = [self._joints(group, arm) for arm in arms]
        trajectory.joints = [pair for pair in pairs if pair is not None] if None not in pairs else []
        self._cameras(group, trajectory)
        success = hdf5.optional_array(path, group, SUCCESS, (), "biu")
        executed = []
        if hdf5.member(path, group, "executed") is not None:
            executed = [
                hdf5.required_array(path, group, f"executed{arm}", (COMMAND_SIZE,), "f") for arm in arms
            ]
        arrays = [
            *command_datasets,
            *executed,
            *trajectory.states,
            *(dataset for pair in trajectory.joints for dataset in pair),
        ]
        arrays += [*trajectory.rgb.values(), *trajectory.depth.values(), *trajectory.bodies.values()]
        arrays += [] if success is None else [success]
        shortest = min(arrays, key=len)
        steps, longest = len(shortest), max(map(len, command_datasets))
        if steps < longest:
            trajectory.shortfall = f"{shortest.name} has {steps} rows, {longest} expected"
        if not steps:
            trajectory.rejection = "it has no rows"
            return trajectory
        if success is not None:
            success_rows = np.flatnonzero(hdf5.read_rows(path, success, 0, steps))
            trajectory.ends_in_success, trajectory.rejection = (
                bool(len(success_rows)),
                "" if len(success_rows) else "it never succeeds",
            )
            steps_to_success = int(success_rows[0]) + 1 if len(success_rows) else steps
            trajectory.rows_after_success, steps = steps - steps_to_success, steps_to_success
        elif isinstance(succeeded := entry.get(SUCCESS), bool):
            trajectory.ends_in_success, trajectory.rejection = (
                succeeded and not trajectory.shortfall,
                "" if succeeded else "it never succeeds",
            )
        if trajectory.rejection:
            return trajectory
        trajectory.commands = self._read(command_datasets, steps)
        trajectory.executed = self._read(executed, steps) if executed else None
        self._poses(group, trajectory, steps)
        return trajectory

    def _arms(self, group: Any) -> list[str]:
        """Path suffix of each arm, such as `/panda-0`; a single empty one where actions have no group."""
        actions = hdf5.member(self._path, group, "actions")
        require(actions is not None, self._path, f"{group.name} has no actions")
        if not hdf5.is_group(actions):
            return [""]
        names = hdf5.member_names(self._path, actions)
        numbered = {int(match[1] or 0): match[0] for match in map(_ARM.fullmatch, names) if match}
        is_valid = 0 < len(names) <= MOST_AGENTS and sorted(numbered) == [*range(len(names))]
        names_text = ", ".join(names[:8]) or "nobody"
        require(is_valid, self._path, f"{actions.name} is of {names_text}; expected panda-0, panda-1, ...")
        return [f"/{numbered[k]}" for k in range(len(names))]

    def _read(self, datasets: Sequence[Any], steps: int) -> NDArray[np.float32]:
        rows = [hdf5.read_rows(self._path, dataset, 0, steps) for dataset in datasets]
        return checked_commands(self._path, datasets[0].name, np.stack(rows, axis=1))

    def _joints(self, group: Any, arm: str) -> tuple[Any, Any] | None:
        """Datasets of the measured joints of an arm and of their velocities; None where one is missing."""
        names = (f"obs/agent{arm}/{what}" for what in ("qpos", "qvel"))
        qpos, qvel = (hdf5.optional_array(self._path, group, name, (QPOS_SIZE,), "f") for name in names)
        return None if qpos is None or qvel is None else (qpos, qvel)

    def _bodies(self, group: Any, agents: int, trajectory: Trajectory) -> None:
        """Adds the states of objects, and those of arms where all are recorded."""
        arms: dict[int, Any] = {}
        for kind in ("actors", "articulations"):
            bodies = hdf5.subgroup(self._path, group, f"env_states/{kind}")
            for name in hdf5.member_names(self._path, bodies) if bodies is not None else ():
                states = hdf5.required_array(self._path, bodies, name, (None,), "f")
                size = states.shape[1]
                require(
                    size >= ROOT_SIZE,
                    self._path,
                    f"{states.name} has {size} columns; expected {ROOT_SIZE} or more",
                )
                if (match := _ARM.fullmatch(name)) is None:
                    trajectory.bodies |= {} if name in SCENERY else {name: states}
                elif size == ROOT_SIZE + 2 * QPOS_SIZE:
                    arms[int(match[1] or 0)] = states
        if sorted(arms) == [*range(agents)]:
            trajectory.states = [arms[k] for k in range(agents)]

    def _cameras(self, group: Any, trajectory: Trajectory) -> None:
        """Adds pictures and depth."""
        cameras = hdf5.subgroup(self._path, group, "obs/sensor_data")
        for name in hdf5.member_names(self._path, cameras) if cameras is not None else ():
            rgb = hdf5.optional_array(self._path, cameras, f"{name}/rgb", (None, None, 3), "u")
            if rgb is None:
                self.notes[f"camera {name} was left out: it has no rgb"] = None
                continue
            height, width = rgb.shape[1:3]
            is_valid = rgb.dtype == np.uint8 and 0 < height <= LARGEST_PX and 0 < width <= LARGEST_PX
            expected = f"uint8 of 1 to {LARGEST_PX} px"
            require(is_valid, self._path, f"{rgb.name} holds {rgb.dtype} {rgb.shape}; expected {expected}")
            trajectory.rgb[name] = rgb
            depth = hdf5.optional_array(self._path, cameras, f"{name}/depth", (height, width, 1), "iu")
            if depth is not None and depth.dtype.itemsize == 2:  # mm
                trajectory.depth[name] = depth

    def _poses(self, group: Any, trajectory: Trajectory, steps: int) -> None:
        """Adds the base poses where all are static and upright, and the poses of static cameras."""
        path = self._path
        roots = [
            finite_float32(path, dataset.name, hdf5.read_rows(path, dataset, 0, steps))
            for dataset in trajectory.states
        ]
        bases = [base_pose(root[:, : len(POSE)].astype(float)) for root in roots]
        if any(base is None for base in bases):
            self.notes["where arms stand is not known: a base moves, or does not stand upright"] = None
        else:
            trajectory.bases = [base for base in bases if base is not None]
        for name, rgb in trajectory.rgb.items():
            datasets = {
                key: hdf5.optional_array(path, group, f"obs/sensor_param/{name}/{key}", shape, "f")
                for key, shape in PARAMETERS.items()
            }
            parameters = {
                key: finite_float32(
                    path, dataset.name, hdf5.read_rows(path, dataset, 0, min(steps, len(dataset)))
                ).astype(float)
                for key, dataset in datasets.items()
                if dataset is not None
            }
            pose = camera_pose(parameters, rgb.shape[1:3])
            if isinstance(pose, str):
                self.notes[f"where camera {name} stands is not known: {pose}"] = None
            else:
                trajectory.camera_poses[name] = pose


def _seed(entry: Mapping[str, Any]) -> int | None:
    """Scene seed of a trajectory, or None; environments that run in parallel record a list of one."""
    seed = entry.get("episode_seed")
    seed = seed[0] if isinstance(seed, list) and len(seed) == 1 else seed
    return seed if type(seed) is int and 0 <= seed < 2**63 else None
