"""Which assets of ours have one of the authors' release for their part, and what its files are."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

MOVING = "moving"  # links of a URDF


@dataclass(frozen=True)
class Source:
    """Which files of the release one of our assets is made of: see released.yaml."""

    mesh: str
    annotation: str
    link: str | None = None
    standing_wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    hinge_of: str | None = None
    points: Mapping[str, tuple[str, int]] = field(default_factory=dict)


@cache
def released() -> Mapping[str, Source]:
    """Asset of ours -> files of the release."""
    node: Any = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    return {name: Source(**said) for name, said in node.items()}


def seat_m(folder: str, like: str, bearer: str) -> float | None:
    """How far the underside of what moves in a URDF is above that of what bears it; None of other things."""
    if released()[like].link != MOVING or bearer not in released():
        return None
    from rf_exp.tasks.assets.asset.annotated import shape_of  # meshes are slow to import

    return shape_of(folder, like).lowest_m - shape_of(folder, bearer).lowest_m
