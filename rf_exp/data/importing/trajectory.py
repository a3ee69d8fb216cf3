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
from rf_exp.data.importing.source import LARGEST_PX, MOST_AGENTS, commands, expect, numbers
from rf_exp.data.importing.standing import Stand, base_of, stand_of
from rf_exp.data.recordepisode import ROOT, SUCCESS
from rf_exp.data.release import COMMAND, MEASURED
from rf_exp.store import POSE
from rf_exp.transforms import Matrix

SCENERY = ("ground", "table-workspace")  # bodies that are not objects of a task
PARAMETERS = {"extrinsic_cv": (3, 4), "cam2world_gl": (4, 4), "intrinsic_cv": (3, 3)}

_ARM = re.compile(r"panda(?:_wristcam)?(?:(?:-agent)?-(\d{1,2}))?")  # a single arm may have no number


@dataclass
class Trajectory:
    """One trajectory, as far as it is imported: the first T rows of its h5py datasets."""

    name: str
    told: NDArray[np.float32]  # (T, N, 8) commands
    seed: int | None
    why_not: str = ""  # reason why it cannot be imported
    lacks: str = ""  # the array that is shorter than the commands
    surplus: int = 0  # rows after its first success
    judged: bool = False  # whether its last row is known to be its first success
    executed: NDArray[np.float32] | None = None  # (T, N, 8) where it is kept beside the intended actions
    joints: list[tuple[Any, Any]] = field(default_factory=list)  # (qpos, qvel) of each arm; may be empty
    states: list[Any] = field(default_factory=list)  # state of each arm, ends with both; may be empty
    rgb: dict[str, Any] = field(default_factory=dict)  # name of a camera in the file -> pictures
    depth: dict[str, Any] = field(default_factory=dict)
    bodies: dict[str, Any] = field(default_factory=dict)  # object -> its states
    bases: list[Matrix] = field(default_factory=list)  # world_from_base (4, 4) of each arm; empty: not known
    stands: dict[str, Stand] = field(default_factory=dict)  # name of a camera in the file -> pose if known


