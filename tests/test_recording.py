"""The recording of a real episode agrees with the plan, the checks and the grippers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rf_exp.constraints import Evidence
from rf_exp.datagen import EpisodeGenerator, Outcome, Planned, Settings
from rf_exp.datagen.brain import FaultySpec, ScriptedSpec
from rf_exp.findings import Cause, CheckName, Finding, Violation
from rf_exp.geometry import PlanningScene, centres_m
from rf_exp.perception import occupied_voxels
from rf_exp.recording import EpisodeRecorder, check_result, order_masks
from rf_exp.robots import DEFAULT, Arm
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import Variation
from rf_exp.types import ConstraintSet, Scene
from tests.conftest import read_task
from tests.viz.recorded import Content

pytestmark = pytest.mark.slow  # whole episodes
FULL = ConstraintSet("full")
CLUTTER = Variation("clutter", clutter=(3, 8))


class RecorderWithPlans(EpisodeRecorder):
    """A recorder that also keeps the plans and the last scene."""

    plans: list[tuple[int, Planned]]
    seen: Scene
    ended: int

    def planned(self, plan: Planned) -> None:
        self.plans.append((self.seen.step + 1 if self.plans else 0, plan))
        super().planned(plan)

    def stepped(self, scene, action, pictures) -> None:
        self.seen = scene
        super().stepped(scene, action, pictures)


@pytest.fixture(scope="module")
def episode(tmp_path_factory) -> tuple[Content, RecorderWithPlans, Outcome]:
    """Place Food with one mistake of the brain, and an artificial violation at the end."""
    path = tmp_path_factory.mktemp("recording") / "generate-0.rrd"
    task = read_task("place_food")
    with (
        Simulator(task, render=False) as world,
        RecorderWithPlans(path, task, world, "Place Food") as recorder,
    ):
        recorder.plans = []
        settings = Settings.configured(task, FULL, FaultySpec("wrong_direction"))
        outcome = EpisodeGenerator(settings, world, settings.make_brain(0), recorder).make(0)
        values = {
            "value": 0.2,
            "bound": 0.15,
            "unit": "rad",
            "time_s": 7.0,
            "agents": (2,),
            "doing": (None,),
        }
        labels = {"check": CheckName.TRACKING, "cause": Cause.TRACKING, "finding": Finding.STRAYED}
        recorder.rejected(Violation(**labels, **values))
    return Content(path), recorder, outcome


def test_a_check_is_shown_with_its_own_unit():
    class ValidateNoise:
        kind, name, unit = "spatial", CheckName.OCCUPANCY, "dB"
        agents, text = (1,), "Agent_1 must be quiet."

        def planned(self, plan):
            raise AssertionError

        measured = planned

    noise: Any = ValidateNoise()
    shown = check_result(noise, Evidence(ok=False, value=61.0, bound=40.0, time_s=1.5, agents=(1,)))
    assert (shown.unit, shown.value, shown.ok) == ("dB", 61.0, False)


def test_the_lane_of_an_agent_shows_its_schedule(episode):
    content, recorder, outcome = episode
    assert outcome.success
    for agent in (1, 2):
        lane = f"/motions/agent{agent}"
        states = [state for row in content.column(lane, "StateChange:state") for state in row]
        changes = dict(zip(content.steps(lane, "StateChange:state"), states, strict=True))
        shown, state = [], ""
        for step in range(outcome.steps):
            state = changes.get(step, state)
            shown.append(state)
        [(begin, plan)] = recorder.plans
        moves = np.diff(plan.schedule.positions[:, agent - 1]) > 0
        shown_moving = [state not in ("", "waits") for state in shown[begin:-1]]  # stopped in the last step
        assert len(shown_moving) > 100
        assert shown_moving == moves[: len(shown_moving)].tolist()
    waiting = content.column("/motions/agent1", "StateConfiguration:values")[-1]
    assert "waits" in waiting  # until the lid is lifted
    assert "lower: place steak to pot at inside" in waiting


def test_every_check_is_listed_with_its_value(episode):
    content, recorder, _ = episode
    [(_, plan)] = recorder.plans
    [document] = content.column("/plan/checks", "TextDocument:text")[-1]
    for check, evidence in zip(plan.checked.checks, plan.checked.evidence, strict=True):
        assert f"`{check!r}`" in document
        assert evidence.sentence in document
    assert "| holds | `VD(Agent_1, steak, perpendicular)` | 0 deg | 10 deg |" in document
    assert f"all {len(plan.checked.evidence)} checks hold" in document
    [proposal] = content.column("/plan/proposals", "TextDocument:text")[-1]
    assert all(constraint.sentence in proposal for constraint in plan.proposal.constraints)


def test_the_first_mistake_is_logged_before_the_first_motion(episode):
    content, _, outcome = episode
    assert outcome.attempts == 2
    lane = "/checks/ValidateDirection"
    assert content.steps(lane, "StateChange:state")[0] == 0
    assert "90 deg off the horizontal at steak" in content.texts(lane)[0]
    states = [state for row in content.column(lane, "StateChange:state") for state in row]
    assert states == ["violated", ""]  # corrected by the next proposal


def test_a_violation_is_marked_at_the_gripper_of_its_agent(episode):
    content, recorder, _ = episode
    task = read_task("place_food")
    tcp = Arm(DEFAULT, task.robots[1].world_from_base).tcp(recorder.seen.qpos[1, :7])[:3, 3]
    [marker] = content.column("/world/violations", "Points3D:positions")[-1]
    np.testing.assert_allclose(marker, tcp, atol=1e-6)
    assert content.column("/world/violations", "Points3D:labels")[-1] == ["Tracking"]
    assert content.column("/motions/agent2", "StateChange:state")[-1] == [""]


def test_the_diagram_shows_the_positions_of_every_step(episode):
    content, recorder, outcome = episode
    [(_, plan)] = recorder.plans
    assert len(content.column("/plan/diagrams", "EncodedImage:blob")) == 1
    pixels = np.array(content.column("/plan/diagrams/now", "Points2D:positions"))[:, 0]
    executed = plan.schedule.positions[1 : 1 + len(pixels)]
    np.testing.assert_allclose(  # pixels are proportional to positions: right for agent 1, up for agent 2
        (pixels - pixels[0]) / (pixels[30] - pixels[0]),
        (executed - executed[0]) / (executed[30] - executed[0]),
        atol=1e-3,
    )
    assert len(pixels) == outcome.steps
    # The schedule avoids the forbidden cells of its diagram.
    [(pair, order_mask)] = order_masks(plan.checker, plan.checked.plan.paths).items()
    assert pair == (1, 2)
    assert order_mask.any()
    assert not (order_mask | plan.checked.plan.paths.diagrams[pair])[tuple(plan.schedule.positions.T)].any()


def test_occupancy_moves_with_the_arm_and_its_held_object(episode):
    content, _, _ = episode
    voxels = content.column("/world/occupancy/agent2", "Boxes3D:centers")
    assert len({len(row) for row in voxels}) > 1
    # A held object belongs to the voxels of the arm.
    assert content.steps("/world/occupancy/lid", "Clear:is_recursive")
    assert content.steps("/world/occupancy/lid", "Boxes3D:centers")[-1] > 100  # after it was put down


@pytest.mark.render
def test_occupancy_from_depth_is_shown(tmp_path):
    path, task = tmp_path / "generate-0.rrd", read_task("pick_meat")
    with Simulator(task) as world:
        occupied = occupied_voxels(world.depth(), world.camera_models(), PlanningScene(task, world.reset(0)))
        with EpisodeRecorder(path, task, world, "Pick Meat") as recorder:
            settings = Settings.configured(task, FULL, ScriptedSpec(), occupancy="depth")
            assert (
                EpisodeGenerator(settings, CameraSubset(world), settings.make_brain(0), recorder)
                .make(0)
                .success
            )
    content = Content(path)
    first = content.column("/world/occupancy/cameras", "Boxes3D:centers")[0]
    np.testing.assert_allclose(first, centres_m(occupied), atol=1e-6)
    assert content.steps("/world/occupancy/cameras", "Boxes3D:centers")[0] == 0
    assert len(content.steps("/world/occupancy/agent1", "Boxes3D:centers")) > 10


def test_clutter_of_the_scene_is_shown(tmp_path):
    path, task = tmp_path / "generate-0.rrd", replace(read_task("pick_meat"), variation=CLUTTER)
    with Simulator(task, render=False) as world:
        scene = world.reset(0)
        with EpisodeRecorder(path, world.task, world, "Pick Meat") as recorder:
            recorder.record_scene(scene)
    content = Content(path)
    assert 3 <= len(scene.clutter) <= 8
    for name, pose in scene.clutter.items():
        (boxes,) = content.column(f"/world/occupancy/{name}", "Boxes3D:centers")
        error_m = np.linalg.norm(np.array(list(boxes))[:, :2].mean(axis=0) - pose[:2, 3])
        assert error_m < 0.02
