"""Camera observations of the environments: pictures, depth, segmentation and calibration."""

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
def test_pictures_equal_those_of_the_simulator() -> None:
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


def test_segmentation_labels_every_body() -> None:
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


def test_agents_observe_their_local_and_the_global_camera() -> None:
    env = CentralEnv("lift_barrier", ALL)
    observed, _ = env.reset(seed=0)
    env.close()
    choices: list[tuple[CameraChoice, set[str]]] = [
        ("all", {"global", "local"}),
        ("local", {"local"}),
        ("global", {"global"}),
    ]
    for cameras, names in choices:
        observations = Observations("none", pictures=True, cameras=cameras, width=160, height=120)
        parallel = parallel_env("lift_barrier", observations)
        per_agent, _ = parallel.reset(seed=0)
        assert set(per_agent["agent2"]) == {f"rgb_{name}" for name in names}
        if "local" in names:
            np.testing.assert_array_equal(per_agent["agent2"]["rgb_local"], observed["rgb_agent2"])
        parallel.close()


def test_the_calibration_projects_objects_into_pictures() -> None:
    observations = replace(ALL, calibration=True)
    observed_in = {}
    for variation in ("none", "cameras", "cameras_unknown"):
        env = CentralEnv("lift_barrier", observations, variation=variation)
        observed, _ = env.reset(seed=3)
        env.close()
        assert env.observation_space.contains(observed)
        point = np.linalg.inv(observed["world_from_camera_agent2"]) @ [*observed["pose_barrier"][:3], 1]
        pixel = observed["intrinsics_agent2"] @ point[:3] / point[2]
        rows, columns = np.nonzero(observed["segmentation_agent2"] == env.labels.index("barrier"))
        error_px = np.linalg.norm(pixel[:2] - [columns.mean(), rows.mean()])
        observed_in[variation] = observed
        assert error_px < 10 if variation != "cameras_unknown" else error_px > 10, error_px
    nominal, unknown = observed_in["none"], observed_in["cameras_unknown"]
    for key in (key for key in nominal if key.startswith(("world_from", "intrinsics"))):
        np.testing.assert_array_equal(unknown[key], nominal[key])  # the true pose is unknown
    assert (observed_in["cameras"]["world_from_camera_global"] != nominal["world_from_camera_global"]).any()


def test_the_base_of_the_own_agent_comes_first() -> None:
    observations = Observations("none", pictures=True, calibration=True, width=32, height=24)
    env, parallel = CentralEnv("lift_barrier", observations), parallel_env("lift_barrier", observations)
    observed, _ = env.reset(seed=0)
    per_agent, _ = parallel.reset(seed=0)
    for agent, order in (("agent1", [0, 1]), ("agent2", [1, 0])):
        np.testing.assert_array_equal(per_agent[agent]["world_from_base"], observed["world_from_base"][order])
        for kind in ("world_from_camera", "intrinsics"):
            np.testing.assert_array_equal(per_agent[agent][f"{kind}_local"], observed[f"{kind}_{agent}"])
    env.close()
    parallel.close()
