"""What changes the identity of data and evaluations: content and versions, not descriptions."""

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
    """The identities of generation and of evaluation."""
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
def test_the_scene_changes_both_identities(override: str, key: str) -> None:
    for found, wanted in zip(identities(), identities(override), strict=True):
        (difference,) = find_differences(found, wanted)
        assert difference.startswith(f"{key}: found ")


@pytest.mark.slow
def test_keys_that_change_evaluation_alone() -> None:
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
def test_keys_that_change_nothing_are_left_out(override: str) -> None:
    assert identities() == identities(override)


def test_descriptions_count_for_language_models() -> None:
    found, wanted = (
        identities("brain=openai", "brain.model=m", f"task.pick_meat.description={text}")[0]
        for text in ("one", "two")
    )
    assert [line.split(":")[0] for line in find_differences(found, wanted)] == ["told"]


def test_picture_sizes_count_where_occupancy_uses_depth() -> None:
    for width in (64, 128):
        pictures = identities("occupancy=depth", f"picture.width={width}")[0]["seen"]
        assert pictures["width"] == width


@pytest.mark.slow
@pytest.mark.parametrize(("constant", "key"), [("VERSION", "criteria"), ("PLAN_VERSION", "plan")])
def test_versions_of_a_task_change_the_identities(
    monkeypatch: pytest.MonkeyPatch, constant: str, key: str
) -> None:
    before = identities()
    monkeypatch.setattr(pick_meat, constant, "99")
    for found, wanted in zip(before, identities(), strict=True):
        assert f'scene.{key}: found "1", wanted "99"' in find_differences(found, wanted)


def test_the_version_of_the_generator_changes_the_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    (before, _) = identities()
    monkeypatch.setattr("rf_exp.datagen.version.GENERATOR", "99")
    assert [line.split(":")[0] for line in find_differences(before, identities()[0])] == ["generator"]


def test_another_order_of_objects_changes_the_identity() -> None:
    task = steak("task=place_food").tasks[0]
    turned = replace(task, objects=dict(reversed(list(task.objects.items()))))
    assert [line.split(":")[0] for line in find_differences(task.identity, turned.identity)] == ["order"]


@pytest.fixture
def asset_identity(tmp_path: Path) -> Callable[..., str]:
    """Writes a custom asset and returns its identity in a task that uses it."""

    def write(size_m: float = 0.04, mass_kg: float = 0.1, comment: str = "a cube", name: str = "cube") -> str:
        assets._load.cache_clear()  # as in the next process
        mesh = trimesh.creation.box((size_m, size_m, size_m), transform((0, 0, size_m / 2)))
        mesh.export(tmp_path / "cube.obj")
        (tmp_path / f"{name}.yaml").write_text(CUBE.format(mass_kg=mass_kg, comment=comment))
        made = steak(f"task.pick_meat.objects.steak.asset={tmp_path / name}.yaml")
        return made.tasks[0].identity["objects"]["steak"]["asset"]

    return write


@pytest.mark.slow
def test_an_edited_asset_or_mesh_changes_the_identity(asset_identity: Callable[..., str]) -> None:
    before = asset_identity()
    assert asset_identity() == before
    assert asset_identity(comment="the same cube") == before
    assert asset_identity(mass_kg=0.2) != before
    assert asset_identity(size_m=0.041) != before


def test_every_part_of_an_asset_but_its_name_is_in_its_digest() -> None:
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
def test_all_recipes_can_share_an_output_folder() -> None:
    """Artifacts at one path have one identity, whatever the recipe, so a sweep over recipes completes."""
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
