"""Export as a LeRobotDataset v3.0: Parquet, PNG or lossless video, JSON; written without lerobot itself.

`observation.state` (N * D) holds the measured joints of all agents, `action` (N * A) their targets, and
`observation.images.<camera>` the pictures. Extras, under names that no policy of lerobot takes as an input:
`object_poses` (K * 7), `executed` for disturbed demonstrations, `scene_seed`.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rf_exp.artifacts import plain, write_json
from rf_exp.data.formats import Advance, flatten_agents, import_library, success_flags
from rf_exp.store import POSE, Store, command_names, joint_names
from rf_exp.types import Episode
from rf_exp.viz import Film

PICTURES = ("video", "png")  # both keep every pixel
TAGS = ("LeRobot",)
EPISODES_PER_FILE, FILES_PER_CHUNK = 50, 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, VIDEO = f"data/{FILE}.parquet", f"videos/{{video_key}}/{FILE}.mp4"
EPISODES = f"meta/episodes/{FILE}.parquet"

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
STATS_PICTURES = 20  # pictures per episode and camera used for statistics

Stats = dict[str, NDArray[Any]]


def describe(pictures: str, agent: int | None = None, version: str = "v3.0") -> str:
    """Description of the exported folder, for all agents or for one."""
    owners, order_text = "all agents", ", one agent behind the other"
    if agent is not None:
        owners, order_text = f"agent {agent}", ""
    codecs = {
        "video": "lossless H.264 video (RGB, every pixel kept)",
        "png": "PNG within the Parquet files",
    }
    return (
        f"A LeRobotDataset {version}: `observation.state` holds the measured joints of {owners}, `action` "
        f"their joint\ntargets and gripper commands{order_text}; "
        f"`observation.images.<camera>` the pictures, as\n{codecs[pictures]}. `object_poses`, `executed` and "
        "`scene_seed` are\nextras that no policy of lerobot takes for an input."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance, agent: int | None = None) -> None:
    """Writes all episodes of a store to a folder, for all agents or for one; `pictures` is in `PICTURES`."""
    Writer(store, folder, pictures == "video", agent).write(advance)


class Writer:
    """Writer of one data set. Files and metadata are those of `VERSION`; subclasses write other versions."""

    VERSION = "v3.0"
    EPISODES_PER_FILE = EPISODES_PER_FILE
    DATA, VIDEO = DATA, VIDEO

    def __init__(self, store: Store, folder: Path, video: bool, agent: int | None = None) -> None:
        """With `agent` only its joints and commands, and the pictures of its own and the global camera."""
        self._pa, self._parquet = import_library("pyarrow"), import_library("pyarrow.parquet")
        self.store, self.folder, self.video = store, folder, video
        self._rate: int = store.attrs["control_hz"]
        self.agents = range(1, store.agents + 1) if agent is None else range(agent, agent + 1)
        kept_cameras = store.cameras if agent is None else ("global", f"agent{agent}")
        self.cameras = [camera for camera in store.cameras if camera in kept_cameras]
        self.features = _features(store, self.agents, self.cameras, video)
        self.rows: list[dict[str, Any]] = []  # metadata, one per episode
        self.stats: list[dict[str, Stats]] = []  # one per episode
        self._files = ExitStack()  # open files
        self._data: Any = None
        self._films: dict[str, Film] = {}
        self._file_start = self._episode_start = 0  # first rows of the open files, and of the next episode

    def write(self, advance: Advance) -> None:
        """Writes all episodes of the store."""
        with self._files:
            for index in range(len(self.store)):
                self._add_episode(index, self.store.episode(index))
                advance()
        self.finish()

    def _add_episode(self, index: int, episode: Episode) -> None:
        path_values, start = self.path_values(index), self._episode_start
        columns = self._columns(index, episode, start)
        cells = {name: self._cells(values) for name, values in columns.items()}
        if not self.video:
            cells |= {_camera_key(camera): self._png(episode.images[camera]) for camera in self.cameras}
        table = self._pa.table(cells).replace_schema_metadata(self.metadata())
        if index % self.EPISODES_PER_FILE == 0:
            self._next_files(path_values, start, table.schema)
        self._data.write_table(table)
        for camera, film in self._films.items():
            for frame in episode.images[camera]:
                film.add(frame)
        stats = {name: value_stats(values) for name, values in columns.items()}
        stats |= {_camera_key(camera): picture_stats(episode.images[camera]) for camera in self.cameras}
        self.stats.append(stats)
        self.rows.append(self.row(index, len(episode.qpos), start, path_values))
        self._episode_start += len(episode.qpos)

    def path_values(self, index: int) -> dict[str, int]:
        """Values for the path patterns of the files of an episode."""
        chunk, file = divmod(index // self.EPISODES_PER_FILE, FILES_PER_CHUNK)
        return {"chunk_index": chunk, "file_index": file}

    def metadata(self) -> dict[str, str]:
        """Schema metadata of each Parquet file of data."""
        return {}

    def finish(self) -> None:
        """Writes the metadata known at the end: episodes, tasks, statistics, features."""
        for start in range(0, len(self.rows), self.EPISODES_PER_FILE):
            rows = self.rows[start : start + self.EPISODES_PER_FILE]
            path_values = {key: rows[0][f"data/{key}"] for key in ("chunk_index", "file_index")}
            self._parquet.write_table(self._pa.Table.from_pylist(rows), self._path(EPISODES, path_values))
        self._parquet.write_table(self._tasks(), self.folder / "meta/tasks.parquet")
        names = self.stats[0]
        totals = {
            name: aggregate_stats([episode_stats[name] for episode_stats in self.stats]) for name in names
        }
        write_json(self.folder / "meta/stats.json", plain(totals))
        write_json(self.folder / "meta/info.json", self.info())

    def _next_files(self, path_values: Mapping[str, int], start: int, schema: Any) -> None:
        """Closes the open files and begins the next ones."""
        self._files.close()
        self._file_start = start
        writer = self._parquet.ParquetWriter(self._path(self.DATA, path_values), schema)
        self._data = self._files.enter_context(writer)
        for camera in self.cameras if self.video else ():
            path = self._path(self.VIDEO, {**path_values, "video_key": _camera_key(camera)})
            self._films[camera] = self._files.enter_context(Film(path, self._rate, None))

    def _path(self, pattern: str, path_values: Mapping[str, Any]) -> Path:
        path = self.folder / pattern.format(**path_values)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _columns(self, index: int, episode: Episode, start: int) -> dict[str, NDArray[Any]]:
        """Feature -> its rows in an episode."""
        steps = len(episode.qpos)
        frame = np.arange(steps)
        poses = [episode.poses[name] for name in self.store.objects]
        rows = slice(self.agents[0] - 1, self.agents[-1])
        return {
            "observation.state": flatten_agents(episode.qpos[:, rows]),
            "action": flatten_agents(episode.action[:, rows]),
            **({"object_poses": np.concatenate(poses, axis=1)} if poses else {}),
            **({} if episode.executed is None else {"executed": flatten_agents(episode.executed[:, rows])}),
            "next.success": success_flags(steps),
            "next.done": success_flags(steps),
            "scene_seed": np.full(steps, episode.seed),
            "timestamp": (frame / self._rate).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(steps, index),
            "index": frame + start,
            "task_index": np.zeros(steps, np.int64),
        }

    def _cells(self, values: NDArray[Any]) -> Any:
        """Values (T,) or (T, D) as a column."""
        if values.ndim == 1:
            return self._pa.array(values)
        return self._pa.FixedSizeListArray.from_arrays(self._pa.array(values.ravel()), values.shape[1])

    def _png(self, pictures: NDArray[np.uint8]) -> Any:
        cell_type = self._pa.struct([("bytes", self._pa.binary()), ("path", self._pa.string())])
        cells = []
        for picture in pictures:
            file = BytesIO()
            Image.fromarray(picture).save(file, "png")
            cells.append({"bytes": file.getvalue(), "path": None})
        return self._pa.array(cells, cell_type)

    def row(self, index: int, steps: int, start: int, path_values: Mapping[str, int]) -> dict[str, Any]:
        """Metadata of an episode."""
        row = {
            "episode_index": index,
            "tasks": [task_text(self.store)],
            "length": steps,
            "dataset_from_index": start,
            "dataset_to_index": start + steps,
        }
        row |= {
            f"{prefix}/{key}": value
            for prefix in ("data", "meta/episodes")
            for key, value in path_values.items()
        }
        if self.video:
            timestamps = {
                "from_timestamp": (start - self._file_start) / self._rate,
                "to_timestamp": (start - self._file_start + steps) / self._rate,
            }
            for camera in self.cameras:
                row |= {
                    f"videos/{_camera_key(camera)}/{key}": value
                    for key, value in {**path_values, **timestamps}.items()
                }
        for name, stats in self.stats[-1].items():
            row |= {f"stats/{name}/{key}": value.tolist() for key, value in stats.items()}
        return row

    def _tasks(self) -> Any:
        """Table of the one task, with its description as index, as pandas would write it."""
        table = self._pa.table({"task_index": [0], "task": [task_text(self.store)]})
        column_types = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
        columns = [
            {
                "name": name,
                "field_name": name,
                "pandas_type": pandas_type,
                "numpy_type": numpy_type,
                "metadata": None,
            }
            for name, (pandas_type, numpy_type) in column_types.items()
        ]
        pandas_metadata = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
        return table.replace_schema_metadata({"pandas": json.dumps(pandas_metadata)})

    def info(self) -> dict[str, Any]:
        """Metadata of the data set, for info.json."""
        robot_counts = Counter(self.store.models[agent - 1].kind for agent in self.agents)
        return {
            "codebase_version": self.VERSION,
            "robot_type": "_".join(f"{count}x_{kind}" for kind, count in robot_counts.items()),
            "total_episodes": len(self.store),
            "total_frames": self.store.steps,
            "total_tasks": 1,
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._rate,
            "splits": {"train": f"0:{len(self.store)}"},
            "data_path": self.DATA,
            "video_path": self.VIDEO if self.video else None,
            "features": self.features,
        }


def _features(
    store: Store, agents: Sequence[int], cameras: Sequence[str], video: bool
) -> dict[str, dict[str, Any]]:
    """Feature -> dtype, shape and names of its values."""
    rate = store.attrs["control_hz"]
    size = store.attrs["height"], store.attrs["width"]
    features = {
        "observation.state": _vector_feature(_prefix_agent(agents, partial(joint_names, store.attrs)))
    }
    features["action"] = _vector_feature(_prefix_agent(agents, partial(command_names, store.attrs)))
    if store.objects:
        features["object_poses"] = _vector_feature(
            [f"{name}.{axis}" for name in store.objects for axis in POSE]
        )
    if store.disturbed:
        features["executed"] = _vector_feature(_prefix_agent(agents, partial(command_names, store.attrs)))
    for camera in cameras:
        features[_camera_key(camera)] = {
            "dtype": "image",
            "shape": [*size, 3],
            "names": ["height", "width", "channels"],
        }
        if video:
            info = {"height": size[0], "width": size[1], "codec": "h264", "pix_fmt": "gbrp", "fps": rate}
            info = {f"video.{key}": value for key, value in (info | {"channels": 3}).items()}
            info |= {"video.is_depth_map": False, "has_audio": False}
            features[_camera_key(camera)] |= {"dtype": "video", "info": info}
    dtypes = {"next.success": "bool", "next.done": "bool", "scene_seed": "int64", "timestamp": "float32"}
    dtypes |= dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    return features | {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in dtypes.items()}


def _prefix_agent(agents: Sequence[int], names: Callable[[int], Sequence[str]]) -> list[str]:
    """Names prefixed with `agent<k>.`: all of the first agent, then all of the second, ..."""
    return [f"agent{agent}.{name}" for agent in agents for name in names(agent)]


def _vector_feature(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _camera_key(camera: str) -> str:
    return f"observation.images.{camera}"


def task_text(store: Store) -> str:
    """The task in words, for language-conditioned policies."""
    return store.description.language["description"] if store.description else store.attrs["task"]


def value_stats(values: NDArray[Any]) -> Stats:
    """Statistics of rows (T, D) or (T,): min, max, mean, standard deviation, quantiles (D,), count."""
    rows = values.reshape(len(values), -1).astype(float)
    stats = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    stats |= {name: np.quantile(rows, q, axis=0) for name, q in QUANTILES.items()}
    return {**stats, "count": np.array([len(values)])}


def picture_stats(pictures: NDArray[np.uint8]) -> Stats:
    """Statistics of some of the pictures (T, H, W, 3), by channel (3, 1, 1), from 0 to 1."""
    sample = pictures[np.unique(np.linspace(0, len(pictures) - 1, STATS_PICTURES).astype(int))]
    stats = value_stats(sample.reshape(-1, sample.shape[-1]) / 255)
    return {name: value.reshape(-1, 1, 1) for name, value in stats.items()} | {
        "count": np.array([len(sample)])
    }


def aggregate_stats(parts: Sequence[Stats]) -> Stats:
    """Statistics of all episodes from those of each; quantiles are count-weighted means, as in LeRobot."""
    counts = np.concatenate([part["count"] for part in parts])

    def mean(values: Iterable[NDArray[Any]]) -> NDArray[Any]:
        return np.average(np.stack([*values]), axis=0, weights=counts)

    total_mean = mean(part["mean"] for part in parts)
    variance = mean(part["std"] ** 2 + (part["mean"] - total_mean) ** 2 for part in parts)
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": total_mean,
        "std": np.sqrt(variance),
        **{name: mean(part[name] for part in parts) for name in QUANTILES},
        "count": np.array([counts.sum()]),
    }
