"""Scene variation: the draws of a seed for each factor, alone and together with the others."""

from dataclasses import fields, replace

import numpy as np
import pytest

from rf_exp.artifacts import drop_defaults
from rf_exp.errors import ArgumentError
from rf_exp.tasks import NO_VARIATION, Task, Variation, read_variation, scene_certificate, scene_draws
from rf_exp.tasks.task.variation import NO_DEVICE_ERRORS, SCENE_KEYS, draw, keys_of
from rf_exp.types import Light, joints_of
from tests.conftest import CONF, experiment, read_task

CHOICES = tuple(sorted(path.stem for path in (CONF / "variation").glob("*.yaml")))
FULL = read_variation("full")
SEEDS = range(100)


def is_part_of_full(name: str) -> bool:
    """Whether a choice is a part of `full`; `calibration` is not compared, as it draws nothing."""
    identity = drop_defaults(read_variation(name).identity, calibration="unknown")
    return identity.items() <= FULL.identity.items() and name not in ("none", "full")


PARTS = tuple(filter(is_part_of_full, CHOICES))


def varied(name: str, variation: str) -> Task:
    return replace(read_task(name), variation=read_variation(variation))


def test_tasks_without_variation_are_unchanged(task: Task) -> None:
    assert (
        task.variation == NO_VARIATION
        and not NO_VARIATION.identity
        and read_variation("none") == NO_VARIATION
    )
    assert task.in_scene(3) is task and task.start(3).devices == NO_DEVICE_ERRORS
    assert scene_draws(task, 3) == {} and scene_certificate(task, 3) == {}
    assert "variation" not in task.identity
    assert not any("turn_deg" in each for each in task.identity["cameras"].values())


@pytest.mark.parametrize("name", CHOICES)
def test_every_choice_is_read_equally_with_and_without_hydra(name: str) -> None:
    everywhere = experiment("task=lift_barrier", f"variation={name}")
    assert everywhere.tasks[0].variation == read_variation(name)
    assert everywhere.evaluated == read_variation(name).held_out and everywhere.evaluated.name == name
    evaluated_only = experiment("task=lift_barrier", f"variation@evaluated={name}")
    assert evaluated_only.tasks[0].variation == NO_VARIATION and evaluated_only.evaluated.name == name


def test_the_choice_full_has_every_factor() -> None:
    assert {*FULL.identity} == {each.name for each in fields(Variation)} - {
        "name",
        "clutter_set",
        "clutter_area_m",
        "calibration",
        *keys_of("one_arm"),
    }


def test_any_arm_may_be_the_delayed_one() -> None:
    task = varied("take_photo", "late_arm")
    late = [draw(task, seed).devices.impaired for seed in SEEDS]
    assert {each.agent for each in late if each is not None} == {*task.agents}
    assert {(each.delay_steps, each.dark) for each in late if each is not None} == {(20, False)}
    certified = scene_certificate(task, 0)["drawn"]["devices"]["impaired"]
    assert certified == scene_draws(task, 0)["devices"]["impaired"] and certified["delay_steps"] == 20
    assert "impaired" not in scene_certificate(varied("take_photo", "full"), 0)["drawn"]["devices"]


@pytest.mark.parametrize("name", PARTS)
def test_draws_of_a_factor_do_not_depend_on_other_factors(name: str) -> None:
    alone, beside = varied("take_photo", name), varied("take_photo", "full")
    varied_count = 0
    for seed in SEEDS:
        own_draws, full_draws = (dict(_flat(draw(each, seed).plain())) for each in (alone, beside))
        defaults = dict(_flat(draw(replace(alone, variation=NO_VARIATION), seed).plain()))
        for key, value in own_draws.items():
            if key.endswith("shift_m.2"):  # a higher table also lowers cameras
                shift_m = full_draws[key] + full_draws["table_height_m"]
                expected = shift_m * bool(alone.variation.camera_position_m)
                assert value + own_draws["table_height_m"] == pytest.approx(expected)
            elif value != defaults.get(key):
                varied_count += 1
                assert value == full_draws[key], key
    assert varied_count >= 50


