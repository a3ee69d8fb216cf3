"""Lays pictures out on sheets and in frames of a film, with words that can be read."""

from collections.abc import Sequence
from functools import cache
from math import ceil

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rf_exp.constraints.evidence import agent_name
from rf_exp.gallery.performance import Line, Pictures, Still
from rf_exp.tasks import Task
from rf_exp.viz.layout import Rgb, agent_colour

GROUND, INK, SOFT = (22, 24, 28), (236, 238, 240), (150, 154, 160)
GAP_PX = 8
TEXT_PX, TITLE_PX, SMALL_PX = 17, 26, 15  # sizes of letters
LINE_PX = 25  # from one line of subgoals to the next
THUMB_PX = (400, 300)  # a picture on the sheet of a task
TILE_PX = (288, 216)  # a picture on the sheet of all tasks
FILM_ROWS = 2  # agents' views below one another at most, beside the global view
COLUMNS = 2  # tasks beside one another on the sheet of all


def contact_sheet(task: Task, stills: Sequence[Still], seed: int) -> Image.Image:
    """Start, middle and end of an episode, a row each, from all cameras, with the subgoals below."""
    cameras, (width, height) = list(stills[0].pictures), THUMB_PX
    block = height + GAP_PX + LINE_PX * len(task.agents) + 3 * GAP_PX
    top = 2 * GAP_PX + TITLE_PX + 3 * SMALL_PX
    size = (GAP_PX + len(cameras) * (width + GAP_PX), top + len(stills) * block)
    sheet, draw = _sheet(size)
    _write(draw, (GAP_PX, GAP_PX), task.title, TITLE_PX)
    _write(draw, (GAP_PX, GAP_PX + TITLE_PX + 8), f"{_robots(task)}, scene seed {seed}", SMALL_PX, SOFT)
    for row, still in enumerate(stills):
        y = top + row * block
        for column, camera in enumerate(cameras):
            x = GAP_PX + column * (width + GAP_PX)
            sheet.paste(_scaled(still.pictures[camera], THUMB_PX), (x, y))
            label = (
                f"{still.title}, {still.time_s:.1f} s" if camera == "global" else f"view of {_name(camera)}"
            )
            _label(draw, (x, y), label, INK if camera == "global" else agent_colour(_agent(camera)))
        _subgoals(draw, (GAP_PX, y + height + GAP_PX), still.lines)
    return sheet


def panel(task: Task, stills: Sequence[Still]) -> Image.Image:
    """One task on the sheet of all: its global view at each still, its title and its number of arms."""
    width, height = TILE_PX
    size = (len(stills) * (width + 4) - 4, height + TEXT_PX + 14)
    sheet, draw = _sheet(size)
    _write(draw, (2, 2), task.title, TEXT_PX)
    title_px = int(draw.textlength(task.title, _font(TEXT_PX)))
    _write(draw, (title_px + 14, 4), _robots(task), SMALL_PX, SOFT)
    for column, still in enumerate(stills):
        sheet.paste(_scaled(still.pictures["global"], TILE_PX), (column * (width + 4), TEXT_PX + 14))
    return sheet


def overview(panels: Sequence[Image.Image]) -> Image.Image:
    """All tasks, in two columns."""
    columns, gap = min(COLUMNS, len(panels)), 2 * GAP_PX
    width, height = panels[0].width + gap, panels[0].height + gap
    sheet, _ = _sheet((gap + columns * width, gap + ceil(len(panels) / columns) * height))
    for index, each in enumerate(panels):
        row, column = divmod(index, columns)
        sheet.paste(each, (gap + column * width, gap + row * height))
    return sheet


def frame(task: Task, pictures: Pictures, lines: Sequence[Line], time_s: float) -> NDArray[np.uint8]:
    """One frame of the film (H, W, 3): global view, agents' views beside it, subgoals below.

    Even sizes, which video needs. The same size for every frame of a task.
    """
    large = pictures["global"]
    height_px, width_px = large.shape[:2]
    rows = min(FILM_ROWS, len(task.agents))
    high = (height_px - (rows - 1) * GAP_PX) // rows
    view_px = (high * width_px // height_px, high)
    columns = ceil(len(task.agents) / rows)
    size = (
        width_px + columns * (view_px[0] + GAP_PX),
        height_px + LINE_PX * len(lines) + 3 * GAP_PX,
    )
    sheet, draw = _sheet((size[0] + size[0] % 2, size[1] + size[1] % 2))
    sheet.paste(Image.fromarray(large), (0, 0))
    _label(draw, (0, 0), f"{task.title}, {time_s:.1f} s", INK)
    for agent in task.agents:
        column, row = divmod(agent - 1, rows)
        at = (width_px + GAP_PX + column * (view_px[0] + GAP_PX), row * (high + GAP_PX))
        sheet.paste(_scaled(pictures[f"agent{agent}"], view_px), at)
        _label(draw, at, f"view of {agent_name(agent)}", agent_colour(agent))
    _subgoals(draw, (GAP_PX, height_px + GAP_PX), lines)
    return np.asarray(sheet)


def _subgoals(draw: ImageDraw.ImageDraw, at: tuple[int, int], lines: Sequence[Line]) -> None:
    """A line an agent, as in the paper's figure: `Agent_1: grasp barrier at left`. Grey: it waits."""
    for agent, line in enumerate(lines, start=1):
        x, y = at[0], at[1] + (agent - 1) * LINE_PX
        draw.rectangle((x, y + 3, x + 12, y + 15), fill=agent_colour(agent))
        words = f"{agent_name(agent)}: {line.text or 'done'}"
        _write(draw, (x + 22, y - 2), words, TEXT_PX, INK if line.moving else SOFT)


def _label(draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, colour: Rgb) -> None:
    """Words on a dark strip in the corner of a picture."""
    width = draw.textlength(text, _font(SMALL_PX))
    draw.rectangle((at[0], at[1], at[0] + width + 12, at[1] + SMALL_PX + 8), fill=GROUND)
    _write(draw, (at[0] + 6, at[1] + 2), text, SMALL_PX, colour)


def _write(
    draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, size_px: int, colour: Rgb = INK
) -> None:
    draw.text(at, text, fill=colour, font=_font(size_px))


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size_px)


def _sheet(size: tuple[int, int]) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    sheet = Image.new("RGB", size, GROUND)
    return sheet, ImageDraw.Draw(sheet)


def _scaled(picture: NDArray[np.uint8], size: tuple[int, int]) -> Image.Image:
    return Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS)


def _robots(task: Task) -> str:
    return "one arm" if len(task.agents) == 1 else f"{len(task.agents)} arms"


def _agent(camera: str) -> int:
    return int(camera.removeprefix("agent"))


def _name(camera: str) -> str:
    return agent_name(_agent(camera))
