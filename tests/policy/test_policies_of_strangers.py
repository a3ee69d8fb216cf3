"""Policy folders from others: they are refused with the reason, or the policy acts as it did."""

import json
import re
import shutil
import tracemalloc
from collections.abc import Callable, Iterator
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from rf_exp.artifacts import digest
from rf_exp.errors import StageError
from rf_exp.policy import LEARNER, MODEL, PolicyConfig, Stream, TrainConfig, View, load_policy, train
from rf_exp.policy.bounds import merged
from rf_exp.policy.learning.checkpoint import CONFIG, load_tensors, read_tensors, write_tensors
from rf_exp.policy.networks.heads import RefinedHead
from rf_exp.store import Store

PLACE = View("agent1", (Stream("agent1", (1,)),))
DEEP = 200_000


@pytest.fixture(scope="module")
def sound(
    make_store: Callable[[int, int], Store],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A policy with all parts that there are, trained for two steps."""
    from tests.policy.conftest import HEIGHT, WIDTH, small_policy, small_training

    changes: dict[str, Any] = {
        "encoder.name": "keypoints",
        "context": True,
        "crop": 1.0,
        "head.name": "refined",
    }
    changes |= {
        "head.regression.hidden": (32,),
        "head.diffusion.trunk": (16,),
        "head.diffusion.channels": (8, 16),
    }
    changes |= {"phases": True, "task_space_actions": True, "horizon": 16}
    policy: PolicyConfig = small_policy(height=HEIGHT, width=WIDTH, **changes)
    training: TrainConfig = small_training(2, batch_size=8, warmup_steps=1, device="cpu")
    return train(make_store(2, 2), PLACE, policy, training, tmp_path_factory.mktemp("policy") / "agent1")


def signed(
    folder: Path, to: Path, configuration: Any = None, tensors: dict[str, Tensor] | None = None
) -> Path:
    """A copy of the policy with another configuration or other tensors, and valid checksums."""
    to.mkdir(exist_ok=True)
    shutil.copyfile(folder / CONFIG, to / CONFIG)
    kept, metadata = read_tensors(folder / MODEL)
    if configuration is not None:
        (to / CONFIG).write_text(
            configuration if isinstance(configuration, str) else json.dumps(configuration)
        )
        try:
            metadata = {"config": digest(json.loads((to / CONFIG).read_text()))}
        except Exception:  # invalid JSON has no digest
            metadata = {"config": ""}
    write_tensors(to / MODEL, kept if tensors is None else tensors, metadata)
    return to


def acts(folder: Path) -> Tensor:
    """(1, T, A) actions of the policy for features of zeros."""
    policy, view, spec = load_policy(folder, "cpu")
    # Tracing takes a second, and computes the same.
    assert isinstance(policy.head, RefinedHead)
    policy.head.diffusion.unet.traced = lambda *_: None  # pyright: ignore[reportAttributeAccessIssue]
    frames = policy.config.observation_steps
    features = torch.zeros(1, frames, policy.encoder.features)
    proprio, context = torch.zeros(1, frames, view.proprio_size), torch.zeros(1, frames, spec.size(view))
    return policy.act(features, proprio, context, [torch.Generator().manual_seed(0)])


def refused_or_same(folder: Path, expected: Tensor) -> str:
    """The error message for a policy; empty if it acts as the sound one."""
    try:
        found = acts(folder)
    except StageError as error:
        assert str(folder) in str(error) and len(str(error)) < 5000
        return str(error)
    assert torch.equal(found, expected)
    return ""


def mutants(tensors: dict[str, Tensor]) -> Iterator[tuple[str, dict[str, Tensor]]]:
    """Error, tensors: every tensor left out, reshaped, of another type or not finite; and additional ones."""
    for name, value in tensors.items():
        rest = {key: each for key, each in tensors.items() if key != name}
        yield f"{name} is missing", rest
        changed = {
            "has shape": [value[None], value.repeat(2, *[1] * (value.dim() - 1)), value[:0], torch.zeros(())],
            "is of type": [
                value.to(each) for each in (torch.complex64, torch.int8, torch.float64, torch.bool)
            ],
        }
        if value.numel():
            broken = [value.clone() for _ in range(3)]
            for each, bad in zip(broken, (torch.nan, torch.inf, -torch.inf), strict=True):
                each.flatten()[-1] = bad
            changed["not finite"] = broken
        for why, others in changed.items():
            for other in others:
                if other.shape != value.shape or other.dtype != value.dtype or why == "not finite":
                    yield why, {**rest, name: other}
    yield "not one of its tensors", {**tensors, "more": torch.zeros(3)}
    yield "not one of its tensors", {**tensors, "\x1b]0;more\x07": torch.zeros(3)}
    yield "and", {}


@pytest.mark.slow
def test_tensors_that_do_not_fit_the_configuration_are_refused(sound: Path, tmp_path: Path) -> None:
    expected, (tensors, _), policy = acts(sound), read_tensors(sound / MODEL), load_policy(sound, "cpu")[0]
    found = list(mutants(tensors))
    assert len(found) > 9 * len(tensors)
    for why, changed in found:
        with pytest.raises(StageError, match=re.escape(why)) as refused:
            load_tensors(policy, changed, sound / MODEL)
        assert str(refused.value).isprintable()
    for why, changed in found[-3:] + found[:: len(found) // 20]:  # as files, too
        assert why in refused_or_same(signed(sound, tmp_path / "theirs", tensors=changed), expected)
    assert not refused_or_same(signed(sound, tmp_path / "theirs", tensors=dict(tensors)), expected)
    acts(
        signed(sound, tmp_path / "theirs", tensors={name: each.bfloat16() for name, each in tensors.items()})
    )


def paths(node: Any, at: tuple = ()) -> Iterator[tuple]:
    """The path of keys of each value in a configuration."""
    if at:
        yield at
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in inner:
        yield from paths(value, (*at, key))


def changed(configuration: Any, at: tuple, value: Any, drop: bool = False) -> Any:
    """The configuration with another value at the path `at`, or with `drop` without it."""
    copy = json.loads(json.dumps(configuration))
    within = copy
    for key in at[:-1]:
        within = within[key]
    if drop:
        del within[at[-1]]
    else:
        within[at[-1]] = value
    return copy


DISTORTED = (None, "x\x1b[2J", -1, 10**9, 1e9, 1e400, [], {}, [[[]]], [10**9] * 9, {"a": {}}, "9" * 10_000)


@pytest.mark.slow
def test_a_distorted_configuration_is_refused_or_means_the_same(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For every key of the policy and its inputs; keys about its training may have any value."""
    monkeypatch.setattr("os.fsync", lambda _: None)  # hundreds of files that need not survive a crash
    expected, configuration = acts(sound), json.loads((sound / CONFIG).read_text())
    checked = [
        at
        for at in paths(configuration)
        if at[0] in ("learner", "policy", "acting", "view", "spec") or len(at) == 1
    ]
    refused = 0
    for at in checked:
        kept = [changed(configuration, at, None, drop=True)]
        if isinstance(at[-1], str):
            kept.append(changed(configuration, (*at[:-1], f"{at[-1]}_"), 1))
        kept += [changed(configuration, at, value) for value in DISTORTED[len(str(at)) % 3 :: 3]]
        for each in kept:
            message = refused_or_same(signed(sound, tmp_path / "theirs", each), expected)
            assert message.isprintable()
            refused += bool(message)
    assert refused > 4 * len(checked)


@pytest.mark.parametrize(
    "key",
    [
        *("horizon", "observation_steps", "head.diffusion.channels", "head.diffusion.train_timesteps"),
        *("head.diffusion.trunk", "head.regression.hidden", "encoder.keypoints.downsample"),
    ],
)
def test_sizes_that_no_machine_has_are_refused_before_allocation(
    sound: Path, tmp_path: Path, key: str
) -> None:
    configuration, at = json.loads((sound / CONFIG).read_text()), ("policy", *key.split("."))
    name = at[-1]
    for size in (10**9, 2**62, 10**400):
        value = [8, size] if isinstance(reduce(getitem, at, configuration), list) else size
        signed(sound, tmp_path / "theirs", changed(configuration, at, value))
        tracemalloc.start()
        with pytest.raises(StageError, match=rf"not a valid policy configuration: {name} is .*at most \d+"):
            load_policy(tmp_path / "theirs", "cpu")
        assert tracemalloc.get_traced_memory()[1] < 50e6
        tracemalloc.stop()


class LargestAllocation(TorchDispatchMode):
    """Records the size of the largest tensor in memory."""

    def __init__(self) -> None:
        super().__init__()
        self.largest = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        for each in tree_leaves(out):
            if isinstance(each, Tensor) and each.device.type == "cpu":
                self.largest = max(self.largest, each.numel())
        return out


@pytest.mark.parametrize(
    "most",
    [
        {"horizon": 512},
        {"head": {"diffusion": {"channels": [8192] * 8}}, "horizon": 128},
        {"head": {"diffusion": {"trunk": [8192] * 8}}},
        {"head": {"regression": {"hidden": [8192] * 8}}},
    ],
)
def test_a_network_larger_than_its_file_is_refused_before_allocation(
    sound: Path, tmp_path: Path, most: dict[str, Any]
) -> None:
    configuration = json.loads((sound / CONFIG).read_text())
    configuration["policy"] = merged(configuration["policy"], most)
    signed(sound, tmp_path / "theirs", configuration)
    with LargestAllocation() as allocation, pytest.raises(StageError, match="does not fit its configuration"):
        load_policy(tmp_path / "theirs", "cpu")
    assert 0 < allocation.largest < 10**6


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[" * DEEP + "]" * DEEP, "it holds no JSON"),
        ('{"policy":' * DEEP + "1" + "}" * DEEP, "it holds no JSON"),
        ("[]", "holds a list; expected an object"),
        ("{}", "by version None of the learner"),
        (f'{{"learner": {LEARNER}}}', "lacks the key 'view'"),
        ("3", "holds a int; expected an object"),
        ("", "it is empty"),
        ('{"a": NaN}', "is not a valid policy configuration"),
    ],
)  # fmt: skip
def test_invalid_configurations_are_refused(sound: Path, tmp_path: Path, content: str, message: str) -> None:
    signed(sound, tmp_path / "theirs", content)
    with pytest.raises(StageError, match=message):
        load_policy(tmp_path / "theirs", "cpu")


def test_a_policy_without_its_configuration_is_refused(sound: Path, tmp_path: Path) -> None:
    (signed(sound, tmp_path / "theirs") / CONFIG).unlink()
    with pytest.raises(StageError, match=r"config.json cannot be read"):
        load_policy(tmp_path / "theirs", "cpu")
