"""The activity per step and the spans of segments of a schedule agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rf_exp.types import Schedule, activity, spans
from tests.constraints.robots import REST, idle, walk

LENGTHS = st.lists(
    st.tuples(st.integers(1, 5), st.integers(0, 4)), min_size=1, max_size=4
)  # (steps, wait before them)


@given(LENGTHS, st.integers(0, 3))
def test_steps_and_spans_agree(parts: list[tuple[int, int]], after: int) -> None:
    """For an agent that waits before each segment, and at the end while other agents continue."""
    trajectory = walk(1, [REST + 0.1 * k for k in range(len(parts) + 1)], [steps for steps, _ in parts])
    moves = [moving for steps, wait in parts for moving in [0] * wait + [1] * steps] + [0] * after
    schedule = Schedule(np.cumsum([0, *moves])[:, None], 0)
    segment_spans = spans(trajectory, schedule)
    for step, moving in enumerate(moves, start=1):
        current = activity(trajectory, schedule, step)
        assert current.moves == bool(moving)
        active = [span.segment for span in segment_spans if span.begins < step <= span.ends]
        assert active == ([current.segment] if moving else [])
        waits_for = next((span.segment for span in segment_spans if span.begins >= step), None)
        assert moving or current.segment is waits_for
    assert activity(trajectory, schedule, len(moves) + 1) == activity(trajectory, schedule, len(moves) + 9)
    assert not activity(trajectory, schedule, len(moves) + 1).moves
    assert segment_spans[-1].ends == len(moves) - after


def test_an_agent_without_segments_does_nothing() -> None:
    schedule = Schedule(np.zeros((5, 1), dtype=int), 0)
    assert spans(idle(1), schedule) == ()
    assert all(activity(idle(1), schedule, step).segment is None for step in range(1, 7))


@pytest.mark.parametrize(("position", "number"), [(0, 0), (3, 0), (4, 1), (5, 1), (9, 1)])
def test_a_segment_owns_the_positions_up_to_its_end(position: int, number: int) -> None:
    trajectory = walk(1, [REST, REST + 0.1, REST], [3, 2])
    assert trajectory.segment_at(position) is trajectory.segments[number]
