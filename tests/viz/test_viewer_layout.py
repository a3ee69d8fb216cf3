"""The viewer's layout is in the file, and none of its views is empty."""

from pathlib import Path

import numpy as np
import pytest

from rf_exp.statements import Proposal
from rf_exp.texts.markdown import Markdown
from tests.viz.recorded import (
    ACTION,
    CAMERAS,
    PICTURE,
    POSES,
    QPOS,
    RESULTS,
    TIMED,
    TWO,
    Content,
    open_recorder,
)


def test_the_layout_of_a_rollout_is_in_the_file_and_its_views_have_data(path):
    with open_recorder(path, panels="rollout") as recorder:
        recorder.step(
            0, poses=POSES, qpos=QPOS, action=ACTION, pictures={"global": PICTURE, "agent1": PICTURE}
        )
        recorder.predicted_targets(1, 1, ACTION[:1])
        recorder.condition("up", False, "up: not yet")
        recorder.margin("up", 0.1)
        recorder.distance(1, 2, 0.3)
        recorder.contact("agent 1 on barrier", 3.0)
        recorder.judgement(Markdown("so far"))
    origins, names, classes = layout(path)
    assert classes.count("2D") == len(CAMERAS) + legends(names, classes)  # no diagrams
    assert {"conditions over time", "distance of arms (cm)", "contacts (N)", "verdict"} <= set(names)
    recorded = Content(path).batches
    for origin in origins:
        assert any(entity.startswith(f"/{origin.strip('/')}") for entity in recorded), origin


def legends(names: list[str], classes: list[str]) -> int:
    """The number of legends, one for each view with curves."""
    assert names.count("legend") == classes.count("TimeSeries") > 0
    return names.count("legend")


def test_a_legend_names_each_curve_once(path):
    with open_recorder(path, panels="rollout") as recorder:
        recorder.step(0, poses=POSES, qpos=QPOS, action=ACTION)
        recorder.predicted_targets(1, 1, ACTION[:1])
        recorder.predicted_targets(1, 1, ACTION[:1])
        recorder.distance(1, 2, 0.3)
        recorder.distance(1, 2, 0.2)
    content = Content(path)
    joints, distances = (
        content.column(f"/legends/{group}", "Points2D:labels")[-1]
        for group in ("joints/agent1", "arms/distances")
    )
    assert joints == [*(f"q{joint}" for joint in range(1, 8)), "thin: target", "dots: predicted"]
    assert distances == ["agents 1 and 2"]


def layout(path: Path) -> tuple[list[str], list[str], list[str]]:
    """Origins, names and classes of the views in the layout of a file."""
    [entry] = Content(path).blueprints
    content = Content(path, entry)
    views = [entity for entity in content.batches if entity.startswith("/view/") and entity.count("/") == 2]
    fields = ("space_origin", "display_name", "class_identifier")
    origins, names, classes = (
        [row[0] for view in views for row in content.column(view, f"ViewBlueprint:{name}")] for name in fields
    )
    return origins, names, classes


@pytest.mark.parametrize("cameras", [CAMERAS, {}], ids=["rendered", "without pictures"])
def test_the_layout_is_in_the_file(path, cameras):
    with open_recorder(path, cameras=cameras) as recorder:
        recorder.step(0, poses=POSES, qpos=QPOS)
        recorder.proposal(Proposal((), ()))
        recorder.plan_checks(RESULTS)
        recorder.motion(1, "home", "move")
        recorder.coordination(TWO, TIMED, {(1, 2): np.zeros((31, 21), bool)}, {})
    origins, names, classes = layout(path)
    assert classes.count("2D") == len(cameras) + legends(names, classes) + 1  # plus the diagrams
    assert classes.count("3D") == 2  # with and without occupancy
    assert {"agent 1 joints (rad)", "agent 2 joints (rad)", "grippers (mm open)", "log"} <= set(names)
    recorded = Content(path).batches
    for origin in origins:  # views of unwritten entities would be empty
        assert any(entity.startswith(f"/{origin.strip('/')}") for entity in recorded), origin
