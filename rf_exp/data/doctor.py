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

MIN_MOTION_RAD, MIN_MOTION_M = 1e-4, 1e-4  # smaller ranges over a whole store are no motion
STILL_RAD = 0.02  # largest joint range in an episode that counts as still
# Per control step of 50 ms: twice the top speed of a Panda; the speed after half a second of free fall.
JUMP_RAD, JUMP_M = 0.25, 0.25
# Largest median distance from a command to the next measured joints; above: not of this arm.
MAX_TRACKING_ERROR_RAD = 0.2
MAX_JERK_RATIO, MIN_JERK_RAD = 4.0, 2e-3  # times the median of all episodes; smaller jerks are not reported
MIN_EPISODES = 4  # episodes needed for a meaningful median
MIN_LENGTH_RATIO = 0.25  # of the median length
EXAMINED_EPISODES = 16  # episodes, evenly spaced, whose first, middle and last pictures are examined
# Bounds of the mean, and of the standard deviation, in levels of 255.
DARK, BRIGHT, MIN_CONTRAST = 8.0, 247.0, 1.0
MIN_CAMERA_DIFFERENCE = 1.0  # smallest mean difference of two cameras, in levels of 255
# As a part of the reference's brightness; in standard errors of the difference.
MIN_BRIGHTNESS_CHANGE, MIN_SIGMAS = 0.04, 4.0

Frames = Mapping[str, NDArray[np.uint8]]  # camera -> (E, 3, H, W, 3) of the examined episodes


@dataclass(frozen=True)
class Problem:
    """One finding: place in the store, problem and remedy."""

    place: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.place}: {self.problem}; {self.remedy}"


REGENERATE = "generate it again, or leave it out"
CHECK_SOURCE = "look at where these data are from: indices, units or a channel are wrong there"
UPDATE_DRIVER = "update the Vulkan driver (python -m rf_exp.doctor names it) and draw them again"


def find_problems(store: Store, reference: Store | None = None) -> Iterator[Problem]:
    """All findings about a store; with a reference, its pictures are compared with those of the same cameras.

    Raises ArgumentError for a reference that shares no camera with it.
    """
    if not len(store):
        yield Problem("the store", "it holds no episodes", "generate or import some")
        return
    for check in (_not_finite, _constant_values, _untracked_commands, _jumps, _unusual_episodes):
        yield from check(store)
    frames = _frames(store)
    yield from _wrong_pictures(frames, _examined_episodes(store))
    if reference is not None:
        yield from _compare_brightness(store.path.name, frames, _frames(reference), reference.path.name)


def _arrays(store: Store) -> dict[str, NDArray[np.float32]]:
    """Numeric arrays by name: (T, N, ...) for arms, (T, 7) for objects."""
    arms = {"qpos": store.qpos, "qvel": store.qvel, "action": store.action}
    arms |= {"executed": store.executed} if store.disturbed else {}
    return {**arms, **{f"pose_{name}": poses for name, poses in store.poses.items()}}


def _location(store: Store, row: int) -> str:
    """Episode, seed and step of a row, in words."""
    index = int(np.searchsorted(store.episode_ends, row, "right"))
    first = int(store.episode_ends[index - 1]) if index else 0
    return f"episode {index} (seed {store.seeds[index]}), step {row - first}"


def _joint_name(store: Store, agent: int, joint: int) -> str:
    """A joint in words; agent and joint are 0-based."""
    return f"agent {agent + 1}, {joint_names(store.attrs, agent + 1)[joint]}"


def _arm_joints(values: NDArray[np.float32], gripper_size: int) -> NDArray[np.float64]:
    """Arm joints without the gripper (T, N, J); NaN and infinity become 0, `_not_finite` reports them."""
    return np.nan_to_num(values[..., : values.shape[-1] - gripper_size].astype(float), posinf=0.0, neginf=0.0)


def _not_finite(store: Store) -> Iterator[Problem]:
    for name, values in _arrays(store).items():
        rows = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if len(rows):
            problem = f"{name} is not finite in {len(rows)} steps, this the first"
            yield Problem(_location(store, int(rows[0])), problem, f"no policy learns from NaN: {REGENERATE}")


