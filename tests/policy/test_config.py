"""The paper's defaults, and errors that name the field."""

from typing import Any

import pytest

from rf_exp.errors import ArgumentError
from rf_exp.policy import PolicyConfig, TrainConfig


def test_defaults_are_the_papers() -> None:
    policy, train = PolicyConfig(), TrainConfig()
    assert (policy.horizon, policy.observation_steps, policy.action_steps) == (8, 3, 6)
    assert (policy.height, policy.width) == (240, 320)
    assert (train.batch_size, train.learning_rate, train.epochs) == (128, 1e-4, 300)
    assert (train.betas, train.epsilon, train.warmup_steps) == ((0.95, 0.999), 1e-8, 500)


def test_lists_become_tuples() -> None:
    channels: Any = [64, 128]
    assert PolicyConfig(unet_channels=channels) == PolicyConfig(unet_channels=(64, 128))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"encoder": "vit"}, "unknown encoder 'vit'; available: compact, heatmaps, resnet18"),
        ({"sampler": "euler"}, "unknown sampler 'euler'; available: ddim, ddpm"),
        ({"prediction": "x"}, "unknown prediction 'x'; available: epsilon, sample, v_prediction"),
        ({"horizon": 6}, "horizon is 6; expected a multiple of 4"),
        ({"horizon": 0}, "horizon is 0; expected a number above 0"),
        ({"action_steps": 7}, "action_steps is 7; expected at most 6"),
        ({"crop": 0.0}, "crop is 0.0; expected a number above 0, at most 1"),
        ({"inference_diffusion_steps": 101}, "inference_diffusion_steps is 101; expected 1 to 100"),
        (
            {"inference_diffusion_steps": 10},
            "inference_diffusion_steps is 10; expected 100 with sampler ddpm",
        ),
        ({"width": -1}, "width is -1; expected a number above 0"),
    ],
)
def test_policy_errors_name_the_field(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        PolicyConfig(**changes)
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
        ({"noise_draws": -1}, "noise_draws is -1; expected a number above 0"),
        ({"warmup_steps": -1}, "warmup_steps is -1; expected 0 or above"),
        ({"betas": (0.9, 1.0)}, "betas is (0.9, 1.0); expected two numbers in [0, 1)"),
        ({"ema_max_decay": 1.0}, "ema_max_decay is 1.0; expected a number in [0, 1)"),
        ({"device": "tpu"}, "unknown device 'tpu'; available: auto, cpu, cuda"),
    ],
)
def test_training_errors_name_the_field(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        TrainConfig(**changes)
    assert str(error.value) == message
