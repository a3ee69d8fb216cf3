"""Data doctor: finds data in an intact store that will harm training.

`validate` compares a store with what it declares; this looks for implausible demonstrations: joints that
never move, jumps, episodes in which nothing happens, cameras with wrong pictures. Each finding names the
place, the problem and the remedy. Bounds are far from the suite's own demonstrations, including those of all
robots and the disturbed ones.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rf_exp.errors import ArgumentError
from rf_exp.store import Store, joint_names
from rf_exp.types import FINGERS

MOVES_RAD, MOVES_M = 1e-4, 1e-4  # smaller ranges over a whole store are no motion
STILL_RAD = 0.02  # largest joint range in an episode that counts as still
# Per control step of 50 ms: twice the top speed of a Panda; the speed after half a second of free fall.
JUMP_RAD, JUMP_M = 0.25, 0.25
ASTRAY_RAD = 0.2  # largest median distance from a command to the next measured joints; above: not of this arm
JERK, LEAST_JERK_RAD = 4.0, 2e-3  # times the median of all episodes; smaller jerks are not reported
FEWEST = 4  # episodes needed for a meaningful median
SHORT = 0.25  # of the median length
LOOKED_AT = 16  # episodes, evenly spaced, whose first, middle and last pictures are examined
DARK, BRIGHT, PLAIN = 8.0, 247.0, 1.0  # bounds of the mean, and of the standard deviation, in levels of 255
ALIKE = 1.0  # smallest mean difference of two cameras, in levels of 255
DIFFERS, SURELY = 0.04, 4.0  # as a part of the reference's brightness; in standard errors of the difference

Frames = Mapping[str, NDArray[np.uint8]]  # camera -> (E, 3, H, W, 3) of the examined episodes


@dataclass(frozen=True)
class Harm:
    """One finding: place in the store, problem and remedy."""

    where: str
    what: str
    mend: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.mend}"


AGAIN = "generate it again, or leave it out"
FROM = "look at where these data are from: indices, units or a channel are wrong there"
DRIVER = "update the Vulkan driver (python -m rf_exp.doctor names it) and draw them again"


def harms(store: Store, reference: Store | None = None) -> Iterator[Harm]:
    """All findings about a store; with a reference, its pictures are compared with those of the same cameras.

    Raises ArgumentError for a reference that shares no camera with it.
    """
    if not len(store):
        yield Harm("the store", "it holds no episodes", "generate or import some")
        return
    for look in (_unknown, _dead, _astray, _jumps, _episodes):
        yield from look(store)
    frames = _frames(store)
    yield from _pictures(frames, _looked_at(store))
    if reference is not None:
        yield from _beside(store.path.name, frames, _frames(reference), reference.path.name)


def _arrays(store: Store) -> dict[str, NDArray[np.float32]]:
    """Numeric arrays by name: (T, N, ...) for arms, (T, 7) for objects."""
    arms = {"qpos": store.qpos, "qvel": store.qvel, "action": store.action}
    arms |= {"executed": store.executed} if store.disturbed else {}
    return {**arms, **{f"pose_{name}": poses for name, poses in store.poses.items()}}


def _place(store: Store, row: int) -> str:
    """Episode, seed and step of a row, in words."""
    index = int(np.searchsorted(store.episode_ends, row, "right"))
    first = int(store.episode_ends[index - 1]) if index else 0
    return f"episode {index} (seed {store.seeds[index]}), step {row - first}"


def _joint(store: Store, agent: int, joint: int) -> str:
    """A joint in words; agent and joint are 0-based."""
    return f"agent {agent + 1}, {joint_names(store.attrs, agent + 1)[joint]}"


def _arm(values: NDArray[np.float32], hand: int) -> NDArray[np.float64]:
    """Arm joints without the gripper (T, N, J); NaN and infinity become 0, `_unknown` reports them."""
    return np.nan_to_num(values[..., : values.shape[-1] - hand].astype(float), posinf=0.0, neginf=0.0)


def _unknown(store: Store) -> Iterator[Harm]:
    for name, values in _arrays(store).items():
        wrong = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if len(wrong):
            what = f"{name} is not finite in {len(wrong)} steps, this the first"
            yield Harm(_place(store, int(wrong[0])), what, f"no policy learns from NaN: {AGAIN}")


def _dead(store: Store) -> Iterator[Harm]:
    """Values that are constant over all steps of all episodes."""
    told, measured = (np.nan_to_num(each) for each in (store.action, store.qpos))
    for name, values, hand in (("qpos", measured, FINGERS), ("action", told, 1)):
        for agent, joint in np.argwhere(np.ptp(_arm(values, hand), axis=0) < MOVES_RAD):
            if not (which := _joint(store, agent, joint)).partition(", ")[2].startswith("unused"):
                yield Harm(which, f"{name} never moves in {store.steps} steps", FROM)
    commanded, opened = np.ptp(told[..., -1], axis=0), np.ptp(measured[..., -FINGERS:], axis=0).max(axis=1)
    for agent in np.flatnonzero((commanded > 1) & (opened < MOVES_M)):
        yield Harm(f"agent {agent + 1}", "its gripper is told to move, and its fingers never do", FROM)
    if store.poses and all(np.ptp(poses, axis=0).max() < MOVES_M for poses in store.poses.values()):
        yield Harm(", ".join(store.poses), "no thing ever moves, nor lies elsewhere", FROM)


def _astray(store: Store) -> Iterator[Harm]:
    """Commands that the arms do not follow."""
    last = store.episode_ends[:-1] - 1
    apart = np.abs(_arm(store.executed, 1)[:-1] - _arm(store.qpos, FINGERS)[1:])
    apart = np.delete(apart, last, axis=0)
    if not len(apart):
        return
    for agent, median in enumerate(np.median(apart, axis=0)):
        if (astray := median > ASTRAY_RAD).any():
            worst = _joint(store, agent, int(median.argmax()))
            what = f"half of the time {astray.sum()} of its joints are far from where they were told to go"
            yield Harm(f"agent {agent + 1}", f"{what}, {worst} by more than {median.max():.2f} rad", FROM)


def _jumps(store: Store) -> Iterator[Harm]:
    """Impossibly fast changes within an episode."""
    begins = store.episode_ends[:-1]
    for name, values in _arrays(store).items():
        if name == "qvel":
            continue
        thing = name.startswith("pose_")
        moved = np.nan_to_num(values[:, :3]) if thing else _arm(values, FINGERS if name == "qpos" else 1)
        steps = np.abs(np.diff(moved, axis=0)).reshape(len(moved) - 1, -1)
        if thing:
            steps = np.linalg.norm(steps, axis=1, keepdims=True)
        steps[begins - 1] = 0
        bound, unit = (JUMP_M, "m") if thing else (JUMP_RAD, "rad")
        rows = np.flatnonzero((steps > bound).any(axis=1))
        if len(rows):
            row = int(rows[0])
            dimension = int(steps[row].argmax())
            which = "" if thing else f" of {_joint(store, *divmod(dimension, moved.shape[-1]))}"
            far = f"{steps[row].max():.2f} {unit} in a control step, the first of {len(rows)} jumps"
            what = f"{name}{which} jumps by {far}"
            yield Harm(_place(store, row + 1), what, AGAIN)


def _episodes(store: Store) -> Iterator[Harm]:
    """Episodes unlike the others: still, short, jerky, or a duplicate."""
    moved = [_arm(each, FINGERS) for each in store.by_episode(store.qpos)]
    lengths = np.array([len(each) for each in moved])
    third = [np.diff(each, 3, axis=0) for each in moved]
    rough = np.array([np.sqrt(np.mean(each**2)) if each.size else 0.0 for each in third])
    usual = np.median(rough)
    seen: dict[bytes, int] = {}
    for index, motion in enumerate(moved):
        where = f"episode {index} (seed {store.seeds[index]})"
        if np.ptp(motion, axis=0).max() < STILL_RAD:
            yield Harm(where, f"no arm moves in its {len(motion)} steps", AGAIN)
        if len(moved) >= FEWEST and len(motion) < SHORT * np.median(lengths):
            usually = f"{len(motion)} steps, where {np.median(lengths):.0f} are usual"
            yield Harm(where, f"it has {usually}", f"was it cut short? {AGAIN}")
        if len(moved) >= FEWEST and rough[index] > max(JERK * usual, LEAST_JERK_RAD):
            what = f"its arms jerk {rough[index] / max(usual, 1e-9):.0f} times as much as is usual"
            yield Harm(where, what, f"look at it (python -m rf_exp.data export, rerun), or {AGAIN}")
        first = seen.setdefault(motion.tobytes(), index)
        if first != index and "copies" not in store.identity:
            yield Harm(where, f"it is episode {first} once more", "leave it out: who learns counts it twice")


def _looked_at(store: Store) -> NDArray[np.int64]:
    """Indices of the episodes whose pictures are examined."""
    return np.unique(np.linspace(0, len(store) - 1, LOOKED_AT).round().astype(np.int64))


def _frames(store: Store) -> Frames:
    """The pictures to examine."""
    firsts, lasts = np.append(0, store.episode_ends[:-1]), store.episode_ends - 1
    rows = np.stack([firsts, (firsts + lasts) // 2, lasts], axis=1)[_looked_at(store)]
    return {
        camera: np.stack([[np.asarray(pictures[int(row)]) for row in of] for of in rows])
        for camera, pictures in store.images.items()
    }


def _pictures(frames: Frames, episodes: NDArray[np.int64]) -> Iterator[Harm]:
    """Cameras that show nothing, are frozen, or show the same as another."""
    for camera, pictures in frames.items():
        where, level, spread = f"camera {camera}", pictures.mean(), pictures.std(axis=(2, 3)).max()
        if spread < PLAIN:
            mend = "draw them again: something stands before it, or it is off"
            yield Harm(where, "its pictures have one colour", mend)
        elif not DARK < level < BRIGHT:
            shade = "black" if level < DARK else "white"
            what = f"its pictures are {shade}: level {level:.0f} of 255 on average"
            yield Harm(where, what, DRIVER)
        elif (frozen := (pictures == pictures[:, :1]).all(axis=(1, 2, 3, 4))).any():
            some = f"{frozen.sum()} of {len(frozen)} episodes that were looked at"
            what = f"its pictures never change in {some}, the first of them {episodes[frozen][0]}"
            yield Harm(where, what, FROM)
    for (one, first), (other, second) in combinations(frames.items(), 2):
        if np.abs(first.astype(np.int16) - second).mean() < ALIKE:
            yield Harm(f"cameras {one} and {other}", "they show the same", FROM)


def _beside(name: str, frames: Frames, others: Frames, reference: str) -> Iterator[Harm]:
    """Cameras whose pictures are darker or brighter than those of a reference."""
    if not (shared := [camera for camera in frames if camera in others]):
        raise ArgumentError(
            f"{reference} has cameras {', '.join(others) or 'none'}, {name} {', '.join(frames) or 'none'}; "
            "a reference has some of the same"
        )
    for camera in shared:
        levels = [each[camera].mean(axis=(1, 2, 3, 4)) for each in (frames, others)]  # of each episode
        here, there = (each.mean() for each in levels)
        # A single episode has no spread: a tenth of the reference's brightness is assumed.
        errors = [(each.std(ddof=1) if len(each) > 1 else 0.1 * there) ** 2 / len(each) for each in levels]
        if abs(here - there) > max(DIFFERS * there, SURELY * np.sqrt(sum(errors))):
            how = "darker" if here < there else "brighter"
            what = f"its pictures are {abs(here / there - 1):.0%} {how} than those of {reference}"
            yield Harm(f"camera {camera}", what, f"unless lights differ on purpose, {DRIVER}")