def _constant_values(store: Store) -> Iterator[Problem]:
    """Values that are constant over all steps of all episodes."""
    commands, measured = (np.nan_to_num(array) for array in (store.action, store.qpos))
    for name, values, gripper_size in (("qpos", measured, FINGERS), ("action", commands, 1)):
        for agent, joint in np.argwhere(np.ptp(_arm_joints(values, gripper_size), axis=0) < MIN_MOTION_RAD):
            if not (joint_name := _joint_name(store, agent, joint)).partition(", ")[2].startswith("unused"):
                yield Problem(joint_name, f"{name} never moves in {store.steps} steps", CHECK_SOURCE)
    command_ranges, finger_ranges = (
        np.ptp(commands[..., -1], axis=0),
        np.ptp(measured[..., -FINGERS:], axis=0).max(axis=1),
    )
    for agent in np.flatnonzero((command_ranges > 1) & (finger_ranges < MIN_MOTION_M)):
        yield Problem(
            f"agent {agent + 1}", "its gripper is commanded to move, but its fingers never do", CHECK_SOURCE
        )
    if store.poses and all(np.ptp(poses, axis=0).max() < MIN_MOTION_M for poses in store.poses.values()):
        yield Problem(", ".join(store.poses), "no object ever moves or changes its place", CHECK_SOURCE)


def _untracked_commands(store: Store) -> Iterator[Problem]:
    """Commands that the arms do not follow."""
    last_rows = store.episode_ends[:-1] - 1
    errors = np.abs(_arm_joints(store.executed, 1)[:-1] - _arm_joints(store.qpos, FINGERS)[1:])
    errors = np.delete(errors, last_rows, axis=0)
    if not len(errors):
        return
    for agent, median in enumerate(np.median(errors, axis=0)):
        if (untracked := median > MAX_TRACKING_ERROR_RAD).any():
            worst_joint = _joint_name(store, agent, int(median.argmax()))
            problem = f"half of the time {untracked.sum()} of its joints are far from their commands"
            yield Problem(
                f"agent {agent + 1}",
                f"{problem}, {worst_joint} by more than {median.max():.2f} rad",
                CHECK_SOURCE,
            )


def _jumps(store: Store) -> Iterator[Problem]:
    """Impossibly fast changes within an episode."""
    starts = store.episode_ends[:-1]
    for name, values in _arrays(store).items():
        if name == "qvel":
            continue
        is_object = name.startswith("pose_")
        positions = (
            np.nan_to_num(values[:, :3])
            if is_object
            else _arm_joints(values, FINGERS if name == "qpos" else 1)
        )
        steps = np.abs(np.diff(positions, axis=0)).reshape(len(positions) - 1, -1)
        if is_object:
            steps = np.linalg.norm(steps, axis=1, keepdims=True)
        steps[starts - 1] = 0
        bound, unit = (JUMP_M, "m") if is_object else (JUMP_RAD, "rad")
        rows = np.flatnonzero((steps > bound).any(axis=1))
        if len(rows):
            row = int(rows[0])
            dimension = int(steps[row].argmax())
            joint_name = (
                "" if is_object else f" of {_joint_name(store, *divmod(dimension, positions.shape[-1]))}"
            )
            distance = f"{steps[row].max():.2f} {unit} in a control step, the first of {len(rows)} jumps"
            problem = f"{name}{joint_name} jumps by {distance}"
            yield Problem(_location(store, row + 1), problem, REGENERATE)


def _unusual_episodes(store: Store) -> Iterator[Problem]:
    """Episodes unlike the others: still, short, jerky, or a duplicate."""
    motions = [_arm_joints(motion, FINGERS) for motion in store.by_episode(store.qpos)]
    lengths = np.array([len(motion) for motion in motions])
    third_differences = [np.diff(motion, 3, axis=0) for motion in motions]
    jerks = np.array([np.sqrt(np.mean(motion**2)) if motion.size else 0.0 for motion in third_differences])
    median_jerk = np.median(jerks)
    first_by_motion: dict[bytes, int] = {}
    for index, motion in enumerate(motions):
        place = f"episode {index} (seed {store.seeds[index]})"
        if np.ptp(motion, axis=0).max() < STILL_RAD:
            yield Problem(place, f"no arm moves in its {len(motion)} steps", REGENERATE)
        if len(motions) >= MIN_EPISODES and len(motion) < MIN_LENGTH_RATIO * np.median(lengths):
            lengths_text = f"{len(motion)} steps, where {np.median(lengths):.0f} are usual"
            yield Problem(place, f"it has {lengths_text}", f"was it cut short? {REGENERATE}")
        if len(motions) >= MIN_EPISODES and jerks[index] > max(MAX_JERK_RATIO * median_jerk, MIN_JERK_RAD):
            problem = f"its arms jerk {jerks[index] / max(median_jerk, 1e-9):.0f} times as much as is usual"
            yield Problem(
                place, problem, f"look at it (python -m rf_exp.data export, rerun), or {REGENERATE}"
            )
        first = first_by_motion.setdefault(motion.tobytes(), index)
        if first != index and "copies" not in store.identity:
            yield Problem(
                place, f"it is a duplicate of episode {first}", "leave it out: training would count it twice"
            )


