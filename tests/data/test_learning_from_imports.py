"""Training on imported demonstrations: `paper` always, `fast` only with known camera poses."""

from pathlib import Path

import pytest

from rf_exp.data.importing import import_demonstrations
from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy import MODEL, train, views
from rf_exp.stages.cell import open_or_create
from rf_exp.store import Store
from rf_exp.tasks import Task, stored_task
from tests.conftest import cell_of, experiment
from tests.data.release_files import HEIGHT, WIDTH, source_episode, write_arm_zarr, write_lightning, write_raw

EPISODES = [source_episode(seed, 12) for seed in (2, 3)]
SMALL = (
    f"picture={{width: {WIDTH}, height: {HEIGHT}}}",
    "training.batch_size=4",
    "training.epochs=null",
    "training.steps=1",
    "training.device=cpu",
    "policy.head.diffusion.channels=[16,32]",
)
FAST = ("policy=fast", "policy.encoder.keypoints.steps=1", "policy.head.refined.regression_steps=1")
pytestmark = pytest.mark.slow


def import_source(tmp_path: Path, kind: str) -> Store:
    path = tmp_path / "source"
    if kind == "raw":
        write_raw(path / "x.h5", EPISODES)
    elif kind == "zarr":
        for arm in (0, 1):
            write_arm_zarr(path, EPISODES, arm)
    else:
        path.mkdir()
        write_lightning(path / "x.h5", EPISODES)
    import_demonstrations([path], tmp_path / "s.zarr", "lift_barrier")
    return Store.open(tmp_path / "s.zarr")


def learn(store: Store, folder: Path, *recipe: str) -> Path:
    """Trains the first agent's policy, with one step in each fit."""
    configured = experiment(*recipe, *SMALL)
    view = views(cell_of(configured).arch, store.agents)[0]
    return train(store, view, configured.policy, configured.training, folder)


@pytest.mark.parametrize("kind", ["raw", "zarr", "lightning"])
def test_the_paper_recipe_trains_on_any_import(tmp_path: Path, kind: str) -> None:
    assert (learn(import_source(tmp_path, kind), tmp_path / "policy", "policy=paper") / MODEL).exists()


def test_the_fast_recipe_trains_on_raw_trajectories(tmp_path: Path) -> None:
    assert (learn(import_source(tmp_path, "raw"), tmp_path / "policy", *FAST) / MODEL).exists()


def test_the_fast_recipe_names_missing_data_of_a_replay_buffer(tmp_path: Path) -> None:
    store = import_source(tmp_path, "zarr")
    with pytest.raises(ArgumentError, match=r"does not record the base poses of its arms; .*policy=paper"):
        learn(store, tmp_path / "policy", *FAST)


def test_scenes_of_imported_stores_are_not_rebuilt(tmp_path: Path, lift_barrier: Task) -> None:
    store = import_source(tmp_path, "zarr")
    with pytest.raises(ArgumentError, match="the store was imported: its scenes are somebody else's"):
        stored_task(store.identity)
    with pytest.raises(StageError, match="was imported: its scenes cannot be made again"):
        open_or_create(tmp_path / "t.zarr", {}, store, lift_barrier, None)
