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
from rf_exp.data.target import Advance, flat, last, library
from rf_exp.store import POSE, Store, command_names, joint_names
from rf_exp.types import Episode
from rf_exp.viz import Film

PICTURES = ("video", "png")  # both keep every pixel
TAGS = ("LeRobot",)
EPISODES_A_FILE, FILES_A_CHUNK = 50, 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, VIDEO = f"data/{FILE}.parquet", f"videos/{{video_key}}/{FILE}.mp4"
EPISODES = f"meta/episodes/{FILE}.parquet"

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
LOOKED_AT = 20  # pictures per episode and camera used for statistics

Stats = dict[str, NDArray[Any]]


def held(pictures: str, agent: int | None = None, version: str = "v3.0") -> str:
    """Description of the exported folder, for all agents or for one."""
    whose, side_by_side = "all agents", ", one agent behind the other"
    if agent is not None:
        whose, side_by_side = f"agent {agent}", ""
    kept = {"video": "lossless H.264 video (RGB, every pixel kept)", "png": "PNG within the Parquet files"}
    return (
        f"A LeRobotDataset {version}: `observation.state` holds the measured joints of {whose}, `action` "
        f"their joint\ntargets and gripper commands{side_by_side}; "
        f"`observation.images.<camera>` the pictures, as\n{kept[pictures]}. `object_poses`, `executed` and "
        "`scene_seed` are\nextras that no policy of lerobot takes for an input."
    )


def write(store: Store, folder: Path, pictures: str, advance: Advance, agent: int | None = None) -> None:
    """Writes all episodes of a store to a folder, for all agents or for one; `pictures` is in `PICTURES`."""
    Writer(store, folder, pictures == "video", agent).write(advance)


