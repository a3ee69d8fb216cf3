"""What the cameras of an environment show: the suite's pictures, depth that fits, bodies by their names."""

from dataclasses import replace

import numpy as np
import pytest

from rf_exp.envs import Observations, parallel_env
from rf_exp.envs.central import CentralEnv
from rf_exp.sim import Simulator
from rf_exp.types import CameraChoice

pytestmark = pytest.mark.render
ALL = Observations(pictures=True, depth=True, segmentation=True, width=160, height=120)


@pytest.mark.slow
def test_pictures_are_those_of_the_simulator() -> None:
    env = CentralEnv("lift_barrier", ALL, render_mode="rgb_array")
    observed, _ = env.reset(seed=2)
    with Simulator(env.task, width_px=160, height_px=120) as world:
        world.reset(2)
        for camera, picture in world.images().items():
            np.testing.assert_array_equal(observed[f"rgb_{camera}"], picture)
        for camera, depth_m in world.depth().items():
            np.testing.assert_array_equal(observed[f"depth_{camera}"], depth_m)
    np.testing.assert_array_equal(env.render(), observed["rgb_global"])
    env.close()


def test_segmentation_tells_every_body_by_its_name() -> None:
    env = CentralEnv("lift_barrier", ALL)
    assert env.labels == ("nothing", "table", "barrier", "agent1", "agent2")
    for seed in (0, 1):
        observed, _ = env.reset(seed=seed)
        image, depth_m = observed["segmentation_global"], observed["depth_global"]
        assert set(np.unique(image)) - {0} == {1, 2, 3, 4}
        assert (depth_m[image > 0] > 0.3).all() and np.median(depth_m[image == 2]) < np.median(
            depth_m[image == 1]
        )
    env.close()


def test_an_agent_looks_through_its_own_camera_and_the_common_one() -> None:
    env = CentralEnv("lift_barrier", ALL)
    observed, _ = env.reset(seed=0)
    env.close()
    looks: list[tuple[CameraChoice, set[str]]] = [
        ("all", {"global", "local"}),
        ("local", {"local"}),
        ("global", {"global"}),
    ]
    for cameras, names in looks:
        seen = Observations("none", pictures=True, cameras=cameras, width=160, height=120)
        several = parallel_env("lift_barrier", seen)
        own, _ = several.reset(seed=0)
        assert set(own["agent2"]) == {f"rgb_{name}" for name in names}
        if "local" in names:
            np.testing.assert_array_equal(own["agent2"]["rgb_local"], observed["rgb_agent2"])
        several.close()


def test_the_calibration_says_where_in_a_picture_things_are() -> None:
    seen = replace(ALL, calibration=True)
    found = {}
    for variation in ("none", "cameras", "cameras_unknown"):
        env = CentralEnv("lift_barrier", seen, variation=variation)
        observed, _ = env.reset(seed=3)
        env.close()
        assert env.observation_space.contains(observed)
        point = np.linalg.inv(observed["world_from_camera_agent2"]) @ [*observed["pose_barrier"][:3], 1]
        pixel = observed["intrinsics_agent2"] @ point[:3] / point[2]
        rows, columns = np.nonzero(observed["segmentation_agent2"] == env.labels.index("barrier"))
        off = np.linalg.norm(pixel[:2] - [columns.mean(), rows.mean()])
        found[variation] = observed
        assert off < 10 if variation != "cameras_unknown" else off > 10, off
    usual, unknown = found["none"], found["cameras_unknown"]
    for key in (key for key in usual if key.startswith(("world_from", "intrinsics"))):
        np.testing.assert_array_equal(unknown[key], usual[key])  # nobody knows better
    assert (found["cameras"]["world_from_camera_global"] != usual["world_from_camera_global"]).any()


def test_an_agent_is_told_of_its_own_base_first() -> None:
    seen = Observations("none", pictures=True, calibration=True, width=32, height=24)
    env, several = CentralEnv("lift_barrier", seen), parallel_env("lift_barrier", seen)
    observed, _ = env.reset(seed=0)
    own, _ = several.reset(seed=0)
    for agent, order in (("agent1", [0, 1]), ("agent2", [1, 0])):
        np.testing.assert_array_equal(own[agent]["world_from_base"], observed["world_from_base"][order])
        for kind in ("world_from_camera", "intrinsics"):
            np.testing.assert_array_equal(own[agent][f"{kind}_local"], observed[f"{kind}_{agent}"])
    env.close()
    several.close()