def _flat(node, at=""):
    """Yields (dotted key, number) pairs of nested values."""
    if isinstance(node, int | float):
        yield at.rstrip("."), node
    elif isinstance(node, dict | list | tuple):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _flat(value, f"{at}{key}.")


def test_draws_fill_their_ranges_and_stay_in_them() -> None:
    task = varied("two_robots_stack_cube", "full")
    drawn = [draw(task, seed) for seed in SEEDS]
    bases = np.array([each.bases for each in drawn])
    shifts = np.array([np.array(camera.shift_m) for each in drawn for camera in each.cameras.values()])
    turns = np.array([np.linalg.norm(camera.turn_deg) for each in drawn for camera in each.cameras.values()])
    heights = np.array([each.table_height_m for each in drawn])
    fovs = np.array([camera.fov_deg for each in drawn for camera in each.cameras.values()])
    for values, bound in (
        (bases[..., :2], 0.02),
        (bases[..., 2], 2.0),
        (shifts[:, :2], 0.05),
        (turns, 5.0),
        (heights, 0.03),
        (fovs, 3.0),
        (np.array([each.posture_rad for each in drawn]), 0.15),
        (np.log2([each.devices.gain for each in drawn]), 0.5),
        (np.rad2deg([each.devices.joint_offset_rad for each in drawn]), 0.5),
        (np.array([[*each.tints.values()] for each in drawn]) - 1, 0.2),
    ):
        assert 0.9 * bound < np.abs(values).max() <= bound
    assert {each.devices.delay_steps for each in drawn} == {0, 1, 2, 3}


def test_textures_of_demonstrations_and_evaluation_differ() -> None:
    assert (FULL.textures, FULL.held_out.textures) == (
        "seen",
        "unseen",
    ) and NO_VARIATION.held_out is NO_VARIATION
    for variation in (FULL, FULL.held_out):
        task = replace(read_task("pick_meat"), variation=replace(variation, clutter=(0, 0)))
        looks = [task.start(seed).look for seed in SEEDS]
        finishes = [each for look in looks for each in (look.table, look.floor, look.walls)]
        textures = [each.texture for each in finishes if each.texture is not None]
        assert {each.set for each in textures} == {variation.textures}
        assert {each.kind for each in textures} == {"wood", "tile", "cloth", "noise", "stripes"}
        assert 0.65 < len(textures) / len(finishes) < 0.85
        assert all((each.colour is None) != (each.texture is None) for each in finishes)


def test_lamps_have_the_configured_numbers_brightness_and_directions() -> None:
    task = varied("lift_barrier", "light")
    lights = [task.start(seed).lamps for seed in SEEDS]
    assert {len(each.lamps) for each in lights} == {1, 2, 3}
    default_light = Light()
    bright = np.array([np.array(each.ambient) / default_light.ambient for each in lights])
    assert 0.75 * 2**-0.7 < bright.min() < 0.55 and 1.7 < bright.max() < 1.25 * 2**0.7
    for each in lights:
        before, now = np.array(default_light.lamps[0].direction), np.array(each.lamps[0].direction)
        turned = np.arccos(before @ now / np.linalg.norm(before) / np.linalg.norm(now))
        assert turned <= np.deg2rad(30) + 1e-9


