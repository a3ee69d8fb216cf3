"""openpi's transforms: an observation and a row of an export come out alike, and commands come back."""

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


def test_an_observation_and_a_row_of_an_export_are_one_to_the_model() -> None:
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


def test_a_chunk_loses_what_it_was_padded_with() -> None:
    chunk = np.arange(50 * 32.0).reshape(50, 32)
    np.testing.assert_array_equal(Outputs(AGENTS)({"actions": chunk})["actions"], chunk[:, :16])


def test_no_camera_is_an_error_that_says_which_were_asked_for() -> None:
    with pytest.raises(ValueError, match="'global', 'agent1', 'agent2'"):
        Inputs(AGENTS)({"qpos": np.zeros((AGENTS, 9))})
