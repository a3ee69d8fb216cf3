"""Training: resumable bit for bit, never silently reused, and it learns."""

import json
import math
import random
import re
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from rf_exp.errors import ArgumentError, StageError
from rf_exp.policy import (
    CURVES,
    LEARNER,
    MODEL,
    Curve,
    Policy,
    PolicyConfig,
    Stream,
    TrainConfig,
    Training,
    View,
    Windows,
    device_of,
    load_policy,
    train,
    views,
)
from rf_exp.policy.learning.checkpoint import CONFIG, STATE, read_tensors, write_tensors
from rf_exp.policy.learning.training import learning_rate
from rf_exp.policy.networks.heads import DiffusionHead
from rf_exp.store import Store
from tests.children import small_files
from tests.policy.conftest import ARCHS, STEPS, STILL, rows, small_training, training_of, varied

LOCAL = View("agent1", (Stream("agent1", (1,)),))


@pytest.fixture
def store(make_store: Callable[[int, int], Store]) -> Store:
    return make_store(2, 3)


def interrupt(_: Curve, number: int = signal.SIGINT) -> None:
    signal.raise_signal(number)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_resuming_equals_an_uninterrupted_run(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path, number: int
) -> None:
    straight = train(store, LOCAL, policy_config, train_config, tmp_path / "straight")
    broken = tmp_path / "broken"
    with pytest.raises(KeyboardInterrupt):
        train(store, LOCAL, policy_config, train_config, broken, partial(interrupt, number=number))
    with (broken / CURVES).open("a") as file:
        file.write("5,6,")  # half a row, as a kill leaves it
    assert (broken / STATE).exists()
    assert not (broken / MODEL).exists()
    assert train(store, LOCAL, policy_config, train_config, broken) == broken
    assert not (broken / STATE).exists()
    expected, found = load_file(straight / MODEL), load_file(broken / MODEL)
    assert expected.keys() == found.keys()
    assert all(torch.equal(found[name], expected[name]) for name in expected)
    columns = ("step", "loss", "learning_rate", "epoch")
    curves = [[[row[name] for name in columns] for row in rows(f)] for f in (straight, broken)]
    assert curves[0] == curves[1]
    assert [row[0] for row in curves[0]] == ["4", "6"]


def losses(training: Training) -> list[float]:
    """Losses of the curves of a training, which is run to its end."""
    found = []
    while not training.done:
        if (curve := training.step()) is not None:
            found.append(curve.loss)
    return found


