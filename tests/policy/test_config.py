"""Configurations of policies: the paper's defaults, errors that name the field, parts from outside."""

from typing import Any

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.policy import EncoderConfig, PolicyConfig, add_encoder
from rf_exp.policy.networks.encoders import Compact
from tests.policy.conftest import paper_policy, training_of, varied


def test_defaults_are_the_papers() -> None:
    policy, train = paper_policy(), training_of()
    assert (policy.horizon, policy.observation_steps, policy.acting.action_steps) == (8, 3, 6)
    assert (policy.height, policy.width) == (240, 320)
    assert (train.batch_size, train.learning_rate, train.epochs) == (128, 1e-4, 300)
    assert (train.betas, train.epsilon, train.warmup_steps) == ((0.95, 0.999), 1e-8, 500)


def test_lists_become_tuples() -> None:
    lists = varied(paper_policy(), {"head.diffusion.channels": [64, 128]})
    assert lists == varied(paper_policy(), {"head.diffusion.channels": (64, 128)})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"encoder.name": "vit"},
            "unknown encoder 'vit'; available: compact, keypoints, privileged, resnet18",
        ),
        ({"head.name": "gan"}, "unknown head 'gan'; available: diffusion, refined, regression"),
        ({"head.diffusion.sampler": "euler"}, "unknown sampler 'euler'; available: ddim, ddpm"),
        (
            {"head.diffusion.prediction": "x"},
            "unknown prediction 'x'; available: epsilon, sample, v_prediction",
        ),
        ({"horizon": 6}, "horizon is 6; expected a multiple of 4"),
        ({"horizon": 0}, "horizon is 0; expected a number above 0"),
        ({"acting.action_steps": 7}, "action_steps is 7; expected at most 6"),
        ({"crop": 0.0}, "crop is 0.0; expected a number above 0, at most 1"),
        ({"head.diffusion.inference_steps": 101}, "inference_steps is 101; expected 1 to 100"),
        (
            {"head.diffusion.inference_steps": 10},
            "inference_steps is 10; expected 100 with sampler ddpm",
        ),
        ({"width": -1}, "width is -1; expected a number above 0"),
        ({"head.diffusion.noise_draws": -1}, "noise_draws is -1; expected a number above 0"),
    ],
)
def test_policy_errors_name_the_field(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        varied(paper_policy(), changes)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"epochs": 0}, "epochs is 0; expected a number above 0"),
        ({"epochs": -3}, "epochs is -3; expected a number above 0"),
        ({"epochs": None, "steps": 0}, "steps is 0; expected a number above 0"),
        ({"epochs": None}, "the training budget is {}; expected exactly one of epochs and steps"),
        (
            {"steps": 5},
            "the training budget is {'epochs': 300, 'steps': 5}; expected exactly one of epochs and steps",
        ),
        ({"batch_size": 0}, "batch_size is 0; expected a number above 0"),
        ({"warmup_steps": -1}, "warmup_steps is -1; expected 0 or above"),
        ({"betas": (0.9, 1.0)}, "betas is (0.9, 1.0); expected two numbers in [0, 1)"),
        ({"ema_max_decay": 1.0}, "ema_max_decay is 1.0; expected a number in [0, 1)"),
        ({"device": "tpu"}, "unknown device 'tpu'; available: auto, cpu, cuda"),
    ],
)
def test_training_errors_name_the_field(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        training_of(**changes)
    assert str(error.value) == message


def test_sections_of_parts_that_are_not_chosen_are_left_out() -> None:
    small = varied(paper_policy(), {"encoder.name": "compact"})
    other = varied(paper_policy(), {"encoder.name": "compact", "encoder.keypoints.downsample": 4})
    assert small == other and "keypoints" not in small.identity["encoder"]
    assert small.training_values["encoder"] == {"name": "compact"}


def test_acting_values_and_training_values_together_are_all() -> None:
    policy = paper_policy()
    assert policy.acting_values["head"] == {"diffusion": {"sampler": "ddpm", "inference_steps": 100}}
    assert (
        not policy.training_values["head"]["diffusion"].keys()
        & policy.acting_values["head"]["diffusion"].keys()
    )
    assert PolicyConfig.read(policy.training_values, policy.acting_values) == policy
    other = varied(policy, {"acting.action_steps": 2, "horizon": 16})
    assert policy.acting_as(other) == varied(policy, {"acting.action_steps": 2})


@pytest.mark.parametrize(
    ("name", "why"), [("compact", "is registered already"), ("a b", "is not a valid key")]
)
def test_an_encoder_of_a_taken_or_invalid_name_is_refused(name: str, why: str) -> None:
    with pytest.raises(ArgumentError, match=f"encoder '{name}' {why}"):
        add_encoder(name, EncoderConfig, Compact)
