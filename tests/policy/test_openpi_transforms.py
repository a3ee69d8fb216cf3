"""Transforms for openpi: observations and exported rows give the same inputs; chunks lose their padding."""

import numpy as np
import pytest

from examples.foreign.openpi_transforms import SLOTS, Inputs, Outputs

AGENTS = 2


def observation(rng: np.random.Generator) -> dict[str, object]:
    fingers = np.repeat([[0.04], [0.0]], 2, axis=1)
    return {
        "qpos": np.hstack([rng.normal(size=(AGENTS, 7)), fingers]).astype(np.float32),
        "rgb_agent1": rng.integers(256, size=(6, 8, 3), dtype=np.uint8),
        "rgb_agent2": rng.integers(256, size=(6, 8, 3), dtype=np.uint8),
        "language": "Lift it.",
    }


def test_an_observation_and_an_exported_row_give_the_same_inputs() -> None:
    seen = observation(np.random.default_rng(0))
    row = {
        "observation.state": np.asarray(seen["qpos"]).ravel(),
        "prompt": seen["language"],
        "action": np.zeros((5, AGENTS * 8)),
        **{
            f"observation.images.{name}": np.moveaxis(np.asarray(seen[f"rgb_{name}"]), -1, 0)
            / np.float32(255)
            for name in ("agent1", "agent2")
        },
    }
    live, stored = Inputs(AGENTS)(seen), Inputs(AGENTS)(row)
    assert stored.pop("actions").shape == (5, AGENTS * 8)
    np.testing.assert_array_equal(live["state"], stored["state"])
    np.testing.assert_allclose(live["state"].reshape(AGENTS, 8)[:, 7], [1, -1], atol=1e-6)
    for slot in SLOTS:
        np.testing.assert_array_equal(live["image"][slot], stored["image"][slot])
    assert [bool(live["image_mask"][slot]) for slot in SLOTS] == [True, True, False]
    assert live["prompt"] == stored["prompt"] == "Lift it."


def test_a_chunk_loses_its_padding() -> None:
    chunk = np.arange(50 * 32.0).reshape(50, 32)
    np.testing.assert_array_equal(Outputs(AGENTS)({"actions": chunk})["actions"], chunk[:, :16])


def test_missing_cameras_are_named() -> None:
    with pytest.raises(ValueError, match="'global', 'agent1', 'agent2'"):
        Inputs(AGENTS)({"qpos": np.zeros((AGENTS, 9))})