class Writer:
    """Writer of one data set. Files and metadata are those of `VERSION`; subclasses write other versions."""

    VERSION = "v3.0"
    EPISODES_A_FILE = EPISODES_A_FILE
    DATA, VIDEO = DATA, VIDEO

    def __init__(self, store: Store, folder: Path, video: bool, agent: int | None = None) -> None:
        """With `agent` only its joints and commands, and the pictures of its own and the global camera."""
        self._pa, self._parquet = library("pyarrow"), library("pyarrow.parquet")
        self.store, self.folder, self.video = store, folder, video
        self._rate: int = store.attrs["control_hz"]
        self.agents = range(1, store.agents + 1) if agent is None else range(agent, agent + 1)
        seen = store.cameras if agent is None else ("global", f"agent{agent}")
        self.cameras = [camera for camera in store.cameras if camera in seen]
        self.features = _features(store, self.agents, self.cameras, video)
        self.rows: list[dict[str, Any]] = []  # metadata, one per episode
        self.stats: list[dict[str, Stats]] = []  # one per episode
        self._files = ExitStack()  # open files
        self._data: Any = None
        self._films: dict[str, Film] = {}
        self._began = self._start = 0  # first rows of the open files, and of the next episode

    def write(self, advance: Advance) -> None:
        """Writes all episodes of the store."""
        with self._files:
            for index in range(len(self.store)):
                self._add(index, self.store.episode(index))
                advance()
        self.finish()

    def _add(self, index: int, episode: Episode) -> None:
        where, start = self.where(index), self._start
        columns = self._columns(index, episode, start)
        cells = {name: self._cells(values) for name, values in columns.items()}
        if not self.video:
            cells |= {_key(camera): self._png(episode.images[camera]) for camera in self.cameras}
        table = self._pa.table(cells).replace_schema_metadata(self.metadata())
        if index % self.EPISODES_A_FILE == 0:
            self._turn(where, start, table.schema)
        self._data.write_table(table)
        for camera, film in self._films.items():
            for frame in episode.images[camera]:
                film.add(frame)
        found = {name: of_values(values) for name, values in columns.items()}
        found |= {_key(each): of_pictures(episode.images[each]) for each in self.cameras}
        self.stats.append(found)
        self.rows.append(self.row(index, len(episode.qpos), start, where))
        self._start += len(episode.qpos)

    def where(self, index: int) -> dict[str, int]:
        """Values for the path patterns of the files of an episode."""
        chunk, file = divmod(index // self.EPISODES_A_FILE, FILES_A_CHUNK)
        return {"chunk_index": chunk, "file_index": file}

    def metadata(self) -> dict[str, str]:
        """Schema metadata of each Parquet file of data."""
        return {}

    def finish(self) -> None:
        """Writes the metadata known at the end: episodes, tasks, statistics, features."""
        for first in range(0, len(self.rows), self.EPISODES_A_FILE):
            rows = self.rows[first : first + self.EPISODES_A_FILE]
            where = {key: rows[0][f"data/{key}"] for key in ("chunk_index", "file_index")}
            self._parquet.write_table(self._pa.Table.from_pylist(rows), self._path(EPISODES, where))
        self._parquet.write_table(self._tasks(), self.folder / "meta/tasks.parquet")
        names = self.stats[0]
        merged = {name: together([each[name] for each in self.stats]) for name in names}
        write_json(self.folder / "meta/stats.json", plain(merged))
        write_json(self.folder / "meta/info.json", self.info())

    def _turn(self, where: Mapping[str, int], start: int, schema: Any) -> None:
        """Closes the open files and begins the next ones."""
        self._files.close()
        self._began = start
        writer = self._parquet.ParquetWriter(self._path(self.DATA, where), schema)
        self._data = self._files.enter_context(writer)
        for camera in self.cameras if self.video else ():
            path = self._path(self.VIDEO, {**where, "video_key": _key(camera)})
            self._films[camera] = self._files.enter_context(Film(path, self._rate, None))

    def _path(self, pattern: str, where: Mapping[str, Any]) -> Path:
        path = self.folder / pattern.format(**where)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _columns(self, index: int, episode: Episode, start: int) -> dict[str, NDArray[Any]]:
        """Feature -> its rows in an episode."""
        steps = len(episode.qpos)
        frame = np.arange(steps)
        poses = [episode.poses[name] for name in self.store.objects]
        rows = slice(self.agents[0] - 1, self.agents[-1])
        return {
            "observation.state": flat(episode.qpos[:, rows]),
            "action": flat(episode.action[:, rows]),
            **({"object_poses": np.concatenate(poses, axis=1)} if poses else {}),
            **({} if episode.executed is None else {"executed": flat(episode.executed[:, rows])}),
            "next.success": last(steps),
            "next.done": last(steps),
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
        kind = self._pa.struct([("bytes", self._pa.binary()), ("path", self._pa.string())])
        cells = []
        for picture in pictures:
            file = BytesIO()
            Image.fromarray(picture).save(file, "png")
            cells.append({"bytes": file.getvalue(), "path": None})
        return self._pa.array(cells, kind)

    def row(self, index: int, steps: int, start: int, where: Mapping[str, int]) -> dict[str, Any]:
        """Metadata of an episode."""
        row = {
            "episode_index": index,
            "tasks": [words(self.store)],
            "length": steps,
            "dataset_from_index": start,
            "dataset_to_index": start + steps,
        }
        row |= {f"{what}/{key}": at for what in ("data", "meta/episodes") for key, at in where.items()}
        if self.video:
            shown = {
                "from_timestamp": (start - self._began) / self._rate,
                "to_timestamp": (start - self._began + steps) / self._rate,
            }
            for camera in self.cameras:
                row |= {f"videos/{_key(camera)}/{key}": at for key, at in {**where, **shown}.items()}
        for name, stats in self.stats[-1].items():
            row |= {f"stats/{name}/{key}": value.tolist() for key, value in stats.items()}
        return row

    def _tasks(self) -> Any:
        """Table of the one task, with its description as index, as pandas would write it."""
        table = self._pa.table({"task_index": [0], "task": [words(self.store)]})
        kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
        columns = [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, (kind, numpy) in kinds.items()
        ]
        said = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
        return table.replace_schema_metadata({"pandas": json.dumps(said)})

    def info(self) -> dict[str, Any]:
        """Metadata of the data set, for info.json."""
        kinds = Counter(self.store.models[agent - 1].kind for agent in self.agents)
        return {
            "codebase_version": self.VERSION,
            "robot_type": "_".join(f"{count}x_{kind}" for kind, count in kinds.items()),
            "total_episodes": len(self.store),
            "total_frames": self.store.steps,
            "total_tasks": 1,
            "chunks_size": FILES_A_CHUNK,
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
    found = {"observation.state": _vector(_by_agent(agents, partial(joint_names, store.attrs)))}
    found["action"] = _vector(_by_agent(agents, partial(command_names, store.attrs)))
    if store.objects:
        found["object_poses"] = _vector([f"{name}.{axis}" for name in store.objects for axis in POSE])
    if store.disturbed:
        found["executed"] = _vector(_by_agent(agents, partial(command_names, store.attrs)))
    for camera in cameras:
        found[_key(camera)] = {
            "dtype": "image",
            "shape": [*size, 3],
            "names": ["height", "width", "channels"],
        }
        if video:
            info = {"height": size[0], "width": size[1], "codec": "h264", "pix_fmt": "gbrp", "fps": rate}
            info = {f"video.{key}": value for key, value in (info | {"channels": 3}).items()}
            info |= {"video.is_depth_map": False, "has_audio": False}
            found[_key(camera)] |= {"dtype": "video", "info": info}
    kinds = {"next.success": "bool", "next.done": "bool", "scene_seed": "int64", "timestamp": "float32"}
    kinds |= dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    return found | {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in kinds.items()}


def _by_agent(agents: Sequence[int], names: Callable[[int], Sequence[str]]) -> list[str]:
    """Names prefixed with `agent<k>.`: all of the first agent, then all of the second, ..."""
    return [f"agent{agent}.{name}" for agent in agents for name in names(agent)]


def _vector(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _key(camera: str) -> str:
    return f"observation.images.{camera}"


def words(store: Store) -> str:
    """The task in words, for language-conditioned policies."""
    return store.description.language["description"] if store.description else store.attrs["task"]


def of_values(values: NDArray[Any]) -> Stats:
    """Statistics of rows (T, D) or (T,): min, max, mean, standard deviation, quantiles (D,), count."""
    rows = values.reshape(len(values), -1).astype(float)
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    found |= {name: np.quantile(rows, q, axis=0) for name, q in QUANTILES.items()}
    return {**found, "count": np.array([len(values)])}


def of_pictures(pictures: NDArray[np.uint8]) -> Stats:
    """Statistics of some of the pictures (T, H, W, 3), by channel (3, 1, 1), from 0 to 1."""
    some = pictures[np.unique(np.linspace(0, len(pictures) - 1, LOOKED_AT).astype(int))]
    found = of_values(some.reshape(-1, some.shape[-1]) / 255)
    return {name: value.reshape(-1, 1, 1) for name, value in found.items()} | {"count": np.array([len(some)])}


def together(parts: Sequence[Stats]) -> Stats:
    """Statistics of all episodes from those of each; quantiles are count-weighted means, as in LeRobot."""
    counts = np.concatenate([part["count"] for part in parts])

    def mean(values: Iterable[NDArray[Any]]) -> NDArray[Any]:
        return np.average(np.stack([*values]), axis=0, weights=counts)

    middle = mean(part["mean"] for part in parts)
    spread = mean(part["std"] ** 2 + (part["mean"] - middle) ** 2 for part in parts)
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": middle,
        "std": np.sqrt(spread),
        **{name: mean(part[name] for part in parts) for name in QUANTILES},
        "count": np.array([counts.sum()]),
    }
