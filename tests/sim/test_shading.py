"""Our shaders draw what ManiSkill's minimal pack draws, and nothing else where nothing has a texture."""

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
START = Task.start  # as it is, where a test puts another in its place
OTHERWISE_ROUNDED = 10  # pixels of 76,800 that may differ, by one shade
TEXTURES = [Finish(texture=Texture(kind, "seen", 5, 0.6)) for kind in get_args(TextureKind)]


def _seen(name: str) -> tuple[dict, dict, dict]:
    with Simulator(read_task(CONFIGURED / f"{name}.yaml"), width_px=320, height_px=240) as simulator:
        simulator.reset(5)
        depth, bodies = simulator.depth(), simulator.segmentation()
        return simulator.images(), depth, bodies


def _starts_with(monkeypatch: pytest.MonkeyPatch, **changes: Look | Light) -> None:
    """Scenes from now on are covered or lit like this."""
    monkeypatch.setattr(Task, "start", lambda *given: replace(START(*given), **changes))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "look"),
    [
        *((name, Look()) for name in TASKS),
        ("take_photo", Look(*TEXTURES[:3])),
        ("pass_shoe", Look(*TEXTURES[2:])),
    ],
)
def test_pictures_depth_and_segmentation_are_those_of_the_minimal_pack(
    name: str, look: Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    _starts_with(monkeypatch, look=look)
    ours, depth, bodies = _seen(name)
    monkeypatch.setattr(environment, "shader_config", lambda: PREBUILT_SHADER_CONFIGS[BASE_SHADER_PACK])
    stock, stock_depth, stock_bodies = _seen(name)
    for camera, picture in ours.items():
        apart = np.abs(picture.astype(int) - stock[camera]).max(axis=-1)
        assert picture.std() > 10, "a picture with something on it"
        assert apart.max() <= 1
        assert (apart > 0).sum() <= OTHERWISE_ROUNDED
        np.testing.assert_array_equal(depth[camera], stock_depth[camera])
        np.testing.assert_array_equal(bodies[camera], stock_bodies[camera])


@pytest.mark.slow
def test_things_are_seen_in_what_covers_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table in a colour, in a texture, and in a texture drawn in that colour; nothing else changes."""
    red, tiles = (0.5, 0.05, 0.05), Texture("tile", "seen", 5, 0.6)
    finishes = [
        DEFAULT_FINISH,
        Finish(red),
        Finish(texture=tiles),
        Finish(red, tiles),
        Finish(red, tiles, 0.1),
    ]
    on_top = (slice(-20, None), slice(100, 220))  # of the picture: its foot, all of it table
    pictures, kept = [], []
    for finish in finishes:
        _starts_with(monkeypatch, look=Look(table=finish))
        drawn, _, bodies = _seen("two_robots_stack_cube")
        pictures.append(drawn["global"][on_top].astype(float))
        kept.append(drawn["global"][bodies["global"] != bodies["global"][-1, 160]])
    bare, plain, textured, both, smooth = pictures
    assert plain.std(axis=(0, 1)).max() < 3 < textured.std(axis=(0, 1)).min()
    assert (plain[..., 0] > 2 * plain[..., 1]).all() and (both[..., 0] > 2 * both[..., 1]).all()
    assert both.std(axis=(0, 1))[0] > 3 and both.mean() < textured.mean()
    assert (smooth != both).any() and (bare != plain).any()
    assert all((each == kept[0]).all() for each in kept) and kept[0].size


@pytest.mark.slow
def test_a_scene_is_lit_as_its_light_says(monkeypatch: pytest.MonkeyPatch) -> None:
    dusk = Light((0.1, 0.1, 0.1), (Lamp((0.3, -1.0, -0.4), (2.0, 1.0, 0.5)),))
    dark = Light((0.0, 0.0, 0.0), ())
    means = []
    for light in (Light(), dusk, dark):
        _starts_with(monkeypatch, lamps=light)
        means.append(_seen("lift_barrier")[0]["global"].mean(axis=(0, 1)))
    usual, warm, nothing = means
    assert warm[0] > 1.2 * warm[2] and warm.sum() < usual.sum()
    assert not nothing.any()


def test_light_is_by_default_that_of_the_demonstrations_so_far() -> None:
    """Numbers that are drawn into every picture; brightness as a start has it."""
    usual = [(0.3, 0.3, 0.3), (1.6, 1.6, 1.6), (0.6, 0.6, 0.6)]
    for brightness in (1.0, 0.937, 1.1):
        light = Light().brighter(brightness)
        found = [light.ambient, *(lamp.colour for lamp in light.lamps)]
        assert found == [tuple(value * brightness for value in colour) for colour in usual]
    assert [lamp.direction for lamp in Light().lamps] == [(-0.6, 0.4, -1.0), (0.4, -0.7, -0.5)]


def test_a_finish_covers_what_it_names_and_keeps_how_dark_parts_are() -> None:
    seen = objects.surfaces(assets.load("cube"))
    for covered, surface in zip(objects.with_finish(seen, DEFAULT_FINISH), seen, strict=True):
        assert vars(covered) == vars(surface)  # the same arrays
    edges, faces = objects.with_finish(seen, Finish((0.0, 0.5, 1.0), roughness=0.3))
    assert faces.colour == (0.0, 0.5, 1.0) and edges.colour == pytest.approx((0.0, 0.06 / 0.62, 0.12 / 0.62))
    assert edges.roughness == faces.roughness == 0.3 and faces.metallic == seen[1].metallic
    textured = objects.with_finish(seen, Finish(texture=Texture("wood", "seen", 0, 0.1)))
    assert textured[1].colour == (1.0, 1.0, 1.0) and textured[1].texture == textured[0].texture


def test_texture_coordinates_are_metres_along_the_axes_that_a_face_lies_in() -> None:
    """So that a texture is as large on every face, runs on from triangle to triangle, and never smears."""
    surface = objects.surfaces(assets.load("shoe"))[0]
    apart = surface._unshared_vertices()
    np.testing.assert_array_equal(apart.vertices[apart.faces], surface.vertices[surface.faces])
    np.testing.assert_array_equal(apart.normals[apart.faces], surface.normals[surface.faces])
    corners, along = (
        apart.vertices[apart.faces],
        apart._box_projection_m()[apart.faces],
    )  # (F, 3, 3), (F, 3, 2)
    for k in range(3):
        step = corners[:, k] - corners[:, k - 1]
        on_face = np.linalg.norm(along[:, k] - along[:, k - 1], axis=1)
        assert (on_face <= np.linalg.norm(step, axis=1) + 1e-6).all()
        assert (on_face >= np.linalg.norm(step, axis=1) / np.sqrt(3) - 1e-6).all()


def test_each_scene_is_drawn_by_our_shaders() -> None:
    assert environment.shader_config().shader_pack == str(SHADERS)
    assert {path.name for path in SHADERS.iterdir()} == {"gbuffer.vert", "gbuffer.frag"}
