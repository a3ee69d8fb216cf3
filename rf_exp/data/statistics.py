"""The statistics that LeRobot keeps of every feature, by episode and over all of them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
LOOKED_AT = 20  # pictures of an episode and camera that statistics are made of

Stats = dict[str, NDArray[Any]]


def of_values(values: NDArray[Any]) -> Stats:
    """Of rows (T, D) or (T,): least, largest, mean, standard deviation, quantiles (D,), and their count."""
    rows = values.reshape(len(values), -1).astype(float)
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    found |= {name: np.quantile(rows, q, axis=0) for name, q in QUANTILES.items()}
    return {**found, "count": np.array([len(values)])}


def of_pictures(pictures: NDArray[np.uint8]) -> Stats:
    """Of some of the pictures (T, H, W, 3), by channel (3, 1, 1), from 0 to 1."""
    some = pictures[np.unique(np.linspace(0, len(pictures) - 1, LOOKED_AT).astype(int))]
    found = of_values(some.reshape(-1, some.shape[-1]) / 255)
    return {name: value.reshape(-1, 1, 1) for name, value in found.items()} | {"count": np.array([len(some)])}


def together(parts: Sequence[Stats]) -> Stats:
    """Of all episodes from those of each; quantiles are the means of theirs, as LeRobot's own are."""
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