def test_the_task_of_a_scene_is_a_complete_task(task: Task) -> None:
    """Its arms and cameras are at their sampled poses; objects are at their usual places."""
    varied_task = replace(task, variation=FULL)
    for seed in range(5):
        scene = varied_task.in_scene(seed)
        drawn = draw(varied_task, seed)
        assert scene.in_scene(seed) is scene and varied_task.in_scene(seed) == scene
        assert not any(getattr(scene.variation, name) != getattr(NO_VARIATION, name) for name in SCENE_KEYS)
        for robot, before, (x_m, y_m, yaw_deg) in zip(scene.robots, task.robots, drawn.bases, strict=True):
            moved = robot.world_from_base[:3, 3] - before.world_from_base[:3, 3]
            np.testing.assert_allclose(moved, [x_m, y_m, -drawn.table_height_m], atol=1e-12)
            assert robot.yaw_deg == before.yaw_deg + yaw_deg
        for name, camera in scene.cameras.items():
            draw_of_camera = drawn.cameras[name]
            camera_offset = np.linalg.inv(task.cameras[name].world_from_camera) @ camera.world_from_camera
            turned_deg = np.rad2deg(np.arccos(np.clip((np.trace(camera_offset[:3, :3]) - 1) / 2, -1, 1)))
            assert turned_deg == pytest.approx(np.linalg.norm(draw_of_camera.turn_deg), abs=1e-4)
            shift = camera.world_from_camera[:3, 3] - task.cameras[name].world_from_camera[:3, 3]
            np.testing.assert_allclose(shift, draw_of_camera.shift_m, atol=1e-12)
        start, clean = varied_task.start(seed), task.start(seed)
        assert scene.start(seed).devices == start.devices
        for name, pose in clean.poses.items():
            if task.asset(name).hinge is not None:
                hinge_rad = scene.hinge_rad(name, start.poses)
                np.testing.assert_allclose(hinge_rad, task.hinge_rad(name, clean.poses), atol=1e-9)
                continue
            expected = pose.copy()
            expected[2, 3] *= drawn.sizes[name]
            np.testing.assert_allclose(start.poses[name], expected, atol=1e-12)
        limits = np.array([robot.model.limits_rad for robot in task.robots])
        joints = joints_of(start.qpos)
        assert (limits[:, 0] < joints).all() and (joints < limits[:, 1]).all()


def test_a_scene_is_determined_by_its_seed() -> None:
    task = varied("pick_meat", "full")
    seeds = range(12)
    first = [scene_draws(task, seed) for seed in seeds]
    assert first == [scene_draws(task, seed) for seed in seeds]
    assert len({str(each) for each in first}) == len(seeds)
    certificate = scene_certificate(task, 7)
    assert certificate["drawn"] == first[7]
    scene_task = task.in_scene(7)
    np.testing.assert_array_equal(
        certificate["calibration"]["world_from_base"][0], scene_task.robots[0].world_from_base
    )
    for name, camera in certificate["calibration"]["cameras"].items():
        np.testing.assert_array_equal(camera["parent_from_camera"], scene_task.parent_from_camera(name))
        assert camera["fov_deg"] == scene_task.cameras[name].fov_deg


def test_varied_demonstrations_have_their_own_identity_and_names() -> None:
    clean, changed = read_task("stack_cube"), varied("stack_cube", "full")
    assert changed.identity == {**clean.identity, "variation": FULL.identity}
    one, other = experiment("task=stack_cube"), experiment("task=stack_cube", "variation=bases")
    assert (one.data, other.data) == ("test", "test+bases")
    assert (one.method, other.method) == ("test", "test+bases")
    assert other.policies == "test+bases-50-0"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"base_position_m": -0.1}, "variation.base_position_m is -0.1; expected 0 to 0.2"),
        (
            {"camera_direction_deg": (5, 3)},
            "variation.camera_direction_deg is [5, 3]; expected [LOW, HIGH] within [0.0, 45.0]",
        ),
        ({"camera_fov_deg": 90}, "variation.camera_fov_deg is 90; expected 0 to 20"),
        ({"textures": "new"}, "unknown variation.textures 'new'; available: plain, seen, unseen"),
        ({"lamps": (1, 9)}, "variation.lamps is [1, 9]; expected [LOW, HIGH] within [0, 3]"),
        ({"flicker": 2}, "variation.flicker is 2; expected 0 to 1"),
        ({"delay_s": (0.2, 0.1)}, "variation.delay_s is [0.2, 0.1]; expected [LOW, HIGH] within [0.0, 1.0]"),
        (
            {"table_height_m": (0.0, 3.0)},
            "variation.table_height_m is [0.0, 3.0]; expected [LOW, HIGH] within [-0.1, 0.1]",
        ),
        ({"pixel_noise": float("nan")}, "variation.pixel_noise is nan; expected 0 to 100"),
    ],
)
def test_an_impossible_range_is_reported(changes, said) -> None:
    with pytest.raises(ArgumentError) as error:
        Variation(**changes)
    assert str(error.value) == said


def test_an_unknown_choice_is_reported() -> None:
    with pytest.raises(ArgumentError, match="unknown variation 'wild'; available: appearance, bases"):
        read_variation("wild")
