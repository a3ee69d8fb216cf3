"""Figures of plans: coordination diagrams and timelines."""

import numpy as np
import pytest

from rf_exp.types import Schedule
from rf_exp.viz import VIOLATED
from rf_exp.viz.figures import coordination, coordination_size_px, timeline
from rf_exp.viz.layout import OBJECT, ORDERED, PRIMITIVES, WAITS, primitive_colour
from tests.viz.recorded import POSES, QPOS, TIMED, TWO, Content, motionless, open_recorder


def colour_at(picture: np.ndarray, pixel: np.ndarray) -> tuple[int, ...]:
    column, row = np.floor(pixel).astype(int)
    return tuple(picture[row, column].tolist())


def test_diagrams_show_forbidden_cells_and_the_schedule():
    forbidden, ordered = np.zeros((31, 21), bool), np.zeros((31, 21), bool)
    forbidden[24:29, 3:8], ordered[2:7, 12:18] = True, True
    diagrams = coordination(TWO, TIMED, {(1, 2): forbidden}, {(1, 2): ordered})
    assert diagrams.pairs == ((1, 2),)
    assert diagrams.picture.shape[1::-1] == coordination_size_px(1)

    def colour_of(i: int, j: int) -> tuple[int, ...]:
        [pixel] = diagrams.at(np.array([i, j]))
        return colour_at(diagrams.picture, pixel)

    assert colour_of(26, 5) == VIOLATED
    assert colour_of(4, 15) == ORDERED
    assert colour_of(5, 0) == colour_of(20, 10) == (255, 255, 255)  # the schedule
    assert colour_of(5, 26 % 21) != VIOLATED  # the axes are not swapped


def test_every_pair_has_its_own_diagram():
    three = (*TWO, motionless(3, ("lift", 40)))
    positions = np.column_stack([np.minimum(np.arange(41), 30), np.minimum(np.arange(41), 20), np.arange(41)])
    pairs = ((1, 2), (1, 3), (2, 3))
    forbidden = {(i, j): np.zeros((len(three[i - 1]) + 1, len(three[j - 1]) + 1), bool) for i, j in pairs}
    forbidden[2, 3][15:20, 0:6] = True
    diagrams = coordination(three, Schedule(positions, 40), forbidden, {})
    pixels = diagrams.at(np.array([17, 17, 3]))
    hits = [colour_at(diagrams.picture, pixel) == VIOLATED for pixel in pixels]
    assert diagrams.pairs == pairs
    assert hits == [False, False, True]


@pytest.mark.slow
def test_the_timeline_shows_motion_and_waiting():
    picture = timeline(TWO, TIMED)
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert {PRIMITIVES["approach"], PRIMITIVES["close"], WAITS} <= colours
    assert PRIMITIVES["lift"] not in colours
    legend = picture.shape[0] // 4  # above the rows
    waiting = (picture[legend:] == WAITS).all(axis=-1).any(axis=0)
    # Agent 2 waits 10 of 30 steps, which take nine tenths of the width.
    assert 0.25 < waiting.sum() / picture.shape[1] < 0.4


def test_an_agent_without_segments_has_its_own_lane():
    positions = np.column_stack([TIMED.positions, np.zeros(len(TIMED.positions), int)])
    picture = timeline((*TWO, motionless(3)), Schedule(positions, TIMED.makespan_bound))
    assert picture.shape[0] > timeline(TWO, TIMED).shape[0]


def test_a_primitive_without_a_colour_is_grey():
    assert primitive_colour("juggle") == OBJECT


def test_the_point_in_the_diagram_moves_with_the_plan(path):
    with open_recorder(path) as recorder:
        recorder.path_positions(np.array([0, 0]))  # nothing to show without a plan
        recorder.coordination(TWO, TIMED, {(1, 2): np.zeros((31, 21), bool)}, {})
        for step in range(3):
            recorder.step(step, poses=POSES, qpos=QPOS)
            recorder.path_positions(TIMED.positions[10 + step])
    content = Content(path)
    assert len(content.column("/plan/diagrams", "EncodedImage:blob")) == 1
    pixels = np.array(content.column("/plan/diagrams/now", "Points2D:positions"))[:, 0]
    assert content.steps("/plan/diagrams/now", "Points2D:positions") == [0, 1, 2]
    right, down = np.diff(pixels, axis=0).T
    assert (right > 0).all() and (down < 0).all()  # both agents advance
