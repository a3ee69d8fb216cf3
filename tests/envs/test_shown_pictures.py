"""What the cameras of an environment show: the suite's pictures, depth that fits, bodies by their names."""

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
