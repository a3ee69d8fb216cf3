"""Our shaders draw what ManiSkill's minimal pack draws."""

import numpy as np
import pytest
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS

from rf_exp.sim import Simulator, environment
from rf_exp.sim.shading import LIKE, SHADERS
from rf_exp.tasks import CONFIGURED, read_task

TASKS = ("camera_alignment", "place_food", "take_photo")  # a metallic lens, a pot, four arms
OTHERWISE_ROUNDED = 10  # pixels of 76,800 that may differ, by one shade


def _seen(name: str) -> tuple[dict, dict, dict]:
    with Simulator(read_task(CONFIGURED / f"{name}.yaml"), width_px=320, height_px=240) as simulator:
        simulator.reset(5)
        depth, bodies = simulator.depth(), simulator.segmentation()
        return simulator.images(), depth, bodies


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_pictures_depth_and_segmentation_are_those_of_the_minimal_pack(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, depth, bodies = _seen(name)
    monkeypatch.setattr(environment, "shader_config", lambda: PREBUILT_SHADER_CONFIGS[LIKE])
    stock, stock_depth, stock_bodies = _seen(name)
    for camera, picture in ours.items():
        apart = np.abs(picture.astype(int) - stock[camera]).max(axis=-1)
        assert picture.std() > 10, "a picture with something on it"
        assert apart.max() <= 1
        assert (apart > 0).sum() <= OTHERWISE_ROUNDED
        np.testing.assert_array_equal(depth[camera], stock_depth[camera])
        np.testing.assert_array_equal(bodies[camera], stock_bodies[camera])


def test_each_scene_is_drawn_by_our_shaders() -> None:
    assert environment.shader_config().shader_pack == str(SHADERS)
    assert {path.name for path in SHADERS.iterdir()} == {"gbuffer.vert", "gbuffer.frag"}
