"""Sizes of the paper's networks, and fast paths compared with the direct computation."""

import pytest
import torch

from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy import ConditionalUNet1D, Policy, Stream, View, train
from rf_exp.policy.config import ENCODERS
from rf_exp.policy.examples.windows import largest_change
from rf_exp.policy.networks.encoders import SpatialSoftmax
from rf_exp.policy.networks.heads import DiffusionHead, RefinedHead
from rf_exp.policy.networks.policy import LEAST_RANGE, Range
from tests.policy.conftest import paper_policy, small_policy

LOCAL = View("agent1", (Stream("agent1", (1,)),))


def count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.slow
def test_the_papers_sizes() -> None:
    policy = Policy(paper_policy(), LOCAL)
    assert isinstance(policy.head, DiffusionHead)
    assert count(policy.head.unet) == 85_355_912
    assert count(policy.encoder) == 11_176_512


def test_encoders_give_features_of_any_picture() -> None:
    for name in ("resnet18", "compact"):
        network = ENCODERS[name].make()
        assert network(torch.zeros(2, 3, 64, 80)).shape == (2, network.features)


def test_spatial_softmax_finds_the_brightest_place() -> None:
    picture = torch.zeros(1, 1, 5, 9)
    picture[0, 0, 4, 2] = 50.0
    assert SpatialSoftmax()(picture)[0].tolist() == pytest.approx([1.0, -0.5], abs=1e-5)


@pytest.mark.parametrize("channels", [(16,), (16, 20), (0, 16)])
def test_channels_the_blocks_cannot_hold(channels: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError, match="expected at least two levels, each a multiple of 8"):
        ConditionalUNet1D(8, 30, channels)


def test_the_unet_keeps_the_shape_and_round_trips_through_diffusers(tmp_path) -> None:
    torch.manual_seed(0)
    unet = ConditionalUNet1D(8, 30, (16, 32, 64)).eval()
    values = torch.randn(5, 8, 8), torch.tensor([0, 1, 50, 98, 99]), torch.randn(5, 30)
    unet.save_pretrained(tmp_path)
    again = ConditionalUNet1D.from_pretrained(tmp_path)
    assert unet(*values).shape == (5, 8, 8)
    assert torch.equal(again(*values), unet(*values))


