"""Assets from a user's own mesh and its annotation."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from rf_exp.errors import ArgumentError
from rf_exp.tasks import assets
from rf_exp.tasks.assets import __main__ as command
from rf_exp.tasks.assets.asset import mesh

POINT = {"kind": "grasp", "position_m": [0, 0, 0.02], "approach": [0, 0, -1]}


def annotate(folder: Path, shape: trimesh.Trimesh | trimesh.Scene, suffix: str = ".stl", **fields) -> str:
    """Writes a mesh and its annotation; returns the path of the annotation."""
    shape.export(folder / f"thing{suffix}")
    return write_annotation(folder, {"mesh": f"thing{suffix}", "mass_kg": 0.2, **fields})


def write_annotation(folder: Path, content: object) -> str:
    path = folder / "thing.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


def box(height_m: float = 0.04) -> trimesh.Trimesh:
    shape = trimesh.creation.box((0.06, 0.04, height_m))
    return shape.apply_translation((0, 0, height_m / 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in assets.available() if not assets.load(name).visual_only])
def test_a_built_in_asset_is_restored_from_its_exported_mesh_and_annotation(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / f"{name}.yaml"
    monkeypatch.setattr(sys, "argv", ["assets", name, "--mesh", str(tmp_path / "own.glb")])
    assert command.main() == 0
    file.write_text(capsys.readouterr().out)
    built_in, own = assets.load(name), assets.load(str(file))

    assert own.name == name and own.friction == built_in.friction
    assert (own.mass_kg, own.heaviest_kg) == (built_in.mass_kg, built_in.heaviest_kg)
    assert own.static == built_in.static and list(own.points) == list(built_in.points)
    for point, expected in built_in.points.items():
        actual = own.points[point]
        np.testing.assert_allclose(actual.object_from_tcp, expected.object_from_tcp, atol=2e-6)
        for field in ("kind", "standoff_m", "width_m", "turns", "tip_deg", "slack_m"):
            assert getattr(actual, field) == getattr(expected, field)
    np.testing.assert_allclose(own.bounds_m, built_in.bounds_m, atol=1e-6)
    visible = [part for part in own.parts if part.visible]
    for part in built_in.parts:
        assert any(np.allclose(part.colour, other.colour, atol=0.003) for other in visible)
    # Parts that were only visual are solid now, less than a millimetre thick.
    for hull in built_in.hulls:
        assert any(np.allclose(hull.bounds, other.bounds, atol=1e-6) for other in own.hulls)
    assert all(hull.is_convex and len(hull.vertices) <= 255 for hull in own.hulls)


@pytest.mark.parametrize("suffix", mesh.FORMATS)
def test_every_format_gives_the_same_body(suffix: str, tmp_path: Path) -> None:
    upright = box().apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    upright.apply_scale(1000)  # millimetres, y up
    upright.visual.face_colors = (255, 0, 0, 255)
    frame = {"rotation_deg": [-90, 0, 0]}
    asset = assets.load(annotate(tmp_path, upright, suffix, scale=0.001, frame=frame))
    np.testing.assert_allclose(asset.bounds_m, [[-0.03, -0.02, 0], [0.03, 0.02, 0.04]], atol=1e-6)
    (solid,) = asset.hulls
    assert solid.volume == pytest.approx(0.06 * 0.04 * 0.04, rel=1e-4)
    if suffix != ".stl":  # STL has no colours
        assert [part.colour for part in asset.parts if part.visible] == [pytest.approx((1, 0, 0), abs=0.01)]


@pytest.mark.slow
def test_a_bowl_stays_hollow_and_is_cut_the_same_way_each_time(tmp_path: Path) -> None:
    ring = trimesh.creation.annulus(0.03, 0.04, 0.04).apply_translation((0, 0, 0.02))
    path = annotate(tmp_path, ring)
    asset, again = assets.load(path), mesh.build(path)
    assert len(asset.hulls) > 3
    assert sum(hull.volume for hull in asset.hulls) == pytest.approx(ring.volume, rel=0.15)
    for hull in asset.hulls:
        assert hull.is_convex and len(hull.vertices) <= 255
        assert np.linalg.norm(hull.vertices[:, :2], axis=1).min() > 0.02
        assert not hull.contains([[0, 0, 0.02]]).any()
    for one, other in zip(asset.hulls, again.hulls, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    (visible,) = [part for part in asset.parts if part.visible]
    assert not visible.solid and len(visible.mesh.faces) == len(ring.faces)


def test_points_can_be_those_of_a_built_in_asset_with_changes(tmp_path: Path) -> None:
    path = annotate(tmp_path, box(), points_of="shoe", points={"tip": POINT | {"kind": "press", "turns": 8}})
    points = assets.load(path).points
    assert points["center"] == assets.load("shoe").points["center"]
    assert points["tip"].kind == "press" and points["tip"].turns == 8


@pytest.mark.parametrize(
    ("said", "complaint"),
    [
        ({"weight": 1.0}, 'can not match "weight"'),
        ({"mass_kg": "heavy"}, '"mass_kg" - should be "float"'),
        ({"mass_kg": -1.0}, "mass_kg is -1.0; expected a number above 0"),
        ({"heaviest_kg": 0.1}, r"heaviest_kg is 0.1; expected mass_kg \(0.2\) or more"),
        ({"colour": [255, 0, 0]}, "three numbers from 0 to 1"),
        ({"mesh": "gone.stl"}, "there is no mesh file .*gone.stl"),
        ({"mesh": "thing.step"}, "unknown mesh format '.step'; available: .glb, .obj, .ply, .stl"),
        ({"mesh": "noise.stl"}, "noise.stl (cannot be read|has no triangles)"),
        ({"points_of": "spoon"}, "unknown asset in points_of 'spoon'; available: barrier"),
        (
            {"points": {"a": POINT | {"kind": "poke"}}},
            "unknown kind 'poke'; available: drop, grasp",
        ),
        ({"points": {"a": {"kind": "grasp"}}}, 'missing value for field "points.*position_m"'),
        ({"points": {"a": {"kind": "grasp", "position_m": [0, 0, 0]}}}, "point 'a': .*\"approach\""),
        ({"points": {"a": POINT | {"fingers": [0, 0, 1]}}}, "not parallel"),
        ({"frame": {"position_m": [0, 0, 0.1]}}, r"at z = 0.1000 m; expected 0: add -0.1000"),
    ],
)
def test_errors_in_annotations_are_reported(said: dict, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "noise.stl").write_bytes(b"no mesh at all")
    with pytest.raises(ArgumentError, match=complaint) as error:
        assets.load(annotate(tmp_path, box(), **said))
    assert "thing.yaml" in str(error.value)


def test_a_mesh_with_a_hole_is_refused(tmp_path: Path) -> None:
    shape = box()
    shape.update_faces(np.arange(len(shape.faces)) > 1)
    with pytest.raises(ArgumentError, match=r"thing\.stl is not watertight: .*10 triangles 4 edges"):
        assets.load(annotate(tmp_path, shape))


def test_invalid_annotation_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"there is no annotation file .*gone\.yaml"):
        assets.load(str(tmp_path / "gone.yaml"))
    with pytest.raises(ArgumentError, match="expected fields and their values"):
        assets.load(write_annotation(tmp_path, ["mesh"]))
    (tmp_path / "odd.yaml").write_text("mesh: [")
    with pytest.raises(ArgumentError, match=r"odd\.yaml cannot be read"):
        assets.load(str(tmp_path / "odd.yaml"))
    with pytest.raises(ArgumentError, match='missing value for field "mass_kg"'):
        assets.load(write_annotation(tmp_path, {"mesh": "thing.stl"}))
