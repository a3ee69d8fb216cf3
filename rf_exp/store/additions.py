"""What an episode adds to a store, once it is known to fit."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rf_exp.artifacts import plain
from rf_exp.errors import StageError
from rf_exp.store.integrity import times_stored
from rf_exp.store.layout import JUDGED, layout
from rf_exp.store.reader import Reader
from rf_exp.types import CONTROL_HZ, Episode


def additions(store: Reader, episode: Episode) -> dict[str, NDArray[Any]]:
    """Array name -> the rows that the episode adds, in the order in which they have to be written.

    Raises StageError for an episode that does not fit the store.
    """
    label = f"episode of seed {episode.seed}"
    _require_fit(store, episode, label)
    rows = _data(store, episode)
    wanted = layout(store.attrs)
    for name, values in rows.items():
        shape, dtype = wanted[name]
        if values.shape != (len(episode.qpos), *shape) or values.dtype != np.dtype(dtype):
            raise StageError(
                f"{name} of the {label} is {values.dtype} {values.shape}; "
                f"expected {dtype} {(len(episode.qpos), *shape)}"
            )
        if dtype == "float32" and not np.isfinite(values).all():
            raise StageError(f"{name} of the {label} holds values that are not finite numbers")
    certificate = json.dumps(plain(episode.certificate), sort_keys=True)
    return rows | {
        "meta/seed": np.array([episode.seed], np.int64),
        "meta/certificate": np.array([certificate], np.dtypes.StringDType()),
        "meta/episode_ends": np.array([store.steps + len(episode.qpos)], np.int64),
    }


def _require_fit(store: Reader, episode: Episode, label: str) -> None:
    """Task, seed, cameras, objects and what was executed, all as the store has them."""
    if episode.task != (task := store.attrs["task"]) and isinstance(task, str):
        raise StageError(f"{label} is of task {episode.task!r}; {store.path} holds {task!r}")
    times = times_stored(store.identity)
    if np.count_nonzero(store.seeds == episode.seed) >= times:
        often = "once" if times == 1 else f"{times} times"
        raise StageError(f"{label} is stored already in {store.path}; every seed is stored {often}")
    if set(episode.images) != set(store.cameras):
        raise StageError(
            f"{label} has images of {sorted(episode.images)}; {store.path} expects {sorted(store.cameras)}"
        )
    if len(episode.qpos) == 0:
        raise StageError(f"{label} has no steps; expected at least one")
    if set(episode.poses) != set(store.objects):
        raise StageError(
            f"{label} has poses of {sorted(episode.poses)}; {store.path} expects {sorted(store.objects)}"
        )
    if set(episode.extras) != set(store.extra_names):
        raise StageError(
            f"{label} has depth and segmentation {sorted(episode.extras)}; "
            f"{store.path} expects {sorted(store.extra_names)}"
        )
    conditions = store.attrs.get("conditions")
    if conditions is not None and list(names := episode.judged.names if episode.judged else ()) != conditions:
        raise StageError(f"{label} is judged by {list(names)}; {store.path} expects {conditions}")
    if (episode.executed is not None) != store.disturbed:
        found, expected = ("no", "some") if store.disturbed else ("some", "no")
        raise StageError(f"{label} has {found} executed actions of its own; {store.path} expects {expected}")


def _data(store: Reader, episode: Episode) -> dict[str, NDArray[Any]]:
    """The rows of its steps."""
    data: dict[str, NDArray[Any]] = {
        "data/qpos": episode.qpos,
        "data/qvel": episode.qvel,
        "data/action": episode.action,
    }
    data |= {f"data/rgb_{camera}": episode.images[camera] for camera in store.cameras}
    data |= {f"data/pose_{name}": episode.poses[name] for name in store.objects}
    if episode.executed is not None:
        data["data/executed"] = episode.executed
    if "data/subgoal" in layout(store.attrs):
        unknown = np.full((len(episode.qpos), store.agents), -1, np.int16)
        data["data/subgoal"] = unknown if episode.subgoal is None else episode.subgoal
    if "data/time_s" in layout(store.attrs):
        assert episode.judged is not None  # it fits
        data["data/time_s"] = np.arange(len(episode.qpos)) / CONTROL_HZ
        data |= {f"data/condition_{name}": getattr(episode.judged, name) for name in JUDGED}
    return data | {f"data/{name}": taken for name, taken in episode.extras.items()}
