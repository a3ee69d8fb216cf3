"""Heat maps are learned once for all policies that differ in what comes after them; nothing is lost by it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rf_exp.policy import MODEL, PolicyConfig, Stream, TrainConfig, View, train
from rf_exp.policy.config import AFTER_EYES, BESIDE_EYES
from rf_exp.store import Store
from tests.policy.conftest import rows

LOCAL = View("agent1", (Stream("agent1", (1,)),))
EYES = 3  # steps of learning
SEES: dict[str, Any] = {
    "encoder": "heatmaps",
    "context": True,
    "crop": 1.0,
    "tcp_actions": True,
    "horizon": 8,
}
OTHERWISE: dict[str, Any] = {  # in all that heat maps do not depend on
    **{"keypoint_noise": 0.01, "unet_channels": (24, 32), "horizon": 16, "observation_steps": 1},
    **{"train_diffusion_steps": 9, "inference_diffusion_steps": 9, "sampler": "ddpm", "loss": "l1"},
    **{"relative_actions": False, "trunk": (24,), "draft": (48,), "dropout": 0.2, "tcp_actions": False},
    **{"prediction": "sample", "binary_grippers": True},
    **{"action_steps": 5, "ensemble": 0.1, "hold_rad": 0.1, "patience": 0.5},
}


@pytest.fixture
def store(make_store: Callable[[int, int], Store]) -> Store:
    return make_store(2, 3)


@pytest.fixture
def first(policy_config: PolicyConfig) -> PolicyConfig:
    return replace(policy_config, **SEES, prediction="epsilon")


@pytest.fixture
def budget(train_config: TrainConfig) -> TrainConfig:
    return replace(train_config, eyes_steps=EYES)


@pytest.mark.slow
def test_policies_that_differ_in_all_else_have_the_weights_that_they_would_have_alone(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    other = replace(first, **OTHERWISE)
    longer = replace(budget, epochs=1, steps=None, draft_steps=5, noise_draws=3, proprio_noise=0.1)
    assert not [name for name in BESIDE_EYES if getattr(first, name) == getattr(other, name)]
    assert not [name for name in AFTER_EYES if getattr(budget, name) == getattr(longer, name)]
    shared = tmp_path / "eyes"
    train(store, LOCAL, first, budget, tmp_path / "first", shared=shared)
    after = train(store, LOCAL, other, longer, tmp_path / "after", shared=shared)
    alone = train(store, LOCAL, other, longer, tmp_path / "alone")
    assert (after / MODEL).read_bytes() == (alone / MODEL).read_bytes()
    told = ("step", "loss", "learning_rate")
    assert [[row[name] for name in told] for row in rows(after)] == [
        [row[name] for name in told] for row in rows(alone) if int(row["step"]) > EYES
    ]
    assert len(list(shared.iterdir())) == 1


@pytest.mark.slow
def test_what_it_costs_to_learn_them_is_counted_for_every_policy(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    made = train(store, LOCAL, first, replace(budget, log_every=EYES), tmp_path / "first", shared=tmp_path)
    seeing_s = float(rows(made)[0]["core_s"])
    other = train(store, LOCAL, replace(first, loss="l1"), budget, tmp_path / "other", shared=tmp_path)
    assert float(rows(other)[0]["core_s"]) > seeing_s


@pytest.mark.slow
def test_those_that_see_otherwise_learn_their_own(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    shared = tmp_path / "eyes"
    idle = replace(first, drop_idle=not first.drop_idle)
    for k, recipe in enumerate(((first, budget), (idle, budget), (first, replace(budget, seed=1)))):
        train(store, LOCAL, *recipe, tmp_path / str(k), shared=shared)
        assert len(list(shared.iterdir())) == k + 1
