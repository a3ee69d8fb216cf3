"""Crop refinement: more precise than the first pass, if that is near enough."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rf_exp.errors import ArgumentError
from rf_exp.policy import PolicyConfig, Stream, TrainConfig, View, load_policy, load_runners, rollout, train
from rf_exp.policy.config import KeypointsConfig
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS
from rf_exp.policy.examples.windows import Labels
from rf_exp.policy.inputs.observation_spec import ObservationSpec
from rf_exp.policy.networks.keypoint_encoder import LARGEST_CROP_OFFSET, CropRefinement, KeypointEncoder
from tests.policy.conftest import HEIGHT, WIDTH, varied
from tests.policy.test_rollout import Table, judge

LOCAL = View("agent1", (Stream("agent1", (1,)),))
SIDE = 16
ENCODER = {"encoder.name": "keypoints", "context": True, "crop": 1.0}
KEYPOINTS = KeypointsConfig(
    2, 0, noise=0.0, steps=0, rate=1.0, shift_px=0, photometric=0.0, dilations=(1, 2, 4)
)
CONFIGS = {side: replace(KEYPOINTS, crop_refinement=side) for side in (0, SIDE)}
SIZE = torch.tensor([64, 48])


def dots(count: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures of two blobs, each in its own colour channel, and the places of the blobs in [0, 1]."""
    true = rng.uniform(0.02, 0.98, (count, 2, 2))
    rows, columns = np.mgrid[:48, :64] + 0.5
    pictures = np.full((count, 3, 48, 64), -0.2, np.float32)
    for picture, points in zip(pictures, true, strict=True):
        for colour, (x, y) in enumerate(points):
            picture[colour] += np.exp(-((columns - 64 * x) ** 2 + (rows - 48 * y) ** 2) / 4)
    return torch.from_numpy(pictures), torch.from_numpy(true.astype(np.float32))


@pytest.mark.slow
def test_places_off_by_four_pixels_are_refined_to_half_a_pixel() -> None:
    """Also in corners, where the crop is moved back into the picture."""
    torch.manual_seed(0)
    refinement, rng = CropRefinement(2, SIDE), np.random.default_rng(0)
    optimiser = torch.optim.AdamW(refinement.parameters(), 4e-3)

    def first_pass(true: torch.Tensor) -> torch.Tensor:
        error = rng.uniform(-LARGEST_CROP_OFFSET * SIDE, LARGEST_CROP_OFFSET * SIDE, true.shape).astype(
            np.float32
        )
        return true + torch.from_numpy(error) / SIZE

    for _ in range(300):
        pictures, true = dots(16, rng)
        true[0, 0] = torch.nan
        loss, _ = refinement.loss(pictures, first_pass(true.nan_to_num(0.5)), true)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    pictures, true = dots(200, rng)
    with torch.no_grad():
        error = ((refinement(pictures, first_pass(true))[0] - true) * SIZE).norm(dim=2)
    assert error.median() < 0.5
    assert error.quantile(0.9) < 1.5


def test_points_outside_the_picture_have_no_loss() -> None:
    refinement, nowhere = CropRefinement(2, SIDE), torch.full((3, 2, 2), torch.nan)
    loss, _ = refinement.loss(torch.zeros(3, 3, 48, 64), torch.rand(3, 2, 2, requires_grad=True), nowhere)
    loss.backward()
    assert loss.item() == 0.0


def test_heat_maps_get_no_gradient_from_the_refinement() -> None:
    """The refinement uses only the place of the crop from them, without a gradient."""
    torch.manual_seed(0)
    spec = ObservationSpec(bases=((0.0, 0.0, 0.0),))
    one, other = (KeypointEncoder(CONFIGS[side], LOCAL, spec) for side in (SIDE, 0))
    shared = {n: v for n, v in one.state_dict().items() if not n.startswith("crop_refinement.")}
    other.load_state_dict(shared)
    rays = torch.rand(2, 1, 3, 4)
    places, points = torch.rand(2, 2 * len(GRIPPER_POINTS), 2), torch.zeros(2, 2 * len(GRIPPER_POINTS), 3)
    labels = Labels(places, points, torch.zeros(2, 2, 6), torch.zeros(2, 0))
    batch = torch.rand(2, 3, 48, 64), rays, labels
    for encoder in (one, other):
        encoder.loss(*batch).backward()
    gradients = {name: weight.grad for name, weight in one.named_parameters()}
    assert all(
        torch.equal(g, w.grad)
        for n, w in other.named_parameters()
        if (g := gradients[n]) is not None and w.grad is not None
    )
    assert one.crop_refinement is not None
    assert all(w.grad is not None for w in one.crop_refinement.parameters())


@pytest.mark.slow
def test_a_policy_with_crop_refinement_learns_and_acts(
    make_store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    changes = {"downsample": 2, "crop_refinement": 12, "steps": 3}
    config = varied(
        policy_config, ENCODER | {f"encoder.keypoints.{key}": each for key, each in changes.items()}
    )
    train(make_store(1, 3), LOCAL, config, train_config, tmp_path / "agent1")
    policy, *_ = load_policy(tmp_path / "agent1", "cpu")
    features, places = policy.encode_centre_crops(torch.zeros(1, HEIGHT, WIDTH, 3, dtype=torch.uint8))
    assert places is not None and features.shape[0] == places.shape[0] == 1
    assert rollout(Table(1), judge, load_runners(tmp_path), 1, 2).steps == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoder.keypoints.downsample": 0}, "downsample is 0; expected 1 or above"),
        ({"encoder.keypoints.downsample": 5}, "height is 32; expected a multiple of 20 with"),
        ({"width": 47}, "width is 47; expected a multiple of 4 with encoder keypoints"),
        ({"encoder.keypoints.crop_refinement": 4}, "crop_refinement is 4; expected 0, or 8 to 32 pixels"),
        ({"encoder.keypoints.crop_refinement": 33}, "crop_refinement is 33; expected 0, or 8 to 32 pixels"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(policy_config: PolicyConfig, change: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        varied(policy_config, ENCODER | change)
