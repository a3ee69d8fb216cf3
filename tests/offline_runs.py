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
    # The file begins with a header of the same size.
    content, offset, payload = path.read_bytes(), HEADER, b""
    while offset + HEADER <= len(content):
        if BLOCK - offset % BLOCK < HEADER:  # too small for a record: the rest of the block is padding
            offset += BLOCK - offset % BLOCK
            continue
        _, length, kind = struct.unpack("<IHB", content[offset : offset + HEADER])
        payload += content[offset + HEADER : offset + HEADER + length]
        offset += HEADER + length
        if kind in (1, 4):  # a complete record, or its last part
            record = wandb_internal_pb2.Record()  # pyright: ignore[reportAttributeAccessIssue]
            record.ParseFromString(payload)
            payload = b""
            yield record


def runs(out: Path) -> dict[str, dict[str, Any]]:
    """The offline runs below `out`, by name."""
    by_name = {}
    for path in sorted(out.glob("wandb/offline-run-*/run-*.wandb")):
        run: dict[str, Any] = {"history": [], "config": {}}
        for record in records(path):
            if record.HasField("run"):
                info = record.run
                run |= {"name": info.display_name, "group": info.run_group, "tags": list(info.tags)}
                run |= {"stage": info.job_type}
                run["config"] = {item.key: json.loads(item.value_json) for item in info.config.update}
            elif record.HasField("history"):
                items = record.history.item
                run["history"].append(
                    {item.key or ".".join(item.nested_key): json.loads(item.value_json) for item in items}
                )
        by_name[run["name"]] = run
    return by_name