def test_the_film_table_equals_the_direct_computation() -> None:
    torch.manual_seed(0)
    unet = ConditionalUNet1D(8, 30, (16, 32, 64)).eval()
    sample, observation = torch.randn(5, 8, 8), torch.randn(5, 30)
    steps = torch.tensor([0, 3, 50, 98, 99])
    table = unet.film_of_steps(torch.arange(100))
    traced = unet.modulated(sample, table[steps] + unet.film_of_observations(observation))
    assert torch.allclose(traced, unet(sample, steps, observation), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("channels", [(16, 32), (16, 32, 64)])
def test_the_traced_network_equals_the_trained_one_to_the_last_bit(channels: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    unet = ConditionalUNet1D(8, 30, channels).eval()
    film = torch.randn(7, unet.film.out_features)
    traced = unet.traced(torch.zeros(1, 16, 8), film[:1])
    with torch.inference_mode():
        for rows in (1, 2, 3, 7):
            sample = torch.randn(rows, 16, 8)
            assert torch.equal(traced(sample, film[:rows]), unet.modulated(sample, film[:rows]))


def test_every_weight_that_sees_data_learns() -> None:
    """Every parameter must have a gradient; only outer taps of a kernel of 5 at length 2 see no data."""
    torch.manual_seed(0)
    unet = ConditionalUNet1D(8, 30, (16, 32))
    unet(torch.randn(4, 8, 8), torch.arange(4), torch.randn(4, 30)).square().sum().backward()
    still = [name for name, p in unet.named_parameters() if p.grad is None or not p.grad.any()]
    assert still == []


def test_normaliser_round_trip() -> None:
    generator = torch.Generator().manual_seed(0)
    values = 3.0 * torch.randn(100, 4, generator=generator) + torch.tensor([0.0, 5.0, -2.0, 0.1])
    bounds = Range(4)
    bounds.fit(values)
    inside = bounds.normalise(values)
    assert inside.amin(dim=0).tolist() == pytest.approx([-1.0] * 4, abs=1e-5)
    assert inside.amax(dim=0).tolist() == pytest.approx([1.0] * 4, abs=1e-5)
    assert torch.allclose(bounds.restore(inside), values, atol=1e-5)


def test_a_joint_that_hardly_moves_is_centred_and_not_amplified() -> None:
    bounds = Range(1)
    bounds.fit(torch.tensor([[0.5], [0.5001]]))
    assert bounds.normalise(torch.tensor([[0.5001]])).abs().item() < 0.01
    assert bounds.radius.item() == pytest.approx(LEAST_RANGE / 2)


def test_the_fastest_change_is_taken_within_episodes() -> None:
    action = torch.tensor([[0.0], [0.1], [5.0], [5.3]])
    assert largest_change(action, torch.tensor([True, False, True])).item() == pytest.approx(0.3)
    assert largest_change(action[:1], torch.ones(0, dtype=torch.bool)).item() == 0.0


def sampled(policy: Policy, rows: int) -> torch.Tensor:
    steps = policy.config.observation_steps
    features = torch.linspace(-1, 1, rows * steps * policy.encoder.features)
    generators = [torch.Generator().manual_seed(row) for row in range(rows)]
    return policy.act(
        features.reshape(rows, steps, -1),
        torch.zeros(rows, steps, 8),
        torch.zeros(rows, steps, 0),
        generators,
    )


@pytest.mark.slow
@pytest.mark.parametrize("prediction", ["epsilon", "sample", "v_prediction"])
@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
def test_samples_are_repeatable_and_inside_the_range(sampler: str, prediction: str) -> None:
    torch.manual_seed(0)
    steps = {"ddpm": 20, "ddim": 5}[sampler]
    diffusion = {
        "sampler": sampler,
        "train_timesteps": 20,
        "inference_steps": steps,
        "prediction": prediction,
    }
    changes = {f"head.diffusion.{key}": value for key, value in diffusion.items()}
    config = small_policy(relative_actions=False, **changes)
    policy = Policy(config, LOCAL).eval()
    actions = sampled(policy, 2)
    assert actions.shape == (2, 8, 8)
    assert actions.abs().max() <= 1.0 + 1e-5  # clipped to the range of the data
    assert torch.equal(actions, sampled(policy, 2))
    assert not torch.allclose(actions[0], actions[1])  # rows have noise of their own


def test_a_head_that_samples_another_shape_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(0)
    policy = Policy(small_policy(), LOCAL).eval()
    whole = policy.head.sample
    monkeypatch.setattr(policy.head, "sample", lambda *given: whole(*given)[:, 1:])
    with pytest.raises(StageError, match=r"head 'diffusion' .* shape \(2, 7, 8\); expected \(2, 8, 8\)"):
        sampled(policy, 2)


def test_a_head_whose_loss_is_no_number_is_named(
    make_store, policy_config, train_config, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DiffusionHead, "loss", lambda self, condition, actions, generator: condition.sum(1))
    with pytest.raises(
        StageError, match=r"head 'diffusion' .* a loss of shape \(\d+,\); expected one number"
    ):
        train(make_store(1, 2), LOCAL, policy_config, train_config, tmp_path / "policy")


def test_without_steps_of_diffusion_the_regression_acts() -> None:
    torch.manual_seed(0)
    refined = {"head.name": "refined", "head.regression.hidden": (32,), "head.diffusion.inference_steps": 0}
    config = small_policy(**refined)
    policy = Policy(config, LOCAL).eval()
    features = torch.randn(2, 3, policy.encoder.features)
    proprio, context = torch.zeros(2, 3, 8), torch.zeros(2, 3, 0)
    assert isinstance(policy.head, RefinedHead)
    regressed = policy.head.regression.layers(policy.condition(features, proprio, context))
    found = policy.act(features, proprio, context, [torch.Generator().manual_seed(k) for k in range(2)])
    torch.testing.assert_close(found, policy.normaliser.action.restore(regressed))


@pytest.mark.slow
def test_the_film_table_does_not_outlive_its_weights() -> None:
    torch.manual_seed(0)
    policy = Policy(small_policy(), LOCAL).eval()
    before = sampled(policy, 1)
    policy.train()
    with torch.no_grad():
        assert isinstance(policy.head, DiffusionHead)
        policy.head.unet.film.weight.mul_(3.0)
    policy.eval()
    assert not torch.allclose(sampled(policy, 1), before)


def test_relative_actions_are_added_to_the_measured_joints() -> None:
    torch.manual_seed(0)
    config = small_policy(relative_actions=True)
    policy = Policy(config, LOCAL).eval()
    moved = torch.zeros(1, 3, 8)
    moved[:, -1] = 0.5
    policy.normaliser.proprio.radius.fill_(1e9)  # the network sees no difference
    features = torch.zeros(1, 3, policy.encoder.features)
    still, there = (
        policy.act(features, proprio, torch.zeros(*proprio.shape[:2], 0), [torch.Generator().manual_seed(0)])
        for proprio in (torch.zeros_like(moved), moved)
    )
    assert torch.allclose(there - still, torch.tensor([0.5] * 7 + [0.0]).expand(1, 8, 8), atol=1e-5)
