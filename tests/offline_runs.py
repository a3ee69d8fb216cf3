"""Offline runs of Weights & Biases, read back from their files."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wandb.proto import wandb_internal_pb2

BLOCK, HEADER = 32768, 7  # bytes; LevelDB's log format: blocks of records (CRC, length, kind)


def records(path: Path) -> Iterator[Any]:
    """The records of an offline run."""
    content, at, begun = path.read_bytes(), HEADER, b""  # the file begins with a header of the same size
    while at + HEADER <= len(content):
        if BLOCK - at % BLOCK < HEADER:  # no room for a record: the rest of a block is padding
            at += BLOCK - at % BLOCK
            continue
        _, length, kind = struct.unpack("<IHB", content[at : at + HEADER])
        begun += content[at + HEADER : at + HEADER + length]
        at += HEADER + length
        if kind in (1, 4):  # whole, or the last part of one
            record = wandb_internal_pb2.Record()  # pyright: ignore[reportAttributeAccessIssue]
            record.ParseFromString(begun)
            begun = b""
            yield record


def runs(out: Path) -> dict[str, dict[str, Any]]:
    """Every offline run below `out`, by its name."""
    found = {}
    for path in sorted(out.glob("wandb/offline-run-*/run-*.wandb")):
        run: dict[str, Any] = {"history": [], "config": {}}
        for record in records(path):
            if record.HasField("run"):
                told = record.run
                run |= {"name": told.display_name, "group": told.run_group, "tags": list(told.tags)}
                run |= {"stage": told.job_type}
                run["config"] = {item.key: json.loads(item.value_json) for item in told.config.update}
            elif record.HasField("history"):
                items = record.history.item
                run["history"].append(
                    {item.key or ".".join(item.nested_key): json.loads(item.value_json) for item in items}
                )
        found[run["name"]] = run
    return found