@pytest.mark.slow
def test_checkpoints_between_curves_resume_too(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    """A state saved in the middle of the average of a curve keeps that average."""
    windows = Windows(store, LOCAL, policy_config, torch.device("cpu"))
    straight = Training(windows, LOCAL, policy_config, train_config)
    expected = losses(straight)
    early = Training(windows, LOCAL, policy_config, train_config)
    for _ in range(3):
        early.step()
    early.save(tmp_path / STATE)
    late = Training(windows, LOCAL, policy_config, train_config)
    late.resume(tmp_path / STATE)
    assert losses(late) == expected
    averages = straight.averaged().state_dict(), late.averaged().state_dict()
    assert all(torch.equal(value, averages[1][name]) for name, value in averages[0].items())


def test_the_handler_of_ctrl_c_is_restored_afterwards(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        train(store, LOCAL, policy_config, train_config, tmp_path, interrupt)
    assert signal.getsignal(signal.SIGINT) is before


def test_trains_outside_the_main_thread(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    config = replace(train_config, steps=1)
    thread = threading.Thread(target=train, args=(store, LOCAL, policy_config, config, tmp_path))
    thread.start()
    thread.join()
    assert (tmp_path / MODEL).exists()


def test_a_finished_folder_is_returned_untouched(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    train(store, LOCAL, policy_config, train_config, tmp_path)
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()}
    again = replace(train_config, device="auto", log_every=1)  # they do not affect the weights
    assert train(store, LOCAL, policy_config, again, tmp_path, interrupt) == tmp_path
    assert {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()} == before


def test_another_configuration_is_named_key_by_key(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    train(store, LOCAL, policy_config, train_config, tmp_path)
    with pytest.raises(StageError) as error:
        train(store, LOCAL, varied(policy_config, {"crop": 0.8}), replace(train_config, seed=4), tmp_path)
    assert str(error.value) == (
        f"{tmp_path} was made from another configuration "
        "(policy.crop: found 0.9, wanted 0.8; train.seed: found 0, wanted 4); "
        "delete the folder or choose another `out`"
    )


@pytest.mark.slow
def test_the_policy_loads_as_it_was_saved(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    shared = views(ARCHS[1], 2)[0]
    train(store, shared, policy_config, train_config, tmp_path)
    policy, view, _ = load_policy(tmp_path, "cpu")
    assert view == shared
    assert policy.config == policy_config
    saved = load_file(tmp_path / MODEL)
    assert saved.keys() == policy.state_dict().keys()
    assert all(torch.equal(value, saved[name]) for name, value in policy.state_dict().items())
    assert not torch.equal(policy.normaliser.action.radius, torch.ones(8))
    provenance = json.loads((tmp_path / "config.json").read_text())
    assert provenance["data"] == {"identity": store.identity, "seeds": [0, 1, 2]}


@pytest.mark.slow
def test_every_flipped_bit_is_noticed(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    """In weights, header and configuration: a policy that loads is the one that was trained."""
    train(store, LOCAL, policy_config, train_config, tmp_path)
    rng = random.Random(3)
    whole, *_ = load_policy(tmp_path, "cpu")
    weights = (tmp_path / MODEL).read_bytes()
    header = 8 + int.from_bytes(weights[:8], "little")
    bits = [*range(0, 8 * header, 997), *(rng.randrange(8 * header, 8 * len(weights)) for _ in range(20))]
    for name, content, flips in (
        (MODEL, weights, bits),
        (CONFIG, (tmp_path / CONFIG).read_bytes(), [rng.randrange(8 * 500) for _ in range(30)]),
    ):
        for bit in flips:
            flipped = bytearray(content)
            flipped[bit // 8] ^= 1 << bit % 8
            (tmp_path / name).write_bytes(flipped)
            try:
                policy, view, _ = load_policy(tmp_path, "cpu")
            except StageError as error:
                assert re.search(rf"{name} is damaged.*train again \(stages=\[train\]\)", str(error))
            else:  # for instance a blank between two values
                assert (policy.config, view) == (policy_config, LOCAL)
                for key, value in whole.state_dict().items():
                    assert torch.equal(value, policy.state_dict()[key])
        (tmp_path / name).write_bytes(content)


def test_weights_of_an_earlier_version_are_refused(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    train(store, LOCAL, policy_config, train_config, tmp_path)
    save_file(load_file(tmp_path / MODEL), tmp_path / MODEL, {"view": LOCAL.name})  # without a checksum
    with pytest.raises(StageError, match=r"model\.safetensors is damaged: it has no checksum"):
        load_policy(tmp_path, "cpu")


def test_training_does_not_resume_from_a_damaged_state(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(store, LOCAL, policy_config, train_config, tmp_path, interrupt)
    state = bytearray((tmp_path / STATE).read_bytes())
    state[-100] ^= 4
    (tmp_path / STATE).write_bytes(state)
    with pytest.raises(StageError, match=r"state\.safetensors is damaged: .* delete it and train again"):
        train(store, LOCAL, policy_config, train_config, tmp_path)


def test_leftovers_of_a_kill_are_removed(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    (tmp_path / ".state.safetensors.0123abcd.partial").mkdir()
    train(store, LOCAL, policy_config, train_config, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {CONFIG, MODEL, CURVES}


def test_an_empty_configuration_is_reported_with_a_remedy(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    (tmp_path / CONFIG).write_text("")
    with pytest.raises(
        StageError, match=r"config\.json is damaged: it is empty; delete the folder and train"
    ):
        train(store, LOCAL, policy_config, train_config, tmp_path)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_weights_and_another_does_not(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    torch.manual_seed(1)
    folders = [train(store, LOCAL, policy_config, train_config, tmp_path / "a")]
    torch.manual_seed(2)  # the state of the global generator must not matter
    folders.append(train(store, LOCAL, policy_config, train_config, tmp_path / "b"))
    folders.append(train(store, LOCAL, policy_config, replace(train_config, seed=1), tmp_path / "c"))
    first, same, other = ((folder / MODEL).read_bytes() for folder in folders)
    assert first == same
    assert first != other


LOSSES = {10: {"compact": -3.78668, "keypoints": 1.06927, "privileged": -3.31499}}
CHANGES: dict[str, dict[str, Any]] = {
    "compact": {},
    "keypoints": {
        **{"encoder.name": "keypoints", "encoder.keypoints.steps": 4, "context": True, "crop": 1.0},
        **{"head.name": "refined", "head.regression.hidden": (32,), "head.refined.regression_steps": 4},
        **{"phases": True, "task_space_actions": True},
    },
    "privileged": {"encoder.name": "privileged", "context": True},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CHANGES)
def test_losses_of_this_version_of_the_learner_are_as_recorded(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path, kind: str
) -> None:
    """If this fails because learning has changed, raise LEARNER and record the new losses."""
    config = varied(policy_config, CHANGES[kind] | {"encoder.keypoints.shift_px": 8})
    folder = train(store, LOCAL, config, replace(train_config, log_every=2), tmp_path / kind)
    logs = sum(math.log(float(row["loss"])) for row in rows(folder))  # so that all count alike
    assert logs == pytest.approx(LOSSES[LEARNER][kind], abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["compact", "keypoints"])
def test_averaging_the_trained_parts_equals_averaging_all(
    store: Store,
    policy_config: PolicyConfig,
    train_config: TrainConfig,
    tmp_path: Path,
    kind: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    policy_config = varied(policy_config, CHANGES[kind])
    made = train(store, LOCAL, policy_config, train_config, tmp_path / "learned")
    fits = Policy.fits
    monkeypatch.setattr(
        Policy, "fits", lambda policy, on: [replace(fit, parts=[policy]) for fit in fits(policy, on)]
    )
    whole = train(store, LOCAL, policy_config, train_config, tmp_path / "everything")
    assert (made / MODEL).read_bytes() == (whole / MODEL).read_bytes()


def test_a_budget_in_epochs_is_that_many_passes(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig
) -> None:
    windows = Windows(store, LOCAL, policy_config, torch.device("cpu"))
    training = Training(windows, LOCAL, policy_config, replace(train_config, steps=None, epochs=2))
    assert training.steps == 2 * 5  # 72 windows in batches of at most 16


def test_acting_values_can_change_without_new_training(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    """Executed steps and the sampler may differ in a rollout, without training again."""
    train(store, LOCAL, policy_config, train_config, tmp_path)
    before = (tmp_path / MODEL).read_bytes()
    other = varied(policy_config, {"acting.action_steps": 2, "head.diffusion.inference_steps": 4})
    train(store, LOCAL, other, train_config, tmp_path)
    assert (tmp_path / MODEL).read_bytes() == before
    policy, *_ = load_policy(tmp_path, "cpu", other)
    assert policy.config == other and isinstance(policy.head, DiffusionHead)
    assert len(policy.head.scheduler.timesteps) == 4
    assert load_policy(tmp_path, "cpu")[0].config == policy_config
    with pytest.raises(StageError, match=r"configuration \(policy.horizon: found 8, wanted 16\)"):
        train(store, LOCAL, varied(other, {"horizon": 16}), train_config, tmp_path)


def test_policies_of_another_version_of_the_learner_are_refused(
    store: Store,
    policy_config: PolicyConfig,
    train_config: TrainConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    train(store, LOCAL, policy_config, train_config, tmp_path)
    monkeypatch.setattr("rf_exp.policy.learning.checkpoint.LEARNER", LEARNER + 1)
    message = rf"is by version {LEARNER} of the learner, this is version {LEARNER + 1}; delete the folder"
    with pytest.raises(StageError, match=message):
        load_policy(tmp_path, "cpu")


def test_loading_from_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"no trained policy in .*: model.safetensors is missing; train it"):
        load_policy(tmp_path)


def test_an_exploding_loss_stops_the_training(
    store: Store, policy_config: PolicyConfig, train_config: TrainConfig, tmp_path: Path
) -> None:
    config = replace(train_config, learning_rate=1e30, steps=20)
    with pytest.raises(
        StageError, match=r"the training loss is (nan|inf) at step \d+; .* lower learning_rate"
    ):
        train(store, LOCAL, policy_config, config, tmp_path)


@pytest.mark.skipif(torch.cuda.is_available(), reason="asks what happens without a GPU")
def test_cuda_without_a_gpu() -> None:
    with pytest.raises(ArgumentError, match="torch finds no CUDA GPU; use device=cpu or device=auto"):
        device_of("cuda")


def test_learning_rate_warms_up_and_falls_to_zero() -> None:
    config = training_of(epochs=None, steps=100, warmup_steps=10, learning_rate=1.0)
    rates = [learning_rate(config, step, 100) for step in range(101)]
    assert rates[0] == pytest.approx(0.1)
    assert rates[9] == rates[10] == 1.0
    assert rates[55] == pytest.approx(0.5)
    assert rates[100] == pytest.approx(0.0)
    assert all(a >= b for a, b in pairwise(rates[10:]))


@pytest.mark.slow
def test_it_learns_to_reach_the_goal_of_the_block(
    make_store: Callable[[int, int], Store], policy_config: PolicyConfig, tmp_path: Path
) -> None:
    """From the picture alone, in unseen episodes, with less than half the error of the mean action."""
    curves: list[Curve] = []
    # Crops of these pictures do not show where they were cut from, so whole pictures are used.
    config = varied(policy_config, {"crop": 1.0, "head.diffusion.noise_draws": 4})
    budget = small_training(steps=900, batch_size=16, warmup_steps=20, log_every=50, device="cpu")
    train(make_store(1, 40), LOCAL, config, budget, tmp_path, curves.append)
    assert curves[-1].loss < 0.3 * curves[0].loss

    policy, view, _ = load_policy(tmp_path, "cpu")
    unseen = Windows(make_store(1, 60), view, config, torch.device("cpu"))
    batch = unseen.batch(np.arange(40, 60) * STEPS + STILL, None)  # each new episode's last window at rest
    generators = [torch.Generator().manual_seed(k) for k in range(len(batch))]
    with torch.inference_mode():
        features = policy.encode(batch.pictures)[batch.frames]
    predicted = policy.act(features, batch.proprio, batch.context, generators)
    moving = [0, 1, 3]
    error = (predicted - batch.action)[:, -1, moving].abs().mean().item()
    spread = (batch.action - batch.action.mean(dim=0))[:, -1, moving].abs().mean().item()
    assert error < 0.5 * spread, f"error {error:.4f} rad, spread {spread:.4f} rad"


def test_a_full_disk_is_reported_and_keeps_the_previous_file(tmp_path: Path) -> None:
    path, small = tmp_path / "model.safetensors", {"weight": torch.ones(4)}
    write_tensors(path, small, {"step": "1"})
    with small_files(10_000), pytest.raises(StageError) as error:
        write_tensors(path, {"weight": torch.ones(10_000)}, {"step": "2"})
    assert re.fullmatch(
        rf"cannot write {path}: .*File too large.*; free some space there, the same command goes on from .*",
        str(error.value),
    )
    tensors, metadata = read_tensors(path)
    assert tensors["weight"].tolist() == [1.0] * 4 and metadata == {"step": "1"}
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