def _examined_episodes(store: Store) -> NDArray[np.int64]:
    """Indices of the episodes whose pictures are examined."""
    return np.unique(np.linspace(0, len(store) - 1, EXAMINED_EPISODES).round().astype(np.int64))


def _frames(store: Store) -> Frames:
    """The pictures to examine."""
    firsts, lasts = np.append(0, store.episode_ends[:-1]), store.episode_ends - 1
    rows = np.stack([firsts, (firsts + lasts) // 2, lasts], axis=1)[_examined_episodes(store)]
    return {
        camera: np.stack([[np.asarray(pictures[int(row)]) for row in episode_rows] for episode_rows in rows])
        for camera, pictures in store.images.items()
    }


def _wrong_pictures(frames: Frames, episodes: NDArray[np.int64]) -> Iterator[Problem]:
    """Cameras that show nothing, are frozen, or show the same as another."""
    for camera, pictures in frames.items():
        place, level, spread = f"camera {camera}", pictures.mean(), pictures.std(axis=(2, 3)).max()
        if spread < MIN_CONTRAST:
            remedy = "draw them again: something stands before it, or it is off"
            yield Problem(place, "its pictures have one colour", remedy)
        elif not DARK < level < BRIGHT:
            shade = "black" if level < DARK else "white"
            problem = f"its pictures are {shade}: level {level:.0f} of 255 on average"
            yield Problem(place, problem, UPDATE_DRIVER)
        elif (frozen := (pictures == pictures[:, :1]).all(axis=(1, 2, 3, 4))).any():
            frozen_text = f"{frozen.sum()} of {len(frozen)} episodes that were examined"
            problem = f"its pictures never change in {frozen_text}, the first of them {episodes[frozen][0]}"
            yield Problem(place, problem, CHECK_SOURCE)
    for (name, first), (other_name, second) in combinations(frames.items(), 2):
        if np.abs(first.astype(np.int16) - second).mean() < MIN_CAMERA_DIFFERENCE:
            yield Problem(f"cameras {name} and {other_name}", "they show the same", CHECK_SOURCE)


def _compare_brightness(
    name: str, frames: Frames, reference_frames: Frames, reference: str
) -> Iterator[Problem]:
    """Cameras whose pictures are darker or brighter than those of a reference."""
    if not (shared := [camera for camera in frames if camera in reference_frames]):
        raise ArgumentError(
            f"{reference} has cameras {', '.join(reference_frames) or 'none'}, "
            f"{name} {', '.join(frames) or 'none'}; "
            "a reference has some of the same"
        )
    for camera in shared:
        levels = [
            camera_frames[camera].mean(axis=(1, 2, 3, 4)) for camera_frames in (frames, reference_frames)
        ]  # of each episode
        level, reference_level = (camera_frames.mean() for camera_frames in levels)
        # A single episode has no spread: a tenth of the reference's brightness is assumed.
        errors = [
            (camera_frames.std(ddof=1) if len(camera_frames) > 1 else 0.1 * reference_level) ** 2
            / len(camera_frames)
            for camera_frames in levels
        ]
        if abs(level - reference_level) > max(
            MIN_BRIGHTNESS_CHANGE * reference_level, MIN_SIGMAS * np.sqrt(sum(errors))
        ):
            direction = "darker" if level < reference_level else "brighter"
            change = abs(level / reference_level - 1)
            problem = f"its pictures are {change:.0%} {direction} than those of {reference}"
            yield Problem(f"camera {camera}", problem, f"unless lights differ on purpose, {UPDATE_DRIVER}")
