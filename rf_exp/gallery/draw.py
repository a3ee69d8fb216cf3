"""Sheets, strips and films of a performance, with captions."""

import textwrap
from collections.abc import Sequence
from math import ceil
from pathlib import Path

from PIL import Image

from rf_exp.gallery.performance import Activity, Crop, Performance, Still, replay
from rf_exp.sim import Simulator
from rf_exp.statements import agent_name
from rf_exp.tasks import Task
from rf_exp.types import CONTROL_DT_S
from rf_exp.viz import Film, agent_colour, frames
from rf_exp.viz.frames import FAINT_INK, GAP_PX, INK, LINE_PX, SMALL_PX, TEXT_PX

TITLE_PX = 26  # font size
THUMB_PX = (400, 300)  # size of a picture on a contact sheet
TILE_PX = (480, 360)  # size of a picture on a strip and on the overview
CAPTION_WIDTH, CAPTION_LINES = 54, 4  # characters per line, and lines, of a caption on the overview
FRAME_STEPS = 2  # control steps per frame: at 20 frames per second, twice real time
REST_FRAMES = 20  # repeats of the last frame
COLUMNS = 3  # tasks per row of the overview


def contact_sheet(task: Task, stills: Sequence[Still], seed: int) -> Image.Image:
    """Contact sheet: start, middle and end of an episode in one row each, from all cameras, with subgoals."""
    cameras, (width, height) = list(stills[0].pictures), THUMB_PX
    row_height = height + GAP_PX + LINE_PX * len(task.agents) + 3 * GAP_PX
    top = 2 * GAP_PX + TITLE_PX + 3 * SMALL_PX
    size = (GAP_PX + len(cameras) * (width + GAP_PX), top + len(stills) * row_height)
    sheet, draw = frames.blank(size)
    frames.write(draw, (GAP_PX, GAP_PX), task.title, TITLE_PX)
    frames.write(
        draw, (GAP_PX, GAP_PX + TITLE_PX + 8), f"{_arm_count(task)}, scene seed {seed}", SMALL_PX, FAINT_INK
    )
    for row, still in enumerate(stills):
        y = top + row * row_height
        for column, camera in enumerate(cameras):
            x = GAP_PX + column * (width + GAP_PX)
            sheet.paste(frames.scaled(still.pictures[camera], THUMB_PX), (x, y))
            if camera == "global":
                frames.label(draw, (x, y), f"{still.title}, {still.time_s:.1f} s", INK)
            else:
                agent = int(camera.removeprefix("agent"))
                frames.label(draw, (x, y), f"view of {agent_name(agent)}", agent_colour(agent))
        frames.write_lines(draw, (GAP_PX, y + height + GAP_PX), _activity_lines(still.activities))
    return sheet


def strip(task: Task, performance: Performance) -> Image.Image:
    """Strip: start, middle and end of an episode side by side, cropped, with the subgoals below."""
    stills, (width, height) = performance.stills, TILE_PX
    size = (len(stills) * (width + GAP_PX) - GAP_PX, height + GAP_PX + LINE_PX * len(task.agents))
    sheet, draw = frames.blank(size)
    for column, still in enumerate(stills):
        x = column * (width + GAP_PX)
        sheet.paste(_cropped(still, performance.crop), (x, 0))
        frames.label(draw, (x, 0), f"{still.title}, {still.time_s:.1f} s", INK)
        frames.write_lines(draw, (x, height + GAP_PX), _activity_lines(still.activities))
    return sheet


def panel(task: Task, performance: Performance) -> Image.Image:
    """Panel of one task on the overview: its cropped global view mid-episode, and its description."""
    width, height = TILE_PX
    sheet, draw = frames.blank((width, height + 2 * GAP_PX + TITLE_PX + CAPTION_LINES * LINE_PX))
    sheet.paste(_cropped(performance.stills[1], performance.crop), (0, 0))
    frames.write(draw, (2, height + GAP_PX), task.title, TITLE_PX)
    title_px = int(draw.textlength(task.title, frames.font(TITLE_PX)))
    frames.write(draw, (title_px + 14, height + GAP_PX + 8), _arm_count(task), TEXT_PX, FAINT_INK)
    # Without its first sentence, which describes the objects in the picture.
    instruction = task.description.partition(". ")[2] or task.description
    lines = textwrap.wrap(instruction, CAPTION_WIDTH, max_lines=CAPTION_LINES, placeholder=" ...")
    for row, line in enumerate(lines):
        frames.write(draw, (2, height + 2 * GAP_PX + TITLE_PX + row * LINE_PX), line, TEXT_PX, INK)
    return sheet


def _cropped(still: Still, crop: Crop) -> Image.Image:
    """The part `crop` of the global view, resized to a tile."""
    return Image.fromarray(still.pictures["global"]).resize(TILE_PX, Image.Resampling.LANCZOS, box=crop)


def overview(panels: Sequence[Image.Image]) -> Image.Image:
    """Overview: the panels of all tasks on one sheet."""
    columns, gap = min(COLUMNS, len(panels)), 2 * GAP_PX
    width, height = panels[0].width + gap, panels[0].height + gap
    sheet, _ = frames.blank((gap + columns * width, gap + ceil(len(panels) / columns) * height))
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        sheet.paste(panel, (gap + column * width, gap + row * height))
    return sheet


def film(path: Path, task: Task, performance: Performance, world: Simulator) -> None:
    """Replays the performance and writes a film to `path`. Raises StageError when that fails.

    A frame has the global view, the agents' views beside it and the subgoals below.
    """
    steps = len(performance.actions)
    frame_steps = {*range(0, steps, FRAME_STEPS), steps}
    with Film(path) as writer:
        for step, pictures in replay(world, performance.seed, performance.actions, frame_steps):
            title = f"{task.title}, {step * CONTROL_DT_S:.1f} s"
            lines = _activity_lines(performance.activities_at(step))
            picture = frames.frame(pictures, title, lines, pictures["global"].shape[0])
            writer.add(picture, REST_FRAMES if step == steps else 1)


def _activity_lines(activities: Sequence[Activity]) -> list[frames.Line]:
    """One line per agent, as in the paper's figure: `Agent_1: grasp barrier at left`; grey while it waits."""
    return [
        frames.Line(
            f"{agent_name(agent)}: {activity.text or 'done'}",
            agent_colour(agent),
            INK if activity.moving else FAINT_INK,
        )
        for agent, activity in enumerate(activities, start=1)
    ]


def _arm_count(task: Task) -> str:
    return "one arm" if len(task.agents) == 1 else f"{len(task.agents)} arms"
