"""Demonstrations that are rendered again: the same episodes with other pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rf_exp.errors import ArgumentError, StageError
from rf_exp.sim import Simulator
from rf_exp.stages import Cell, cells, generate_data, redraw
from rf_exp.store import Store, problems
from rf_exp.tasks import NO_VARIATION, Variation, read_variation, scene_draws
from tests.conftest import experiment

SMALL = ("task=stack_cube", "picture={width: 64, height: 48}", "cameras=local", "workers=1", "recordings=0")
SIZE = {"width_px": 64, "height_px": 48}
APPEARANCE = read_variation("appearance")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """Two demonstrations in nominal scenes."""
    out = tmp_path_factory.mktemp("redrawing")
    (found,) = cells(experiment(*SMALL, f"out={out}", "demos=2", "stages=[generate]", "wandb=disabled"))
    generate_data(found)
    return found


@pytest.mark.render
@pytest.mark.slow
def test_rendering_at_recorded_poses_gives_the_recorded_pictures(cell: Cell) -> None:
    episode = Store.open(cell.data_path).episode(0)
    with Simulator(cell.task, width_px=64, height_px=48) as world:
        world.reset(episode.seed)
        for step in range(0, len(episode.qpos), 7):
            world.place(episode.qpos[step], {name: rows[step] for name, rows in episode.poses.items()})
            seen, before = world.images(["agent1"])["agent1"], episode.images["agent1"][step]
            assert (np.abs(seen.astype(int) - before) > 2).any(axis=2).mean() < 0.005


@pytest.mark.render
@pytest.mark.slow
def test_copies_differ_in_pictures_only(cell: Cell, tmp_path: Path) -> None:
    source = Store.open(cell.data_path)
    path = redraw(source, tmp_path / "redrawn.zarr", cell.task, APPEARANCE, 3)
    store = Store.open(path)
    assert len(store) == 6 and store.seeds.tolist() == np.repeat(source.seeds, 3).tolist()
    varied = replace(cell.task, variation=APPEARANCE)
    for index in range(len(store)):
        found, before = store.episode(index), source.episode(index // 3)
        assert problems(store, index) == []
        for name in ("qpos", "action", "executed", "subgoal"):
            np.testing.assert_array_equal(getattr(found, name), getattr(before, name))
        same = np.array_equal(found.images["agent1"], before.images["agent1"])
        assert same == (index % 3 == 0)
        if index % 3:
            assert found.certificate["copy"] == index % 3
            assert found.certificate["drawn"] == scene_draws(varied, found.seed, index % 3)
    whole = {str(each.relative_to(path)): each.read_bytes() for each in path.rglob("*") if each.is_file()}
    redraw(source, path, cell.task, APPEARANCE, 3)  # it is complete already
    assert whole == {str(e.relative_to(path)): e.read_bytes() for e in path.rglob("*") if e.is_file()}
    with pytest.raises(StageError, match="copies"):
        redraw(source, path, cell.task, APPEARANCE, 4)


@pytest.mark.render
@pytest.mark.slow
def test_interrupted_copies_are_resumed(cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = Store.open(cell.data_path)
    whole = redraw(source, tmp_path / "whole.zarr", cell.task, APPEARANCE, 2)
    append, left = Store.append, iter(range(3))

    def torn(store: Store, episode) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt
        append(store, episode)

    monkeypatch.setattr(Store, "append", torn)
    with pytest.raises(KeyboardInterrupt):
        redraw(source, tmp_path / "torn.zarr", cell.task, APPEARANCE, 2)
    monkeypatch.setattr(Store, "append", append)
    redraw(source, tmp_path / "torn.zarr", cell.task, APPEARANCE, 2)
    for index in range(4):
        one, other = (Store.open(path).episode(index) for path in (whole, tmp_path / "torn.zarr"))
        np.testing.assert_array_equal(one.images["agent1"], other.images["agent1"])


@pytest.mark.parametrize(
    ("variation", "copies", "said"),
    [
        (read_variation("appearance"), 1, "1 copies of each demonstration; expected 2 or more"),
        (
            read_variation("bases"),
            2,
            "'bases' has another base_position_m and another base_yaw_deg than",
        ),
        (NO_VARIATION, 2, "variation 'none' shows nothing in pictures"),
        (Variation("late", delay_s=(0.1, 0.1)), 2, "variation 'late' has another delay_s"),
    ],
)
def test_variations_that_pictures_do_not_show_are_refused(
    cell: Cell, tmp_path: Path, variation, copies, said
) -> None:
    with pytest.raises(ArgumentError, match=said):
        redraw(Store.open(cell.data_path), tmp_path / "x.zarr", cell.task, variation, copies)
    assert not (tmp_path / "x.zarr").exists()


def test_a_store_of_other_scenes_is_refused(cell: Cell, tmp_path: Path) -> None:
    """Also if the variation is that of the task, as training passes it."""
    moved = replace(cell.task, variation=Variation("none", base_position_m=0.02))
    with pytest.raises(ArgumentError, match="is of other scenes than the task has now"):
        redraw(Store.open(cell.data_path), tmp_path / "x.zarr", moved, moved.variation, 2)
    assert not (tmp_path / "x.zarr").exists()


def test_appearances_need_a_variation_that_pictures_show() -> None:
    with pytest.raises(ArgumentError, match="appearances is 4, and variation 'bases' shows nothing"):
        experiment(*SMALL, "appearances=4", "variation=bases")
    configured = experiment(*SMALL, "appearances=4", "variation=light")
    (found,) = cells(configured)
    assert (configured.data, configured.method, configured.policies) == (
        "test+light",
        "test+lightx4",
        "test+lightx4-50-0",
    )
    assert found.redrawn_path.name == "test+light-50x4.zarr"
