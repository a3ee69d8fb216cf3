"""Textures, finishes, lamps and lights: which values are refused."""

from collections.abc import Callable
from typing import Any

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.types import Finish, Lamp, Light, Texture

MARBLE: Any = "marble"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Texture(MARBLE, "seen", 0, 0.5),
            "unknown kind of a texture 'marble'; available: cloth, noise",
        ),
        (
            lambda: Texture("wood", MARBLE, 0, 0.5),
            "unknown set of a texture 'marble'; available: seen, unseen",
        ),
        (lambda: Texture("wood", "seen", 0, 0.0), "tile_m=0.0 of a texture; expected more than 0 m"),
        (lambda: Texture("wood", "seen", 0, float("nan")), "tile_m=nan of a texture"),
        (lambda: Finish(colour=(0.1, 1.2, 0.0)), r"colour of a finish is \(0.1, 1.2, 0.0\); expected 0 to 1"),
        (lambda: Finish(roughness=-0.1), "roughness of a finish is -0.1; expected 0 to 1"),
        (lambda: Lamp((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), "expected one that is not zero"),
        (lambda: Light(lamps=Light().lamps * 2), "4 lamps; expected 3 at most"),
    ],
)
def test_invalid_appearances_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        make()
