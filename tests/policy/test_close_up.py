"""A second look at the whole picture: finer than the first, wherever that has come near."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import PolicyConfig, Stream, TrainConfig, View, load_policy, load_runners, rollout, train
from rf_exp.policy.examples.keypoints import HAND
from rf_exp.policy.networks.crop_refinement import REACH, CloseUp
from rf_exp.policy.networks.keypoint_encoder import Eyes
from tests.policy.conftest import HEIGHT, WIDTH
from tests.policy.test_rollout import Table, judge

LOCAL = View("agent1", (Stream("agent1", (1,)),))
SIDE = 16
SIZE = torch.tensor([64, 48])


def dots(count: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures of two points, each in its colour, and where in them they are."""
    true = rng.uniform(0.02, 0.98, (count, 2, 2))
    rows, columns = np.mgrid[:48, :64] + 0.5
    pictures = np.full((count, 3, 48, 64), -0.2, np.float32)
    for picture, points in zip(pictures, true, strict=True):
        for colour, (x, y) in enumerate(points):
            picture[colour] += np.exp(-((columns - 64 * x) ** 2 + (rows - 48 * y) ** 2) / 4)
    return torch.from_numpy(pictures), torch.from_numpy(true.astype(np.float32))


@pytest.mark.slow
def test_it_finds_to_half_a_pixel_what_was_seen_to_four() -> None:
    """In corners too, where a square is pushed back into the picture."""
    torch.manual_seed(0)
    again, rng = CloseUp(2, SIDE), np.random.default_rng(0)
    optimiser = torch.optim.AdamW(again.parameters(), 4e-3)

    def seen(true: torch.Tensor) -> torch.Tensor:
        off = rng.uniform(-REACH * SIDE, REACH * SIDE, true.shape).astype(np.float32)
        return true + torch.from_numpy(off) / SIZE

    for _ in range(300):
        pictures, true = dots(16, rng)
        true[0, 0] = torch.nan
        loss = again.loss(pictures, seen(true.nan_to_num(0.5)), true)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    pictures, true = dots(200, rng)
    with torch.no_grad():
        off = ((again(pictures, seen(true)) - true) * SIZE).norm(dim=2)
    assert off.median() < 0.5
    assert off.quantile(0.9) < 1.5


def test_it_learns_nothing_of_what_is_not_in_the_picture() -> None:
    again, nowhere = CloseUp(2, SIDE), torch.full((3, 2, 2), torch.nan)
    loss = again.loss(torch.zeros(3, 3, 48, 64), torch.rand(3, 2, 2, requires_grad=True), nowhere)
    loss.backward()
    assert loss.item() == 0.0


def test_heat_maps_learn_nothing_from_the_second_look() -> None:
    """What it needs of theirs is where to look, which has no gradient."""
    torch.manual_seed(0)
    one, other = Eyes(1, shrink=2, close_up=SIDE), Eyes(1, shrink=2)
    other.load_state_dict({n: v for n, v in one.state_dict().items() if not n.startswith("close_up.")})
    what = torch.rand(2, 3, 48, 64), torch.rand(2, len(HAND), 2), torch.zeros(2, 1, 6), torch.zeros(2, 0)
    for eyes in (one, other):
        eyes.loss(*what).backward()
    gradients = {name: weight.grad for name, weight in one.named_parameters()}
    assert all(
        torch.equal(g, w.grad)
        for n, w in other.named_parameters()
        if (g := gradients[n]) is not None and w.grad is not None
    )
    assert one.close_up is not None and all(w.grad is not None for w in one.close_up.parameters())


@pytest.mark.slow
def test_a_policy_learns_with_it_and_acts(
    make_store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    eyes = {"encoder": "heatmaps", "context": True, "crop": 1.0, "shrink": 2, "close_up": 12}
    config = replace(policy_config, **eyes)  # pyright: ignore[reportArgumentType]
    budget = replace(train_config, eyes_steps=3)
    train(make_store(1, 3), LOCAL, config, budget, tmp_path / "agent1")
    policy, *_ = load_policy(tmp_path / "agent1", "cpu")
    features, places = policy.look(torch.zeros(2, HEIGHT, WIDTH, 3, dtype=torch.uint8))
    assert places is not None and features.shape[0] == places.shape[0] == 2
    assert rollout(Table(1), judge, load_runners(tmp_path), 1, 2).steps == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shrink": 2}, "shrink is 2; expected 1 with encoder=compact"),
        ({"close_up": 16}, "close_up is 16; expected 0 with encoder=compact"),
        ({"encoder": "heatmaps", "shrink": 0}, "shrink is 0; expected 1 or above"),
        ({"encoder": "heatmaps", "shrink": 5}, "height is 32; expected a multiple of 20 with"),
        ({"encoder": "heatmaps", "width": 47}, "width is 47; expected a multiple of 4 with encoder=heatmaps"),
        ({"encoder": "heatmaps", "close_up": 4}, "close_up is 4; expected 0, or 8 to 32 pixels"),
        ({"encoder": "heatmaps", "close_up": 33}, "close_up is 33; expected 0, or 8 to 32 pixels"),
    ],
)
def test_what_does_not_fit_is_told(policy_config: PolicyConfig, change: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        replace(policy_config, **{"context": True, "crop": 1.0, "encoder": "compact", **change})
