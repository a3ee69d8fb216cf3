"""Simplified meshes: few triangles, the shape of the robot, created once."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from rf_exp.errors import StageError
from rf_exp.robots import DEFAULT, meshes


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    meshes.simplified_urdf.cache_clear()
    yield tmp_path
    meshes.simplified_urdf.cache_clear()


def test_an_arm_has_about_eight_thousand_triangles() -> None:
    simplified = meshes.simplified_meshes(DEFAULT)
    assert set(simplified) == set(DEFAULT.links)
    assert 7_000 < sum(len(faces) for _, faces, _ in simplified.values()) < 9_000
    for vertices, faces, colours in simplified.values():
        assert faces.max() < len(vertices) == len(colours)
        assert colours.shape[1] == 3 and colours.min() >= 0 and colours.max() <= 1


def test_every_link_keeps_its_shape_and_its_colours() -> None:
    folder = DEFAULT.urdf_path.parent / "franka_description/meshes/visual"
    simplified = meshes.simplified_meshes(DEFAULT)
    for link in DEFAULT.links[:-2]:
        full = trimesh.load_scene(folder / f"{link.removeprefix('panda_')}.glb")
        vertices = simplified[link][0]
        box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        np.testing.assert_allclose(box, full.bounds, atol=2e-3, err_msg=link)
    assert {tuple(np.round(colour, 1)) for colour in simplified["panda_link3"][2]} == {
        (0.9, 0.9, 0.9),
        (0.1, 0.1, 0.1),
    }


def test_the_fingers_face_each_other() -> None:
    """The visual mesh of the right finger is rotated; in its link's frame it must mirror the left one."""
    simplified = meshes.simplified_meshes(DEFAULT)
    left, right = (simplified[f"panda_{side}finger"][0] for side in ("left", "right"))
    assert left[:, 1].max() == pytest.approx(-right[:, 1].min(), abs=1e-4)


def test_collision_meshes_and_the_srdf_are_the_original_ones() -> None:
    """Without the SRDF beside it, the simulator would let neighbouring links collide."""
    simplified, source = meshes.simplified_urdf(DEFAULT), DEFAULT.urdf_path
    assert simplified.with_suffix(".srdf").read_bytes() == source.with_suffix(".srdf").read_bytes()

    def collisions(path: Path) -> list[tuple]:
        return [
            (
                link.get("name"),
                sorted(
                    (path.parent / e.attrib["filename"]).resolve()
                    for e in link.iterfind("collision/geometry/mesh")
                ),
            )
            for link in ElementTree.parse(path).iter("link")
        ]

    assert collisions(simplified) == collisions(source)


@pytest.mark.slow
def test_meshes_are_created_once(empty_cache: Path) -> None:
    first = meshes.simplified_urdf(DEFAULT)
    assert first.is_relative_to(empty_cache)
    times = {path: path.stat().st_mtime_ns for path in first.parent.iterdir()}
    meshes.simplified_urdf.cache_clear()
    assert meshes.simplified_urdf(DEFAULT) == first
    assert {path: path.stat().st_mtime_ns for path in first.parent.iterdir()} == times
    # No temporary files are left.
    assert [path.name for path in first.parent.parent.iterdir()] == [first.parent.name]


@pytest.mark.slow
def test_concurrent_processes_use_the_same_meshes(empty_cache: Path) -> None:
    code = (
        "from rf_exp.robots import DEFAULT, simplified_urdf; DEFAULT.meshes; print(simplified_urdf(DEFAULT))"
    )
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    results = [run.communicate() for run in runs]
    assert {out for out, _ in results} == {f"{meshes.simplified_urdf(DEFAULT)}\n"}, results
    assert len(list((empty_cache / "rf_exp").iterdir())) == 1


def test_a_cache_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    meshes.simplified_urdf.cache_clear()
    with pytest.raises(StageError) as error:
        meshes.simplified_urdf(DEFAULT)
    assert str(error.value) == (
        f"cannot write the mesh cache {meshes.cache_folder(DEFAULT)}: Not a directory; "
        "set XDG_CACHE_HOME to a writable folder"
    )
