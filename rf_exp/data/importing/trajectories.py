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
from rf_exp.data.importing import hdf5
from rf_exp.data.importing.source import (
    Contents,
    Source,
    assumed_qpos,
    bounds_note,
    checked_name,
    counted_subgoals,
    digest_of,
    expect,
    kept,
    listed,
    numbers,
    ordered,
    own_seeds,
)
from rf_exp.data.importing.standing import SAME, Stand, planar_of, spec_of
from rf_exp.data.importing.trajectory import Survey, Trajectory
from rf_exp.data.recordepisode import CONTROL_MODE, ROOT, SUCCESS
from rf_exp.data.release import MEASURED, task_of, within_limits
from rf_exp.data.target import last
from rf_exp.store import POSE, Description
from rf_exp.tasks import camera_of
from rf_exp.types import CONTROL_HZ, UNITS, CameraModel, Episode, Judged

FORM = "trajectories of ManiSkill's RecordEpisode"

_TRAJECTORY = re.compile(r"traj_(\d{1,9})")


class Trajectories(Source):
    """Source of the trajectories of a file, but for those known to fail."""

    def __init__(self, path: Path, file: Any, task: str, said: Mapping[str, Any]) -> None:
        """`said` is the content of the JSON file, empty without one. Raises StageError."""
        self._path, self._file, self._notes = path, file, list[str]()
        entries, survey = _entries(path, said), Survey(path, file)
        names = hdf5.names(path, file)
        numbered = sorted((int(each[1]), each[0]) for each in map(_TRAJECTORY.fullmatch, names) if each)
        surveyed = [survey.of(name, entries.pop(number, {})) for number, name in numbered]
        self._found = [each for each in surveyed if not each.why_not]
        left_out = [f"{each.name} ({each.why_not})" for each in surveyed if each.why_not]
        count = len(surveyed)
        expect(bool(self._found), path, f"none of its {count} trajectories can be taken: {listed(left_out)}")
        agents = sorted({each.told.shape[1] for each in self._found})
        expect(len(agents) == 1, path, f"its trajectories have commands of {agents} arms")
        early = [f"{each.name} ({each.lacks})" for each in self._found if each.lacks]
        if others := [name for name in names if not _TRAJECTORY.fullmatch(name)]:
            self._notes.append(f"what is no trajectory was left out: {listed(others)}")
        if left_out:
            self._notes.append(f"{len(left_out)} of {count} trajectories were left out: {listed(left_out)}")
        if early:
            self._notes.append(f"{len(early)} of {count} trajectories have shorter arrays: {listed(early)}")
        if surplus := sum(each.surplus for each in self._found):
            self._notes.append(f"{surplus} rows after the first success were left out")
        if entries:
            self._notes.append(f"{path.name} lacks {len(entries)} trajectories of which its JSON file tells")
        self._cameras = self._named_cameras(agents[0])  # camera -> its name in the file
        self._objects = self._in_all("object", [each.bodies for each in self._found])
        self._notes += survey.notes
        self.contents = self._contents(task, agents[0])

    def close(self) -> None:
        self._file.close()

    def episode(self, index: int) -> Episode:
        said, one = self.contents, self._found[index]
        steps = len(one.told)
        qpos, qvel = self._joints(one, steps)
        action, executed = kept(one.told, one.executed, said.disturbed)
        subgoal, texts = counted_subgoals(one.told)
        certificate: dict[str, Any] = {"imported": one.name, "subgoals": texts}
        if said.scene and not _alike(one, self._found[0]):
            certificate["calibration"] = self._calibration(one)
        described = said.description
        return Episode(
            task=said.task,
            seed=said.seeds[index],
            qpos=qpos,
            qvel=qvel,
            action=action,
            executed=executed,
            images={camera: self._rows(one.rgb[name], steps) for camera, name in self._cameras.items()},
            poses={name: self._read(one.bodies[name], steps)[:, : len(POSE)] for name in self._objects},
            subgoal=subgoal,
            certificate=certificate,
            judged=_judged(steps) if described else None,
            extras=self._depth(one, steps) if described and described.depth else {},
        )

    def _rows(self, dataset: Any, steps: int) -> NDArray[Any]:
        return hdf5.rows(self._path, dataset, 0, steps)

    def _read(self, dataset: Any, steps: int) -> NDArray[np.float32]:
        return numbers(self._path, dataset.name, self._rows(dataset, steps))

    def _joints(self, one: Trajectory, steps: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """qpos and qvel (T, N, 9): observed, else from the simulator's state, else as commanded."""
        if one.joints:
            qpos, qvel = zip(*one.joints, strict=True)
            measured = [[self._read(each, steps) for each in datasets] for datasets in (qpos, qvel)]
            return np.stack(measured[0], axis=1), np.stack(measured[1], axis=1)
        if one.states:
            states = np.stack([self._read(each, steps) for each in one.states], axis=1)
            return states[..., ROOT : ROOT + MEASURED], states[..., ROOT + MEASURED :]
        assumed = assumed_qpos(one.told)
        return assumed, np.zeros_like(assumed)

    def _depth(self, one: Trajectory, steps: int) -> dict[str, NDArray[np.uint16]]:
        found = {camera: self._rows(one.depth[name], steps) for camera, name in self._cameras.items()}
        return {f"depth_{camera}": np.maximum(d, 0).astype(np.uint16)[..., 0] for camera, d in found.items()}

    def _in_all(self, what: str, each: Sequence[Mapping[str, Any]]) -> list[str]:
        """Names that all trajectories have and that an array name may contain."""
        names = sorted(set[str]().union(*each))
        found = [name for name in names if all(name in one for one in each) and hdf5.NAME.fullmatch(name)]
        if lost := [name for name in names if name not in found]:
            why = "not every trajectory has it, or its name cannot be kept"
            self._notes += [f"{what} {name} was left out: {why}" for name in lost]
        return found

    def _named_cameras(self, agents: int) -> dict[str, str]:
        """Camera -> its name in the file; all have the size of the first agent's camera, or the first's."""
        found: dict[str, str] = {}
        for name in self._in_all("camera", [each.rgb for each in self._found]):
            camera = camera_of(name, agents)
            if (other := found.setdefault(camera, name)) != name:
                self._notes.append(f"camera {name} was left out: {other} is camera {camera} already")
        ranked = ordered(found, agents)
        sizes = {name: {each.rgb[name].shape[1:3] for each in self._found} for name in found.values()}
        size = sizes[found["agent1" if "agent1" in found else ranked[0]]] if found else set()
        for name in [name for name in found.values() if sizes[name] != size or len(size) > 1]:
            self._notes.append(f"camera {name} was left out: its pictures are {sorted(sizes[name])} px")
        return {camera: found[camera] for camera in ranked if sizes[found[camera]] == size and len(size) == 1}

    def _contents(self, task: str, agents: int) -> Contents:
        found = self._found
        seeds, known = own_seeds([each.seed for each in found])
        told = [each.told for each in found]
        standing, judged = all(each.bases for each in found), all(each.judged for each in found)
        names = self._cameras.values()
        stands = {
            camera: found[0].stands[name]
            for camera, name in self._cameras.items()
            if all(name in each.stands for each in found)
        }
        measured = all(each.joints or each.states for each in found)
        missing = {
            "pictures": not names,
            "poses": not self._objects,
            "calibration": not standing or len(stands) < len(names),
            "measured joints": not measured,
            "velocities": not measured,
            "success": not judged,
            "seeds": not known,
            "subgoals": True,
            "certificates": True,
        }
        height, width = next((found[0].rgb[name].shape[1:3] for name in names), (0, 0))
        depths = [name in each.depth for each in found for name in names]
        depth = bool(depths) and all(depths)
        if any(depths) and not (depth and judged):
            why = "not every camera of every trajectory has it" if judged else "success is not known"
            self._notes.append(f"depth was left out: {why}")
        scene = {
            "robots": [planar_of(base) for base in found[0].bases],
            "cameras": {camera: plain(spec_of(stand).identity) for camera, stand in stands.items()},
        }
        return Contents(
            form=FORM,
            task=task,
            agents=agents,
            episodes=[each.name for each in found],
            seeds=seeds,
            steps=[*map(len, told)],
            cameras=[*self._cameras],
            size_px=(height, width),
            objects=self._objects,
            told=digest_of(told, seeds),
            disturbed=any(each.executed is not None or within_limits(each.told)[1] for each in found),
            scene=scene if standing else {},
            description=_description(task, found[0], stands, (width, height), depth) if judged else None,
            missing=[what for what, lacks in missing.items() if lacks],
            notes=[*self._notes, *bounds_note(told)],
        )

    def _calibration(self, one: Trajectory) -> dict[str, Any]:
        """Calibration of a trajectory, as in a certificate."""
        cameras = {
            camera: {"fov_deg": stand.fov_deg, "parent_from_camera": plain(stand.world_from_camera)}
            for camera, name in self._cameras.items()
            if (stand := one.stands.get(name)) is not None
        }
        return {"world_from_base": [plain(base) for base in one.bases], "cameras": cameras}


def _description(
    task: str, usual: Trajectory, stands: Mapping[str, Stand], size_px: tuple[int, int], depth: bool
) -> Description:
    """Description of a store whose trajectories all end in success; `size_px`: width, height of pictures."""
    models = {
        camera: CameraModel(*size_px, float(np.deg2rad(stand.fov_deg)), stand.world_from_camera)
        for camera, stand in stands.items()
    }
    return Description(
        language={
            "title": task.replace("_", " ").title(),
            "description": f"Demonstrations of {task}, imported.",
            "target_condition": "Their environment said when it was done.",
        },
        conditions=(SUCCESS,),
        world_from_base=[plain(base) for base in usual.bases],
        camera_models={
            camera: {"intrinsics": plain(each.intrinsics), "world_from_camera": plain(each.world_from_camera)}
            for camera, each in models.items()
        },
        depth=depth,
    )


def _alike(one: Trajectory, other: Trajectory) -> bool:
    """Whether arms and cameras have the same poses in two trajectories."""
    pairs = list(zip(one.bases, other.bases, strict=True))
    for name in one.stands.keys() & other.stands.keys():
        a, b = one.stands[name], other.stands[name]
        if abs(a.fov_deg - b.fov_deg) > SAME:
            return False
        pairs.append((a.world_from_camera, b.world_from_camera))
    return all(np.abs(a - b).max() <= SAME for a, b in pairs)


def _judged(steps: int) -> Judged:
    """Conditions of an episode that succeeds with its last action."""
    holds = last(steps)[:, None]
    value = holds.astype(np.float32)
    unit = np.full(holds.shape, UNITS.index(""), np.uint8)
    return Judged((SUCCESS,), value, np.ones_like(value), unit, holds)


def read(path: Path, file: Any, task: str | None) -> Trajectories:
    """Source of an open file, with the JSON file beside it if any. Raises StageError, ArgumentError."""
    beside, said = path.with_suffix(".json"), {}
    if beside.is_file():
        said = read_json(beside, "restore it from a copy, or import the .h5 from a folder without it")
    expect(isinstance(said, dict), path, f"{beside.name} holds no object")
    info = _object(said.get("env_info"))
    kwargs = _object(info.get("env_kwargs"))
    _expect_joint_targets(path, kwargs.get("control_mode"))
    rate = _object(kwargs.get("sim_config")).get("control_freq", CONTROL_HZ)
    expect(rate == CONTROL_HZ, path, f"its control rate is {rate} Hz; a store is of {CONTROL_HZ}")
    names = info.get("env_id"), path.parent.parent.name, path.parent.name, path.stem
    named = next(filter(None, (task_of(str(name)) for name in names)), "")
    return Trajectories(path, file, checked_name(path, task or named), said)


def _object(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _entries(path: Path, said: Mapping[str, Any]) -> dict[int, Mapping[str, Any]]:
    """Trajectory number -> its entry in the JSON file."""
    episodes = said.get("episodes", [])
    expect(isinstance(episodes, list), path, "episodes of its JSON file is no list")
    found: dict[int, Mapping[str, Any]] = {}
    for entry in episodes:
        number: Any = _object(entry).get("episode_id")
        expect(type(number) is int, path, "an episode of its JSON file has no episode_id")
        expect(number not in found, path, f"its JSON file has two episodes {number}")
        found[number] = entry
        _expect_joint_targets(path, entry.get("control_mode"))
    return found


def _expect_joint_targets(path: Path, mode: object) -> None:
    """Raises StageError for another declared control mode; undeclared ones are judged by joint limits."""
    for each in mode.values() if isinstance(mode, dict) else [mode]:
        expect(each in (None, CONTROL_MODE), path, f"its control mode is {each!r}; expected {CONTROL_MODE}")
