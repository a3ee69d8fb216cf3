"""A keypoint encoder is trained once for all policies that share its recipe, and gives the same weights."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from rf_exp.artifacts import leaves
from rf_exp.policy import MODEL, PolicyConfig, Stream, TrainConfig, View, train
from rf_exp.policy.config import LATER_DEFAULTS, KeypointsConfig
from rf_exp.store import Store
from tests.policy.conftest import rows, varied

LOCAL = View("agent1", (Stream("agent1", (1,)),))
STEPS = 3  # of training
RECIPE: dict[str, Any] = {
    **{"encoder.name": "keypoints", "encoder.keypoints.steps": STEPS, "context": True, "crop": 1.0},
    **{"task_space_actions": True, "horizon": 8, "head.diffusion.prediction": "epsilon"},
}
DIFFUSION: dict[str, Any] = {
    **{"channels": (24, 32), "train_timesteps": 9, "inference_steps": 9, "sampler": "ddpm", "loss": "l1"},
    **{"trunk": (24,), "prediction": "sample", "noise_draws": 3},
}
OTHER_VALUES: dict[str, Any] = {  # other values of all keys that the encoder does not depend on
    **{"encoder.keypoints.noise": 0.01, "horizon": 16, "observation_steps": 1, "proprio_noise": 0.1},
    **{"relative_actions": False, "task_space_actions": False, "binary_grippers": True, "phase_dropout": 0.1},
    **{f"head.diffusion.{key}": value for key, value in DIFFUSION.items()},
    **{"head.name": "refined", "head.regression.hidden": (48,), "head.regression.dropout": 0.2},
    **{"head.refined.regression_steps": 5, "acting.action_steps": 5},
    **{"acting.deadband_rad": 0.1, "acting.transition_integrator": 0.5},
}
NOT_IN_CACHE_KEY = {"noise", *LATER_DEFAULTS["encoder"]["keypoints"]}
SAME = {  # keys that the encoder depends on
    # Without those that were added later and are neutral here.
    *(
        f"encoder.keypoints.{each.name}"
        for each in fields(KeypointsConfig)
        if each.name not in NOT_IN_CACHE_KEY
    ),
    *("encoder.name", "height", "width"),
    *("context", "crop"),  # required by a keypoint encoder
    "phases",  # adds subgoals to the observation spec
}


@pytest.fixture
def store(make_store: Callable[[int, int], Store]) -> Store:
    return make_store(2, 3)


@pytest.fixture
def first(policy_config: PolicyConfig) -> PolicyConfig:
    return varied(policy_config, RECIPE)


@pytest.fixture
def budget(train_config: TrainConfig) -> TrainConfig:
    return train_config


@pytest.mark.slow
def test_a_shared_encoder_gives_the_same_weights_as_training_alone(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    other = varied(first, OTHER_VALUES)
    longer = replace(budget, epochs=1, steps=None)
    one, two = leaves(first.identity), leaves(other.identity)
    assert {key for key in one if one[key] == two.get(key)} == SAME
    shared = tmp_path / "encoders"
    train(store, LOCAL, first, budget, tmp_path / "first", fit_cache=shared)
    after = train(store, LOCAL, other, longer, tmp_path / "after", fit_cache=shared)
    alone = train(store, LOCAL, other, longer, tmp_path / "alone")
    assert (after / MODEL).read_bytes() == (alone / MODEL).read_bytes()
    columns = ("step", "loss", "learning_rate")
    assert [[row[name] for name in columns] for row in rows(after)] == [
        [row[name] for name in columns] for row in rows(alone) if int(row["step"]) > STEPS
    ]
    assert len(list(shared.iterdir())) == 1


@pytest.mark.slow
def test_the_cost_of_a_shared_encoder_counts_for_every_policy(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    made = train(
        store, LOCAL, first, replace(budget, log_every=STEPS), tmp_path / "first", fit_cache=tmp_path
    )
    encoder_s = float(rows(made)[0]["core_s"])
    other = train(
        store,
        LOCAL,
        varied(first, {"head.diffusion.loss": "l1"}),
        budget,
        tmp_path / "other",
        fit_cache=tmp_path,
    )
    assert float(rows(other)[0]["core_s"]) > encoder_s


@pytest.mark.slow
def test_policies_with_another_encoder_recipe_train_their_own(
    store: Store, first: PolicyConfig, budget: TrainConfig, tmp_path: Path
) -> None:
    shared = tmp_path / "encoders"
    noisy = varied(first, {"encoder.keypoints.shift_px": 1})
    for k, recipe in enumerate(((first, budget), (noisy, budget), (first, replace(budget, seed=1)))):
        train(store, LOCAL, *recipe, tmp_path / str(k), fit_cache=shared)
        assert len(list(shared.iterdir())) == k + 1
