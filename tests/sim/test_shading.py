"""Our shaders render the same pictures as ManiSkill's minimal pack, and textures in addition."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS

from rf_exp.sim import Simulator, environment, objects
from rf_exp.sim.environment import BASE_SHADER_PACK, SHADERS
from rf_exp.tasks import CONFIGURED, Task, assets, read_task
from rf_exp.types import DEFAULT_FINISH, Finish, Lamp, Light, Look, Texture, TextureKind

TASKS = ("camera_alignment", "place_food", "take_photo")  # a metallic lens, a pot, four arms
START = Task.start  # the original, for tests that patch it
ROUNDED_PIXELS = 10  # of 76,800 pixels, may differ by one level
TEXTURES = [Finish(texture=Texture(kind, "seen", 5, 0.6)) for kind in get_args(TextureKind)]


def _render(name: str) -> tuple[dict, dict, dict]:
    with Simulator(read_task(CONFIGURED / f"{name}.yaml"), width_px=320, height_px=240) as simulator:
        simulator.reset(5)
        depth, bodies = simulator.depth(), simulator.segmentation()
        return simulator.images(), depth, bodies


def _set_start(monkeypatch: pytest.MonkeyPatch, **changes: Look | Light) -> None:
    """Makes scenes start with this look or light."""
    monkeypatch.setattr(Task, "start", lambda *arguments: replace(START(*arguments), **changes))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "look"),
    [
        *((name, Look()) for name in TASKS),
        ("take_photo", Look(*TEXTURES[:3])),
        ("pass_shoe", Look(*TEXTURES[2:])),
    ],
)
def test_pictures_depth_and_segmentation_equal_those_of_the_minimal_pack(
    name: str, look: Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    _set_start(monkeypatch, look=look)
    ours, depth, bodies = _render(name)
    monkeypatch.setattr(environment, "shader_config", lambda: PREBUILT_SHADER_CONFIGS[BASE_SHADER_PACK])
    stock, stock_depth, stock_bodies = _render(name)
    for camera, picture in ours.items():
        difference = np.abs(picture.astype(int) - stock[camera]).max(axis=-1)
        assert picture.std() > 10, "a picture with something on it"
        assert difference.max() <= 1
        assert (difference > 0).sum() <= ROUNDED_PIXELS
        np.testing.assert_array_equal(depth[camera], stock_depth[camera])
        np.testing.assert_array_equal(bodies[camera], stock_bodies[camera])


@pytest.mark.slow
def test_finishes_change_only_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table with a colour, a texture, and a texture in that colour; no other pixels change."""
    red, tiles = (0.5, 0.05, 0.05), Texture("tile", "seen", 5, 0.6)
    finishes = [
        DEFAULT_FINISH,
        Finish(red),
        Finish(texture=tiles),
        Finish(red, tiles),
        Finish(red, tiles, 0.1),
    ]
    on_top = (slice(-20, None), slice(100, 220))  # the bottom of the picture shows only the table
    pictures, other_pixels = [], []
    for finish in finishes:
        _set_start(monkeypatch, look=Look(table=finish))
        rendered, _, bodies = _render("two_robots_stack_cube")
        pictures.append(rendered["global"][on_top].astype(float))
        other_pixels.append(rendered["global"][bodies["global"] != bodies["global"][-1, 160]])
    bare, plain, textured, both, smooth = pictures
    assert plain.std(axis=(0, 1)).max() < 3 < textured.std(axis=(0, 1)).min()
    assert (plain[..., 0] > 2 * plain[..., 1]).all() and (both[..., 0] > 2 * both[..., 1]).all()
    assert both.std(axis=(0, 1))[0] > 3 and both.mean() < textured.mean()
    assert (smooth != both).any() and (bare != plain).any()
    assert all((each == other_pixels[0]).all() for each in other_pixels) and other_pixels[0].size


@pytest.mark.slow
def test_light_and_lamps_change_the_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    dusk = Light((0.1, 0.1, 0.1), (Lamp((0.3, -1.0, -0.4), (2.0, 1.0, 0.5)),))
    dark = Light((0.0, 0.0, 0.0), ())
    means = []
    for light in (Light(), dusk, dark):
        _set_start(monkeypatch, lamps=light)
        means.append(_render("lift_barrier")[0]["global"].mean(axis=(0, 1)))
    usual, warm, black = means
    assert warm[0] > 1.2 * warm[2] and warm.sum() < usual.sum()
    assert not black.any()


def test_the_default_light_is_that_of_earlier_demonstrations() -> None:
    """Values of the demonstrations so far, scaled by the brightness of a start."""
    expected = [(0.3, 0.3, 0.3), (1.6, 1.6, 1.6), (0.6, 0.6, 0.6)]
    for brightness in (1.0, 0.937, 1.1):
        light = Light().brighter(brightness)
        colours = [light.ambient, *(lamp.colour for lamp in light.lamps)]
        assert colours == [tuple(value * brightness for value in colour) for colour in expected]
    assert [lamp.direction for lamp in Light().lamps] == [(-0.6, 0.4, -1.0), (0.4, -0.7, -0.5)]


def test_a_finish_keeps_the_relative_brightness_of_parts() -> None:
    surfaces = objects.surfaces(assets.load("cube"))
    for finished, surface in zip(objects.with_finish(surfaces, DEFAULT_FINISH), surfaces, strict=True):
        assert vars(finished) == vars(surface)  # the same arrays
    edges, faces = objects.with_finish(surfaces, Finish((0.0, 0.5, 1.0), roughness=0.3))
    assert faces.colour == (0.0, 0.5, 1.0) and edges.colour == pytest.approx((0.0, 0.06 / 0.62, 0.12 / 0.62))
    assert edges.roughness == faces.roughness == 0.3 and faces.metallic == surfaces[1].metallic
    textured = objects.with_finish(surfaces, Finish(texture=Texture("wood", "seen", 0, 0.1)))
    assert textured[1].colour == (1.0, 1.0, 1.0) and textured[1].texture == textured[0].texture


def test_texture_coordinates_are_metres_along_axes_of_the_face() -> None:
    """A texture has the same scale on every face, is continuous across triangles, and is not smeared."""
    surface = objects.surfaces(assets.load("shoe"))[0]
    unshared = surface._unshared_vertices()
    np.testing.assert_array_equal(unshared.vertices[unshared.faces], surface.vertices[surface.faces])
    np.testing.assert_array_equal(unshared.normals[unshared.faces], surface.normals[surface.faces])
    # (F, 3, 3), (F, 3, 2)
    corners, coordinates_m = unshared.vertices[unshared.faces], unshared._box_projection_m()[unshared.faces]
    for k in range(3):
        step = corners[:, k] - corners[:, k - 1]
        on_face = np.linalg.norm(coordinates_m[:, k] - coordinates_m[:, k - 1], axis=1)
        assert (on_face <= np.linalg.norm(step, axis=1) + 1e-6).all()
        assert (on_face >= np.linalg.norm(step, axis=1) / np.sqrt(3) - 1e-6).all()


def test_scenes_use_our_shaders() -> None:
    assert environment.shader_config().shader_pack == str(SHADERS)
    assert {path.name for path in SHADERS.iterdir()} == {"gbuffer.vert", "gbuffer.frag"}
