"""Redrawing: renders demonstrations again under other appearances, at the cost of the pictures alone.

Neither physics nor plans depend on the appearance of a scene, and states are stored: arms and objects are
put at their measured states of each step, and the cameras render. A copy samples anew the factors that
pictures alone show (cameras, sensors, appearance, light); the first copy is the original demonstration.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rf_exp import sim  # as a module, as most trainings redraw nothing and do not need ManiSkill
from rf_exp.artifacts import plain
from rf_exp.errors import ArgumentError
from rf_exp.progress import Progress
from rf_exp.stages.cell import artifact_lock, open_or_create
from rf_exp.store import Store
from rf_exp.tasks import PHYSICAL_KEYS, Task, Variation, scene_certificate
from rf_exp.types import Episode


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
