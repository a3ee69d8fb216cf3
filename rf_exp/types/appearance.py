"""What a scene looks like beside what it is: colours, textures and lamps."""

from dataclasses import dataclass
from typing import Literal, get_args

from rf_exp.errors import ArgumentError, choices

Rgb = tuple[float, float, float]  # linear
TextureKind = Literal["wood", "tile", "cloth", "noise", "stripes"]
TextureSet = Literal["seen", "unseen"]  # for demonstrations, for evaluation: no palette of a kind is in both
MOST_LAMPS = 3  # directional ones that a scene of SAPIEN has room for


@dataclass(frozen=True)
class Texture:
    """A picture that repeats over a surface, described; its pixels are made where scenes are drawn.

    Raises ArgumentError for a kind or set that does not exist and for a size that is not positive.
    """

    kind: TextureKind
    set: TextureSet
    seed: int  # of pattern and palette
    tile_m: float  # side of the square that the picture covers

    def __post_init__(self) -> None:
        for name, possible in (("kind", get_args(TextureKind)), ("set", get_args(TextureSet))):
            if (value := getattr(self, name)) not in possible:
                raise choices(f"{name} of a texture", value, possible)
        if not 0 < self.tile_m < float("inf"):
            raise ArgumentError(f"tile_m={self.tile_m} of a texture; expected more than 0 m")


@dataclass(frozen=True)
class Finish:
    """What covers a surface. What is None stays as the thing has it."""

    colour: Rgb | None = None  # in [0, 1]; what a texture is drawn in, white unless given
    texture: Texture | None = None
    roughness: float | None = None  # 0 mirrors the lamps, 1 is matt

    def __post_init__(self) -> None:
        for name, values in (("colour", self.colour or ()), ("roughness", (self.roughness or 0.0,))):
            if not all(0 <= value <= 1 for value in values):
                raise ArgumentError(f"{name} of a finish is {getattr(self, name)}; expected 0 to 1")


BARE = Finish()


@dataclass(frozen=True)
class Look:
    """What covers the table top and the room around it; as they come unless given."""

    table: Finish = BARE
    floor: Finish = BARE
    walls: Finish = BARE


@dataclass(frozen=True)
class Lamp:
    """A lamp so far away that its light comes from one direction."""

    direction: tuple[float, float, float]  # of its light in the world, of any length
    colour: Rgb  # irradiance; may exceed 1

    def __post_init__(self) -> None:
        if not any(self.direction):
            raise ArgumentError(f"direction of a lamp is {self.direction}; expected one that is not zero")


@dataclass(frozen=True)
class Light:
    """The lamps of a scene, and light from everywhere. Nothing casts a shadow.

    Raises ArgumentError for more lamps than can be drawn.
    """

    ambient: Rgb = (0.3, 0.3, 0.3)
    lamps: tuple[Lamp, ...] = (
        Lamp((-0.6, 0.4, -1.0), (1.6, 1.6, 1.6)),
        Lamp((0.4, -0.7, -0.5), (0.6, 0.6, 0.6)),  # a weaker one from the other side
    )

    def __post_init__(self) -> None:
        if len(self.lamps) > MOST_LAMPS:
            raise ArgumentError(f"{len(self.lamps)} lamps; expected {MOST_LAMPS} at most")

    def brighter(self, factor: float) -> "Light":
        """All of it so many times as bright."""
        lamps = tuple(Lamp(lamp.direction, _times(lamp.colour, factor)) for lamp in self.lamps)
        return Light(_times(self.ambient, factor), lamps)


def _times(colour: Rgb, factor: float) -> Rgb:
    red, green, blue = colour
    return red * factor, green * factor, blue * factor
