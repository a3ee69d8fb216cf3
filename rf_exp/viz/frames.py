"""Camera pictures composed with readable text: sheets, and frames of a film."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rf_exp.viz.layout import Rgb, agent_colour

BACKGROUND, INK, FAINT_INK = (22, 24, 28), (236, 238, 240), (150, 154, 160)
GAP_PX = 8
TEXT_PX, SMALL_PX = 17, 15  # font sizes
LINE_PX = 25  # line spacing
RING_PX, DOT_PX = 6, 2  # radii of marks
ROWS = 2  # most agents' views per column beside the global view
font = cache(ImageFont.load_default)  # by its size in pixels


@dataclass(frozen=True)
class Mark:
    """A mark in a camera's picture, x right and y down from 0 to 1: a ring or a small dot."""

    camera: str
    x: float
    y: float
    colour: Rgb
    ring: bool


@dataclass(frozen=True)
class Line:
    """A line of text below the pictures, with a coloured mark before it."""

    text: str
    mark: Rgb
    ink: Rgb = INK


def frame(
    pictures: Mapping[str, NDArray[np.uint8]],
    title: str,
    lines: Sequence[Line],
    height_px: int,
    marks: Sequence[Mark] = (),
) -> NDArray[np.uint8]:
    """One frame of a film (H, W, 3): global view of that height, agents' views beside it, lines below.

    Its sizes are even, as video needs, and equal for the same cameras and number of lines.
    """
    agents = sorted(int(name.removeprefix("agent")) for name in pictures if name != "global")
    global_picture = pictures["global"]
    width_px = height_px * global_picture.shape[1] // global_picture.shape[0]
    rows = max(1, min(ROWS, len(agents)))
    view_height_px = (height_px - (rows - 1) * GAP_PX) // rows
    view_px = (view_height_px * global_picture.shape[1] // global_picture.shape[0], view_height_px)
    total_width_px = width_px + ceil(len(agents) / rows) * (view_px[0] + GAP_PX)
    total_height_px = height_px + LINE_PX * len(lines) + 3 * GAP_PX
    image, draw = blank((total_width_px + total_width_px % 2, total_height_px + total_height_px % 2))
    image.paste(
        _draw_marks(global_picture, (width_px, height_px), [m for m in marks if m.camera == "global"]), (0, 0)
    )
    label(draw, (0, 0), title, INK)
    for index, agent in enumerate(agents):
        column, row = divmod(index, rows)
        corner = (width_px + GAP_PX + column * (view_px[0] + GAP_PX), row * (view_height_px + GAP_PX))
        name = f"agent{agent}"
        image.paste(_draw_marks(pictures[name], view_px, [m for m in marks if m.camera == name]), corner)
        label(draw, corner, f"view of Agent_{agent}", agent_colour(agent))
    write_lines(draw, (GAP_PX, height_px + GAP_PX), lines)
    return np.asarray(image)


def _draw_marks(picture: NDArray[np.uint8], size: tuple[int, int], marks: Sequence[Mark]) -> Image.Image:
    """A picture scaled to that size, with marks; rings are drawn over dots."""
    image = scaled(picture, size)
    draw = ImageDraw.Draw(image)
    for mark in sorted(marks, key=lambda mark: mark.ring):
        x, y, radius = mark.x * size[0], mark.y * size[1], RING_PX if mark.ring else DOT_PX
        fill, outline = (None, mark.colour) if mark.ring else (mark.colour, None)
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill, outline, width=2)
    return image


def write_lines(draw: ImageDraw.ImageDraw, at: tuple[int, int], lines: Sequence[Line]) -> None:
    """Draws lines of text below one another, each with its mark."""
    for row, line in enumerate(lines):
        x, y = at[0], at[1] + row * LINE_PX
        draw.rectangle((x, y + 3, x + 12, y + 15), fill=line.mark)
        write(draw, (x + 22, y - 2), line.text, TEXT_PX, line.ink)


def label(draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, colour: Rgb) -> None:
    """Draws text on a dark strip in the corner of a picture."""
    width = draw.textlength(text, font(SMALL_PX))
    draw.rectangle((at[0], at[1], at[0] + width + 12, at[1] + SMALL_PX + 8), fill=BACKGROUND)
    write(draw, (at[0] + 6, at[1] + 2), text, SMALL_PX, colour)


def write(draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, size_px: int, colour: Rgb = INK) -> None:
    draw.text(at, text, fill=colour, font=font(size_px))


def blank(size: tuple[int, int]) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    """An empty image of that width and height in pixels, and its drawing context."""
    empty = Image.new("RGB", size, BACKGROUND)
    return empty, ImageDraw.Draw(empty)


def scaled(picture: NDArray[np.uint8], size: tuple[int, int]) -> Image.Image:
    image = Image.fromarray(picture)
    return image if image.size == size else image.resize(size, Image.Resampling.LANCZOS)
