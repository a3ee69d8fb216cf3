"""What makes data and evaluations others, and what does not: content and versions, not words."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import trimesh

from rf_exp.artifacts import find_differences
from rf_exp.experiment import Experiment
from rf_exp.tasks import assets, pick_meat
from rf_exp.transforms import transform
from tests.conftest import RECIPES, cell_of, experiment

CUBE = "mesh: cube.obj\nmass_kg: {mass_kg}\n# {comment}\npoints_of: cube\n"


def steak(*overrides: str) -> Experiment:
    return experiment("task=pick_meat", "recipe=fast", *overrides)


def identities(*overrides: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Of generation and of evaluation."""
    cell = cell_of(steak(*overrides))
    return cell.generation_identity, cell.evaluation_identity(100)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("task.pick_meat.objects.steak.x_m=[-0.01,0.01]", "scene.objects.steak.x_m"),
        ("task.pick_meat.success.hold_steps=4", "scene.success.hold_steps"),
        ("randomisation.mass_scale=0.5", "scene.randomisation.mass_scale"),
        ("task.pick_meat.objects.steak.asset=cube", "scene.objects.steak.asset"),
        ("task.pick_meat.cameras.global.fov_deg=50", "scene.cameras.global.fov_deg"),
        ("task.pick_meat.robots=[{x_m: -0.61, y_m: 0.0, yaw_deg: 0}]", "scene.robots"),
    ],
)
def test_the_scene_decides_both(override: str, key: str) -> None:
    for found, wanted in zip(identities(), identities(override), strict=True):
        (difference,) = find_differences(found, wanted)
        assert difference.startswith(f"{key}: found ")


@pytest.mark.slow
def test_what_decides_evaluation_alone() -> None:
    for override, key in (
        ("demos=7", "demos"),
        ("picture.width=64", "pictures"),
        ("policy.head.diffusion.inference_steps=7", "policy.head.diffusion.inference_steps"),
        ("training.steps=7", "training.steps"),
        ("shield=true", "shield"),
    ):
        (old, before), (new, after) = identities(), identities(override)
        assert old == new
        assert any(line.startswith(f"{key}: found") for line in find_differences(before, after)), key
    cell = cell_of(steak())
    assert cell.evaluation_identity(100) != cell.evaluation_identity(101)


@pytest.mark.slow
@pytest.mark.parametrize(
    "override",
    [
        "task.pick_meat.title=Steak",
        "task.pick_meat.description=Something",
        "task.pick_meat.target_condition=Something",
        "workers=1",
        "training.device=cpu",
    ],
)
def test_what_decides_nothing_stays_out(override: str) -> None:
    assert identities() == identities(override)


def test_words_decide_what_a_model_answers() -> None:
    found, wanted = (
        identities("brain=openai", "brain.model=m", f"task.pick_meat.description={text}")[0]
        for text in ("one", "two")
    )
    assert [line.split(":")[0] for line in find_differences(found, wanted)] == ["told"]


def test_pictures_decide_where_they_are_looked_at() -> None:
    for width in (64, 128):
        seen = identities("occupancy=depth", f"picture.width={width}")[0]["seen"]
        assert seen["width"] == width


@pytest.mark.slow
@pytest.mark.parametrize(("constant", "key"), [("VERSION", "criteria"), ("PLAN_VERSION", "plan")])
def test_versions_of_a_task_decide(monkeypatch: pytest.MonkeyPatch, constant: str, key: str) -> None:
    before = identities()
    monkeypatch.setattr(pick_meat, constant, "99")
    for found, wanted in zip(before, identities(), strict=True):
        assert f'scene.{key}: found "1", wanted "99"' in find_differences(found, wanted)


def test_the_version_of_the_generator_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    (before, _) = identities()
    monkeypatch.setattr("rf_exp.datagen.version.GENERATOR", "99")
    assert [line.split(":")[0] for line in find_differences(before, identities()[0])] == ["generator"]


def test_objects_in_another_order_are_drawn_otherwise() -> None:
    task = steak("task=place_food").tasks[0]
    turned = replace(task, objects=dict(reversed(list(task.objects.items()))))
    assert [line.split(":")[0] for line in find_differences(task.identity, turned.identity)] == ["order"]


@pytest.fixture
def own(tmp_path: Path) -> Callable[..., str]:
    """Writes an asset of a user's own and says what a task with it has for its identity."""

    def write(size_m: float = 0.04, mass_kg: float = 0.1, comment: str = "a cube", name: str = "cube") -> str:
        assets._load.cache_clear()  # as in the next process
        mesh = trimesh.creation.box((size_m, size_m, size_m), transform((0, 0, size_m / 2)))
        mesh.export(tmp_path / "cube.obj")
        (tmp_path / f"{name}.yaml").write_text(CUBE.format(mass_kg=mass_kg, comment=comment))
        made = steak(f"task.pick_meat.objects.steak.asset={tmp_path / name}.yaml")
        return made.tasks[0].identity["objects"]["steak"]["asset"]

    return write


@pytest.mark.slow
def test_an_edited_asset_or_mesh_decides(own: Callable[..., str]) -> None:
    before = own()
    assert own() == before
    assert own(comment="the same cube") == before
    assert own(mass_kg=0.2) != before
    assert own(size_m=0.041) != before


def test_every_part_of_an_asset_is_content() -> None:
    cube = assets.load("cube")
    part, (name, point) = cube.parts[0], next(iter(cube.points.items()))
    others = [
        replace(cube, friction=0.5),
        replace(cube, visual_only=True),
        replace(cube, parts=(replace(part, colour=(0.1, 0.2, 0.3)), *cube.parts[1:])),
        replace(cube, parts=(replace(part, roughness=0.1), *cube.parts[1:])),
        replace(cube, points={**cube.points, name: replace(point, width_m=0.033)}),
        replace(cube, points={**cube.points, name: replace(point, object_from_tcp=transform((0, 0, 1)))}),
    ]
    assert len({cube.content_digest, *(other.content_digest for other in others)}) == len(others) + 1
    assert replace(cube, name="another").content_digest == cube.content_digest


@pytest.mark.slow
def test_all_recipes_share_an_output_folder() -> None:
    """Whatever has one place is made of the same, by whichever recipe: a sweep over them runs to its end."""
    found: dict[Path, dict[str, Any]] = {}
    for recipe, choice in RECIPES.items():
        made = experiment("task=pick_meat", f"policy={choice}", f"recipe={recipe}")
        cell = cell_of(made)
        for path, identity in (
            (cell.generation_path, cell.generation_identity),
            (cell.data_path, cell.store_identity(made.pictures)),
            (cell.policy_path, {"policy": made.policy.training_values, "training": made.training.identity}),
            (cell.evaluation_path, cell.evaluation_identity(100)),
        ):
            assert not find_differences(found.setdefault(path, identity), identity), (recipe, path)
