"""Redrawing: renders demonstrations again, at the cost of the pictures alone.

Neither physics nor plans depend on the appearance of a scene, and states are stored: arms and objects are
put at their measured states of each step, and the cameras render. A copy samples anew the factors that
pictures alone show (cameras, sensors, appearance, light); the first copy is the original demonstration.

Arms can be displaced as well. In demonstrations a gripper that has arrived is always at its goal, so an
encoder trained on them alone takes the place where the own gripper is for the goal, once they are near each
other. Where grippers are displaced from their paths at random, only the scene tells the goal.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rf_exp import sim  # as a module, as most trainings redraw nothing and do not need ManiSkill
from rf_exp.artifacts import plain
from rf_exp.errors import ArgumentError
from rf_exp.policy import EMPTY_OPENING_M, displaced_steps
from rf_exp.progress import Progress
from rf_exp.robots import Arm
from rf_exp.stages.cell import artifact_lock, open_or_create
from rf_exp.store import JUDGED, Store
from rf_exp.tasks import PHYSICAL_KEYS, Task, Variation, scene_certificate
from rf_exp.transforms import from_quaternion, inverse, quaternion
from rf_exp.types import DISPLACEMENT, Episode, Judged, fingers_of, gripper_of

# Rigidly carried: an object that moves by LEAST_MOTION_M while fingers are closed, and by less than
# MOST_SLIP_M in the TCP frame, after the steps in which they close.
CLOSING_STEPS, LEAST_MOTION_M, MOST_SLIP_M = 8, 0.02, 0.02


def redraw(source: Store, path: Path, task: Task, variation: Variation, copies: int) -> Path:
    """Writes the store `path` with `copies` of each episode of `source`, copies of one episode side by side.

    `task` is that of `source`. Continues where it stopped. Depth and segmentation are not kept. Raises
    ArgumentError for a task of other scenes, and for a variation that pictures do not show, or that would
    have moved something, StageError where `path` holds something else.
    """
    if copies < 2:
        raise ArgumentError(f"{copies} copies of each demonstration; expected 2 or more")
    current_scene = plain(task.identity)
    if (
        source.identity.get("scene", current_scene) != current_scene
    ):  # imported stores have none, and are refused below
        raise ArgumentError(
            f"{source.path} is of other scenes than the task has now; say with which variation it was "
            "generated, or generate again"
        )
    if moving := [
        name for name in PHYSICAL_KEYS if getattr(task.variation, name) != getattr(variation, name)
    ]:
        raise ArgumentError(
            f"variation {variation.name!r} has another {' and another '.join(moving)} than the demonstrations"
            "; that moves things, where pictures alone are drawn anew: generate with it"
        )
    if not variation.varies_visually:
        raise ArgumentError(f"variation {variation.name!r} shows nothing in pictures; expected one that does")
    task = replace(task, variation=variation)
    scene = {**source.identity["scene"], "variation": variation.identity}
    identity = plain({**source.identity, "scene": scene, "copies": copies})
    description = source.description and replace(source.description, depth=False, labels=())
    with artifact_lock(path), open_or_create(path, identity, source, task, description) as store:
        if missing := range(len(store), len(source) * copies):
            simulator = sim.Simulator(task, width_px=source.attrs["width"], height_px=source.attrs["height"])
            progress = Progress(f"redraw {path.name}", missing.stop, "episodes", missing.start)
            with simulator, progress:
                for number in missing:
                    index, copy = divmod(number, copies)
                    episode = replace(source.episode(index), extras={})
                    store.append(render_copy(simulator, episode, task, copy) if copy else episode)
                    progress.advance()
    return path


def render_copy(simulator: "sim.Simulator", episode: Episode, task: Task, copy: int) -> Episode:
    """The episode with the pictures of copy number `copy`."""
    simulator.reset(episode.seed, copy)
    images = {name: np.empty_like(pictures) for name, pictures in episode.images.items()}
    for step, qpos in enumerate(episode.qpos):
        simulator.place(qpos, {name: rows[step] for name, rows in episode.poses.items()})
        for name, picture in simulator.images(images).items():
            images[name][step] = picture
    copy_certificate = {**scene_certificate(task, episode.seed, copy), "copy": copy}
    return replace(episode, images=images, certificate={**episode.certificate, **copy_certificate})


def displace(source: Store, path: Path, task: Task, std_rad: float) -> Path:
    """Writes the store `path` with some steps of each episode of `source`, in which arms are displaced.

    They are the `displaced_steps` of an episode; every joint is displaced at random with this standard
    deviation, in each step anew, and a carried object with its gripper. Appearance, cameras and sensors are
    those of a second copy. The rows are states to render, and no motion. Continues where it stopped.
    Raises as `redraw`.
    """
    identity = plain({**source.identity, "displaced_rad": std_rad})
    description = source.description and replace(source.description, depth=False, labels=())
    with artifact_lock(path), open_or_create(path, identity, source, task, description) as store:
        if missing := range(len(store), len(source)):
            simulator = sim.Simulator(task, width_px=source.attrs["width"], height_px=source.attrs["height"])
            progress = Progress(f"displace {path.name}", missing.stop, "episodes", missing.start)
            with simulator, progress:
                for index in missing:
                    episode = replace(source.episode(index), extras={})
                    store.append(displaced_copy(simulator, episode, task, std_rad))
                    progress.advance()
    return path


def displaced_copy(simulator: "sim.Simulator", episode: Episode, task: Task, std_rad: float) -> Episode:
    """The displaced steps of an episode, see `displace`."""
    steps, rng = displaced_steps(len(episode.qpos)), np.random.default_rng([episode.seed, DISPLACEMENT])
    arms = task.in_scene(episode.seed).arms
    world_from_object = {name: from_quaternion(rows) for name, rows in episode.poses.items()}
    carried = {agent: _carried(episode, agent, arm, world_from_object) for agent, arm in arms.items()}
    carriers = {name: np.sum([masks[name] for masks in carried.values()], axis=0) for name in episode.poses}
    holding = gripper_of(episode.action) < 0
    holding &= fingers_of(episode.qpos).sum(axis=2) > EMPTY_OPENING_M
    qpos, poses = episode.qpos[steps], {name: rows[steps] for name, rows in episode.poses.items()}
    images = {name: each[steps] for name, each in episode.images.items()}
    judged = episode.judged
    simulator.reset(episode.seed, 1)
    for row, step in enumerate(steps):
        for agent, arm in arms.items():
            offset_rad = std_rad * rng.standard_normal(arm.robot.dof)
            names = [name for name, mask in carried[agent].items() if mask[step]]
            # Not one of two grippers on an object, nor one on something that it does not carry.
            if any(carriers[name][step] > 1 for name in names) or (holding[step, agent - 1] and not names):
                continue
            joints = qpos[row, agent - 1, : arm.robot.dof]
            world_from_tcp = arm.tcp(joints.astype(float))
            joints += offset_rad
            motion = arm.tcp(joints.astype(float)) @ inverse(world_from_tcp)
            for name in names:
                pose = motion @ world_from_object[name][step]
                poses[name][row] = *pose[:3, 3], *quaternion(pose)
        simulator.place(qpos[row], {name: rows[row] for name, rows in poses.items()})
        for name, picture in simulator.images(images).items():
            images[name][row] = picture
    return replace(
        episode,
        qpos=qpos,
        qvel=np.zeros_like(qpos),
        action=episode.action[steps],
        images=images,
        certificate={**episode.certificate, **scene_certificate(task, episode.seed, 1)},
        executed=None if episode.executed is None else episode.executed[steps],
        poses=poses,
        subgoal=None if episode.subgoal is None else episode.subgoal[steps],
        judged=judged and Judged(judged.names, *(getattr(judged, name)[steps] for name in JUDGED)),
    )


def _carried(
    episode: Episode, agent: int, arm: Arm, world_from_object: Mapping[str, NDArray[np.float64]]
) -> dict[str, NDArray[np.bool_]]:
    """Object -> mask (T,) of the steps in which this agent carries it, rigidly, between closed fingers."""
    closed = gripper_of(episode.action)[:, agent - 1] < 0
    bounds = np.flatnonzero(np.diff(closed, prepend=False, append=False)).reshape(-1, 2)
    tcp_from_world = np.linalg.inv(arm.tcp(episode.qpos[:, agent - 1].astype(float)))
    masks = {name: np.zeros(len(closed), bool) for name in world_from_object}
    for start, end in bounds[bounds[:, 1] > bounds[:, 0] + CLOSING_STEPS]:
        span = slice(start + CLOSING_STEPS, end)
        for name, poses in world_from_object.items():
            moved_m, slipped_m = (
                np.ptp(each[span, :3, 3], axis=0).max() for each in (poses, tcp_from_world @ poses)
            )
            masks[name][start:end] |= moved_m >= LEAST_MOTION_M and slipped_m < MOST_SLIP_M
    return masks
