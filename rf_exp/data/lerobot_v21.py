"""Export as a LeRobotDataset v2.1, which openpi and GR00T read: the columns of v3.0, one file per episode.

meta/info.json, tasks.jsonl, episodes.jsonl, episodes_stats.jsonl
data/chunk-<c>/episode_<e>.parquet               rows of an episode
videos/chunk-<c>/<camera>/episode_<e>.mp4        pictures of a camera in it
"""

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rf_exp.artifacts import plain, write_json, write_text
from rf_exp.data import lerobot
from rf_exp.data.formats import Advance
from rf_exp.data.lerobot import PICTURES, QUANTILES, TAGS, Stats, Writer, task_text
from rf_exp.store import Store

__all__ = ["PICTURES", "TAGS", "describe", "write"]

EPISODES_PER_CHUNK = 1000


def write(store: Store, folder: Path, pictures: str, advance: Advance, agent: int | None = None) -> None:
    """Writes all episodes of a store to a folder, for all agents or for one; `pictures` is in `PICTURES`."""
    _Writer(store, folder, pictures == "video", agent).write(advance)


class _Writer(Writer):
    VERSION = "v2.1"
    EPISODES_PER_FILE = 1
    DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    VIDEO = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"

    def path_values(self, index: int) -> dict[str, int]:
        return {"episode_chunk": index // EPISODES_PER_CHUNK, "episode_index": index}

    def row(self, index: int, steps: int, start: int, path_values: Mapping[str, int]) -> dict[str, Any]:
        return {"episode_index": index, "tasks": [task_text(self.store)], "length": steps}

    def metadata(self) -> dict[str, str]:
        """Column types in the form that `datasets` reads; without them PNG cells stay bytes."""
        feature_types = {
            name: _feature_type(feature)
            for name, feature in self.features.items()
            if feature["dtype"] != "video"
        }
        return {"huggingface": json.dumps({"info": {"features": feature_types}})}

    def finish(self) -> None:
        stats_rows = [
            {"episode_index": index, "stats": _plain_stats(stats)} for index, stats in enumerate(self.stats)
        ]
        rows_by_name = {"tasks": [{"task_index": 0, "task": task_text(self.store)}], "episodes": self.rows}
        for name, rows in {**rows_by_name, "episodes_stats": stats_rows}.items():
            write_text(self.folder / f"meta/{name}.jsonl", "".join(f"{json.dumps(row)}\n" for row in rows))
        write_json(self.folder / "meta/info.json", self.info())

    def info(self) -> dict[str, Any]:
        metadata = super().info() | {
            "total_videos": len(self.store) * len(self.cameras) * self.video,
            "total_chunks": -(-len(self.store) // EPISODES_PER_CHUNK),
            "chunks_size": EPISODES_PER_CHUNK,
        }
        return {key: value for key, value in metadata.items() if not key.endswith("_files_size_in_mb")}


describe = partial(lerobot.describe, version=_Writer.VERSION)


def _plain_stats(stats: Mapping[str, Stats]) -> Any:
    kept = {
        name: {key: value for key, value in feature_stats.items() if key not in QUANTILES}
        for name, feature_stats in stats.items()
    }
    return plain(kept)


def _feature_type(feature: Mapping[str, Any]) -> dict[str, Any]:
    if feature["dtype"] == "image":
        return {"_type": "Image"}
    value = {"dtype": feature["dtype"], "_type": "Value"}
    is_scalar = feature["shape"] == [1] and feature["names"] is None
    return value if is_scalar else {"feature": value, "length": feature["shape"][0], "_type": "Sequence"}
