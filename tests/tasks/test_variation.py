"""Scenes that differ: what a seed draws of each factor, alone and beside the others."""

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


def of_full(name: str) -> bool:
    """Whether a choice is a part of `full`; whether policies are told of it draws nothing."""
    said = drop_defaults(read_variation(name).identity, calibration="unknown")
    return said.items() <= FULL.identity.items() and name not in ("none", "full")


PARTS = tuple(filter(of_full, CHOICES))


def varied(name: str, how: str) -> Task:
    return replace(read_task(name), variation=read_variation(how))


def test_the_clean_world_stays_as_it_was(task: Task) -> None:
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
def test_every_choice_is_read_alike_with_and_without_hydra(name: str) -> None:
    asked = experiment("task=lift_barrier", f"variation={name}")
    assert asked.tasks[0].variation == read_variation(name)
    assert asked.evaluated == read_variation(name).held_out and asked.evaluated.name == name
    apart = experiment("task=lift_barrier", f"variation@evaluated={name}")
    assert apart.tasks[0].variation == NO_VARIATION and apart.evaluated.name == name


def test_the_choice_full_has_every_factor() -> None:
    assert {*FULL.identity} == {each.name for each in fields(Variation)} - {
        "name",
        "clutter_set",
        "clutter_area_m",
        "calibration",
        *keys_of("one_arm"),
    }


def test_any_arm_may_be_the_one_that_is_late() -> None:
    task = varied("take_photo", "late_arm")
    late = [draw(task, seed).devices.impaired for seed in SEEDS]
    assert {each.agent for each in late if each is not None} == {*task.agents}
    assert {(each.delay_steps, each.dark) for each in late if each is not None} == {(20, False)}
    said = scene_certificate(task, 0)["drawn"]["devices"]["impaired"]
    assert said == scene_draws(task, 0)["devices"]["impaired"] and said["delay_steps"] == 20
    assert "impaired" not in scene_certificate(varied("take_photo", "full"), 0)["drawn"]["devices"]


@pytest.mark.parametrize("name", PARTS)
def test_one_factor_draws_alone_what_it_draws_beside_the_others(name: str) -> None:
    alone, beside = varied("take_photo", name), varied("take_photo", "full")
    differ = 0
    for seed in SEEDS:
        one, others = (dict(_flat(draw(each, seed).plain())) for each in (alone, beside))
        nothing = dict(_flat(draw(replace(alone, variation=NO_VARIATION), seed).plain()))
        for key, value in one.items():
            if key.endswith("shift_m.2"):  # a table that is higher lowers cameras too
                shift_m = others[key] + others["table_height_m"]
                expected = shift_m * bool(alone.variation.camera_position_m)
                assert value + one["table_height_m"] == pytest.approx(expected)
            elif value != nothing.get(key):
                differ += 1
                assert value == others[key], key
    assert differ >= 50


def _flat(node, at=""):
    """Dotted key -> number."""
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
    for values, most in (
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
        assert 0.9 * most < np.abs(values).max() <= most
    assert {each.devices.delay_steps for each in drawn} == {0, 1, 2, 3}


def test_what_demonstrations_show_is_not_what_evaluation_shows() -> None:
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


def test_lamps_are_as_many_as_bright_and_as_coloured_as_asked_for() -> None:
    task = varied("lift_barrier", "light")
    lights = [task.start(seed).lamps for seed in SEEDS]
    assert {len(each.lamps) for each in lights} == {1, 2, 3}
    usual = Light()
    bright = np.array([np.array(each.ambient) / usual.ambient for each in lights])
    assert 0.75 * 2**-0.7 < bright.min() < 0.55 and 1.7 < bright.max() < 1.25 * 2**0.7
    for each in lights:
        before, now = np.array(usual.lamps[0].direction), np.array(each.lamps[0].direction)
        turned = np.arccos(before @ now / np.linalg.norm(before) / np.linalg.norm(now))
        assert turned <= np.deg2rad(30) + 1e-9


def test_a_scene_of_a_task_is_a_task(task: Task) -> None:
    """Its arms and cameras are where the seed has drawn them; things lie where they always do."""
    usual = replace(task, variation=FULL)
    for seed in range(5):
        scene = usual.in_scene(seed)
        drawn = draw(usual, seed)
        assert scene.in_scene(seed) is scene and usual.in_scene(seed) == scene
        assert not any(getattr(scene.variation, name) != getattr(NO_VARIATION, name) for name in SCENE_KEYS)
        for robot, before, (x_m, y_m, yaw_deg) in zip(scene.robots, task.robots, drawn.bases, strict=True):
            moved = robot.world_from_base[:3, 3] - before.world_from_base[:3, 3]
            np.testing.assert_allclose(moved, [x_m, y_m, -drawn.table_height_m], atol=1e-12)
            assert robot.yaw_deg == before.yaw_deg + yaw_deg
        for name, camera in scene.cameras.items():
            by = drawn.cameras[name]
            off = np.linalg.inv(task.cameras[name].world_from_camera) @ camera.world_from_camera
            turned_deg = np.rad2deg(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1)))
            assert turned_deg == pytest.approx(np.linalg.norm(by.turn_deg), abs=1e-4)
            shift = camera.world_from_camera[:3, 3] - task.cameras[name].world_from_camera[:3, 3]
            np.testing.assert_allclose(shift, by.shift_m, atol=1e-12)
        start, clean = usual.start(seed), task.start(seed)
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


def test_a_scene_is_drawn_by_its_seed_alone() -> None:
    task = varied("pick_meat", "full")
    seeds = range(12)
    first = [scene_draws(task, seed) for seed in seeds]
    assert first == [scene_draws(task, seed) for seed in seeds]
    assert len({str(each) for each in first}) == len(seeds)
    said = scene_certificate(task, 7)
    assert said["drawn"] == first[7]
    stands = task.in_scene(7)
    np.testing.assert_array_equal(said["calibration"]["world_from_base"][0], stands.robots[0].world_from_base)
    for name, camera in said["calibration"]["cameras"].items():
        np.testing.assert_array_equal(camera["parent_from_camera"], stands.parent_from_camera(name))
        assert camera["fov_deg"] == stands.cameras[name].fov_deg


def test_demonstrations_of_scenes_that_differ_are_others() -> None:
    clean, wild = read_task("stack_cube"), varied("stack_cube", "full")
    assert wild.identity == {**clean.identity, "variation": FULL.identity}
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
def test_a_range_that_is_not_possible_is_told(changes, said) -> None:
    with pytest.raises(ArgumentError) as error:
        Variation(**changes)
    assert str(error.value) == said


def test_a_choice_that_is_not_there_is_told() -> None:
    with pytest.raises(ArgumentError, match="unknown variation 'wild'; available: appearance, bases"):
        read_variation("wild")
