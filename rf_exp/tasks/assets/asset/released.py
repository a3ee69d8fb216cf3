"""Table of the built-in assets with a counterpart in the authors' release, and its files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

MOVING = "moving"  # value of `Source.link`: the moving links of a URDF


@dataclass(frozen=True)
class Source:
    """Files of the release for one built-in asset; the fields are explained in released.yaml."""

    mesh: str
    annotation: str
    link: str | None = None
    standing_wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    hinge_of: str | None = None
    points: Mapping[str, tuple[str, int]] = field(default_factory=dict)


@cache
def release_sources() -> Mapping[str, Source]:
    """Built-in asset -> its files in the release."""
    node: Any = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    return {name: Source(**fields) for name, fields in node.items()}


def seat_m(folder: str, like: str, bearer: str) -> float | None:
    """Height of a moving part's underside above its bearer's; None unless both are in the release."""
    if release_sources()[like].link != MOVING or bearer not in release_sources():
        return None
    from rf_exp.tasks.assets.asset.annotated import shape_of  # meshes are slow to import

    return shape_of(folder, like).lowest_m - shape_of(folder, bearer).lowest_m