class Survey:
    """Surveys the trajectories of a file, without reading pictures."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self.notes: dict[str, None] = {}  # what was left out of some trajectory or is unknown

    def of(self, name: str, entry: Mapping[str, Any]) -> Trajectory:
        """Surveys one trajectory; `entry` is its entry in the JSON file. Raises StageError."""
        path, group = self._path, hdf5.subgroup(self._path, self._file, name)
        expect(group is not None, path, f"{name} is missing")
        arms = self._arms(group)
        told = [hdf5.needed(path, group, f"actions{arm}", (COMMAND,), "f") for arm in arms]
        one = Trajectory(name, np.zeros((0, len(arms), COMMAND), np.float32), _seed(entry))
        self._bodies(group, len(arms), one)
        pairs = [self._joints(group, arm) for arm in arms]
        one.joints = [pair for pair in pairs if pair is not None] if None not in pairs else []
        self._seen(group, one)
        success = hdf5.array(path, group, SUCCESS, (), "biu")
        executed = []
        if hdf5.member(path, group, "executed") is not None:
            executed = [hdf5.needed(path, group, f"executed{arm}", (COMMAND,), "f") for arm in arms]
        arrays = [*told, *executed, *one.states, *(each for pair in one.joints for each in pair)]
        arrays += [*one.rgb.values(), *one.depth.values(), *one.bodies.values()]
        arrays += [] if success is None else [success]
        shortest = min(arrays, key=len)
        steps, longest = len(shortest), max(map(len, told))
        if steps < longest:
            one.lacks = f"{shortest.name} has {steps} rows, {longest} expected"
        if not steps:
            one.why_not = "it has no rows"
            return one
        if success is not None:
            reached = np.flatnonzero(hdf5.rows(path, success, 0, steps))
            one.judged, one.why_not = bool(len(reached)), "" if len(reached) else "it never succeeds"
            end = int(reached[0]) + 1 if len(reached) else steps
            one.surplus, steps = steps - end, end
        elif isinstance(said := entry.get(SUCCESS), bool):
            one.judged, one.why_not = said and not one.lacks, "" if said else "it never succeeds"
        if one.why_not:
            return one
        one.told = self._read(told, steps)
        one.executed = self._read(executed, steps) if executed else None
        self._standing(group, one, steps)
        return one

    def _arms(self, group: Any) -> list[str]:
        """Path suffix of each arm, such as `/panda-0`; a single empty one where actions have no group."""
        found = hdf5.member(self._path, group, "actions")
        expect(found is not None, self._path, f"{group.name} has no actions")
        if not hdf5.is_group(found):
            return [""]
        names = hdf5.names(self._path, found)
        numbered = {int(arm[1] or 0): arm[0] for arm in map(_ARM.fullmatch, names) if arm}
        fits = 0 < len(names) <= MOST_AGENTS and sorted(numbered) == [*range(len(names))]
        whose = ", ".join(names[:8]) or "nobody"
        expect(fits, self._path, f"{found.name} is of {whose}; expected panda-0, panda-1, ...")
        return [f"/{numbered[k]}" for k in range(len(names))]

    def _read(self, datasets: Sequence[Any], steps: int) -> NDArray[np.float32]:
        rows = [hdf5.rows(self._path, each, 0, steps) for each in datasets]
        return commands(self._path, datasets[0].name, np.stack(rows, axis=1))

    def _joints(self, group: Any, arm: str) -> tuple[Any, Any] | None:
        """Datasets of the measured joints of an arm and of their velocities; None where one is missing."""
        names = (f"obs/agent{arm}/{what}" for what in ("qpos", "qvel"))
        qpos, qvel = (hdf5.array(self._path, group, name, (MEASURED,), "f") for name in names)
        return None if qpos is None or qvel is None else (qpos, qvel)

    def _bodies(self, group: Any, agents: int, one: Trajectory) -> None:
        """Adds the states of objects, and those of arms where all are recorded."""
        arms: dict[int, Any] = {}
        for kind in ("actors", "articulations"):
            bodies = hdf5.subgroup(self._path, group, f"env_states/{kind}")
            for name in hdf5.names(self._path, bodies) if bodies is not None else ():
                found = hdf5.needed(self._path, bodies, name, (None,), "f")
                size = found.shape[1]
                expect(size >= ROOT, self._path, f"{found.name} has {size} columns; expected {ROOT} or more")
                if (arm := _ARM.fullmatch(name)) is None:
                    one.bodies |= {} if name in SCENERY else {name: found}
                elif size == ROOT + 2 * MEASURED:
                    arms[int(arm[1] or 0)] = found
        if sorted(arms) == [*range(agents)]:
            one.states = [arms[k] for k in range(agents)]

    def _seen(self, group: Any, one: Trajectory) -> None:
        """Adds pictures and depth."""
        cameras = hdf5.subgroup(self._path, group, "obs/sensor_data")
        for name in hdf5.names(self._path, cameras) if cameras is not None else ():
            rgb = hdf5.array(self._path, cameras, f"{name}/rgb", (None, None, 3), "u")
            if rgb is None:
                self.notes[f"camera {name} was left out: it has no rgb"] = None
                continue
            high, wide = rgb.shape[1:3]
            fits = rgb.dtype == np.uint8 and 0 < high <= LARGEST_PX and 0 < wide <= LARGEST_PX
            possible = f"uint8 of 1 to {LARGEST_PX} px"
            expect(fits, self._path, f"{rgb.name} holds {rgb.dtype} {rgb.shape}; expected {possible}")
            one.rgb[name] = rgb
            depth = hdf5.array(self._path, cameras, f"{name}/depth", (high, wide, 1), "iu")
            if depth is not None and depth.dtype.itemsize == 2:  # mm
                one.depth[name] = depth

    def _standing(self, group: Any, one: Trajectory, steps: int) -> None:
        """Adds the base poses where all are static and upright, and the poses of static cameras."""
        path = self._path
        roots = [numbers(path, each.name, hdf5.rows(path, each, 0, steps)) for each in one.states]
        bases = [base_of(root[:, : len(POSE)].astype(float)) for root in roots]
        if any(base is None for base in bases):
            self.notes["where arms stand is not known: a base moves, or does not stand upright"] = None
        else:
            one.bases = [base for base in bases if base is not None]
        for name, rgb in one.rgb.items():
            found = {
                key: hdf5.array(path, group, f"obs/sensor_param/{name}/{key}", shape, "f")
                for key, shape in PARAMETERS.items()
            }
            read = {
                key: numbers(path, each.name, hdf5.rows(path, each, 0, min(steps, len(each)))).astype(float)
                for key, each in found.items()
                if each is not None
            }
            stand = stand_of(read, rgb.shape[1:3])
            if isinstance(stand, str):
                self.notes[f"where camera {name} stands is not known: {stand}"] = None
            else:
                one.stands[name] = stand


def _seed(entry: Mapping[str, Any]) -> int | None:
    """Scene seed of a trajectory, or None; environments that run in parallel record a list of one."""
    found = entry.get("episode_seed")
    found = found[0] if isinstance(found, list) and len(found) == 1 else found
    return found if type(found) is int and 0 <= found < 2**63 else None
