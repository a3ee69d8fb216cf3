"""Sizes of objects: properties of the draws of a seed, and of the task of its scene, for all tasks."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.errors import ArgumentError
from rf_exp.tasks import ObjectSpec, Task, Variation, read_variation
from rf_exp.tasks.assets import load
from rf_exp.tasks.task.variation import draw
from tests.conftest import read_task

INSTANCES = read_variation("instances")
SEEDS = range(4)


def test_scenes_with_other_object_sizes_are_consistent(task: Task) -> None:
    """An object on another one has the same size and still stands on it; flat marks keep their size."""
    varied = replace(task, variation=INSTANCES)
    found = []
    for seed in SEEDS:
        scene, start = varied.in_scene(seed), varied.start(seed)
        for name, spec in scene.objects.items():
            before, now = task.asset(name), scene.asset(name)
            assert now is scene.asset(name) and scene.asset(name) is before.scaled(spec.size)
            if not before.hulls:
                assert spec.size == 1
                continue
            found.append(spec.size)
            assert spec.size == draw(varied, seed).sizes[name]
            np.testing.assert_allclose(now.bounds_m, spec.size * before.bounds_m, atol=1e-12)
            assert now.mass_kg == pytest.approx(spec.size**3 * before.mass_kg)
            for label, point in now.points.items():
                usual_point = before.points[label]
                np.testing.assert_allclose(
                    point.object_from_tcp[:3, 3], spec.size * usual_point.object_from_tcp[:3, 3], atol=1e-12
                )
                assert point.standoff_m == usual_point.standoff_m
                assert point.width_m < 2 * min(robot.model.hand.open_m for robot in task.robots) - 0.01
            lowest_m = now.vertices(start.poses[name])[:, 2].min()
            if spec.stands_on:
                assert spec.size == scene.objects[spec.stands_on].size
                assert spec.z_m == pytest.approx(spec.size * task.objects[name].z_m)
                assert lowest_m > 0.05
            else:
                assert lowest_m == pytest.approx(0, abs=1e-4)
    assert 0.85 <= min(found) < max(found) <= 1.15


def test_sizes_fill_their_range() -> None:
    varied = replace(read_task("stack_cube"), variation=INSTANCES)
    sizes = np.array([[*draw(varied, seed).sizes.values()] for seed in range(100)])
    assert 0.85 <= sizes.min() < 0.86 and 1.14 < sizes.max() <= 1.15
    assert abs(np.corrcoef(sizes.T)[0, 1]) < 0.3  # each object has its own


def test_the_size_is_part_of_the_content_digest() -> None:
    cube = load("cube")
    assert cube.scaled(1.0) is cube and cube.scaled(1.1).content_digest != cube.content_digest
    assert cube.scaled(1.1).content_digest == cube.scaled(1.1).content_digest


def test_a_size_is_in_the_identity_of_a_task() -> None:
    task = read_task("pick_meat")
    other = replace(task, objects={"steak": replace(task.objects["steak"], size=1.1)})
    assert "size" not in task.identity["objects"]["steak"]
    assert other.identity != task.identity
    with pytest.raises(ArgumentError, match=r"size of asset 'cube' is 9; expected 0.5 to 1.5"):
        ObjectSpec("cube", size=9)


@pytest.mark.parametrize("size", [0.85, 1.15])
def test_success_follows_the_sizes(size: float) -> None:
    """A stack of scaled cubes succeeds at its own height, and not at the height of a stack of usual cubes."""
    task = replace(read_task("stack_cube"), variation=Variation("x", object_size=(size, size))).in_scene(0)
    start = task.start(0).scene
    for offset_m, holds in ((0.0, True), ((1 - size) * 0.04, False)):
        pose = start.poses["red"].copy()
        pose[2, 3] += size * 0.04 + offset_m
        scene = replace(start, poses={**start.poses, "blue": pose})
        assert bool(task.module.conditions(scene, start, task)["blue on red"]) is holds
