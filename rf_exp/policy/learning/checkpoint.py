"""The folder of a policy: configuration, weights with normaliser, curves; never a pickle.

config.json         policy, acting, view, spec, train, data: its provenance; written before training starts
model.safetensors   averaged weights and normaliser, and the digest of config.json; exists once finished
curves.csv          loss and learning rate over the steps
state.safetensors   to resume an interrupted training; removed at the end

Tensors are written with a SHA-256 of all contents of their file, which is checked on reading. It detects
accidents, not tampering. So the folder of a stranger is read as data: every number of its configuration is
bounded, and before a network is created, its tensors are compared with those of one that takes no memory.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from rf_exp.artifacts import (
    atomic_path,
    digest,
    expect_same,
    find_differences,
    plain,
    read_json,
    remove_stale_drafts,
    restored,
    write_json,
)
from rf_exp.errors import ArgumentError, StageError, refuse_access
from rf_exp.policy.config import LEARNER, MODEL, PolicyConfig
from rf_exp.policy.inputs.observation_spec import ObservationSpec
from rf_exp.policy.inputs.view import View
from rf_exp.policy.learning.curves import CURVES
from rf_exp.policy.networks.policy import Policy
from rf_exp.texts import printable

CONFIG, STATE = "config.json", "state.safetensors"
METADATA_KEY = "rf_exp"  # the only key of a file's metadata: the order of several would be random
CHECKSUM = "sha256"
SMALLEST_HALVED = 1024  # values of a tensor from which on half precision suffices; ranges and rays have fewer
TENSOR_TYPES = (torch.float32, torch.bfloat16)  # types of tensors: as trained, or halved
MOST_LISTED = 3  # tensors that an error lists
TRAIN_AGAIN = "delete the folder and train again (stages=[train])"


def device_of(name: str) -> torch.device:
    """`auto` is the GPU where there is one. Raises ArgumentError for cuda without one."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ArgumentError("device is 'cuda', but torch finds no CUDA GPU; use device=cpu or device=auto")
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Replace a safetensors file atomically. Raises StageError where it cannot be written."""
    contents = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    with atomic_path(path) as draft:
        full_metadata = {**metadata, CHECKSUM: _checksum(contents, metadata)}
        try:
            save_file(contents, draft, {METADATA_KEY: json.dumps(full_metadata, sort_keys=True)})
        except SafetensorError as error:
            raise StageError(
                f"cannot write {path}: {error}; free some space there, the same command goes on from here"
            ) from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a file. Raises StageError where it is damaged."""
    with _opened(path) as file:
        metadata = _metadata(file)
        expected = metadata.pop(CHECKSUM)
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator
        actual = _checksum(tensors, metadata)
    if expected != actual:
        raise _damaged(path, "its contents do not match its checksum")
    return tensors, metadata


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open safetensors file; any error due to damaged bytes becomes a StageError that names it."""
    try:
        path.open("rb").close()  # for the reason of a failure, which safetensors does not give
        with safe_open(path, "pt") as file:
            yield file
    except Exception as error:
        refuse_access(path, error)
        raise _damaged(path, str(error)) from error


def _metadata(file: Any) -> dict[str, str]:
    """The metadata of an open file, CHECKSUM included."""
    metadata = json.loads((file.metadata() or {}).get(METADATA_KEY, "{}"))
    if CHECKSUM not in metadata:
        raise ValueError("it has no checksum")
    return metadata


def _checksum(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    sha = hashlib.sha256(repr(sorted(metadata.items())).encode())
    for name, value in sorted(tensors.items()):
        sha.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        sha.update(value.reshape(-1).view(torch.uint8).numpy().data)
    return sha.hexdigest()


def _damaged(path: Path, what: str) -> StageError:
    return StageError(f"{path} is damaged: {what}; delete it and train again (stages=[train])")


def claim(folder: Path, provenance: Mapping[str, Any]) -> bool:
    """Claim a folder for a training; returns whether it is finished already. Raises as `expect_policy`."""
    remove_stale_drafts(folder)
    if (folder / CONFIG).exists():
        expect_policy(folder, provenance)
    else:
        write_json(folder / CONFIG, plain(provenance))
    return (folder / MODEL).exists()


def expect_policy(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Raises StageError naming what differs unless a folder's policy has this provenance, but for acting."""
    config = _read_config(folder)
    actual, expected = (
        {key: values.get(key) for key in wanted if key != "acting"} for values in (config, wanted)
    )
    expect_same(folder, actual, expected, "delete the folder or choose another `out`")


def provenance(folder: Path) -> dict[str, Any]:
    """Provenance of a trained policy, with the checksum of its weights. Raises StageError if missing."""
    _require_model(folder)
    with _opened(folder / MODEL) as file:
        weights = _metadata(file)[CHECKSUM]
    return {**_read_config(folder), "weights": weights}


def _read_config(folder: Path) -> dict[str, Any]:
    """The configuration of a policy, as plain values. Raises StageError for one that is no object."""
    config = read_json(folder / CONFIG, TRAIN_AGAIN)
    if not isinstance(config, dict):
        raise StageError(
            f"{folder / CONFIG} holds a {type(config).__name__}; expected an object; {TRAIN_AGAIN}"
        )
    return config


def load_policy(
    folder: Path, device: str = "auto", acting: PolicyConfig | None = None
) -> tuple[Policy, View, ObservationSpec]:
    """A trained policy, ready to act, its view and its spec.

    It acts as configured when it was trained, or as in `acting`. Raises StageError for a policy that is
    missing, damaged, or by another version of the learner.
    """
    _require_model(folder)
    tensors, metadata = read_tensors(folder / MODEL)
    node = _read_config(folder)
    with _config_errors(folder / CONFIG):
        is_same = metadata.get("config") == digest(node)
    if not is_same:
        raise StageError(
            f"{folder / CONFIG} is damaged or edited: {MODEL} belongs to another one; {TRAIN_AGAIN}"
        )
    if node.get("learner") != LEARNER:
        reason = f"the policy in {folder} is by version {node.get('learner')!r} of the learner"
        raise StageError(f"{reason}, this is version {LEARNER}; {TRAIN_AGAIN}")
    with _config_errors(folder / CONFIG):
        view, spec = restored(View, node["view"]), restored(ObservationSpec, node["spec"])
        config = PolicyConfig.read(node["policy"], node["acting"])
        _check_config(node, config, view, spec)
        with torch.device("meta"):  # takes no memory, whatever the configuration asks for
            expected = Policy(config, view, spec).state_dict()
    _check_tensors(tensors, expected, folder / MODEL)
    policy = Policy(config if acting is None else config.acting_as(acting), view, spec)
    policy.load_state_dict(tensors)
    return policy.to(device_of(device)).eval(), view, spec


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load the tensors of a file into a network. Raises StageError where they do not fit."""
    _check_tensors(tensors, module.state_dict(), path)
    module.load_state_dict(tensors)


def _check_tensors(tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor], path: Path) -> None:
    """Raises StageError naming tensors that are missing, unknown, of another shape or type, or not finite."""
    problems = [f"{name} is missing" for name in expected.keys() - tensors.keys()]
    problems += [f"{name} is not one of its tensors" for name in tensors.keys() - expected.keys()]
    for name in expected.keys() & tensors.keys():
        tensor, shape = tensors[name], tuple(expected[name].shape)
        if tuple(tensor.shape) != shape:
            problems.append(f"{name} has shape {tuple(tensor.shape)}, expected {shape}")
        elif tensor.dtype not in TENSOR_TYPES:
            types = [str(each).removeprefix("torch.") for each in (tensor.dtype, *TENSOR_TYPES)]
            problems.append(f"{name} is of type {types[0]}, expected {' or '.join(types[1:])}")
        elif not tensor.isfinite().all():
            problems.append(f"{name} holds numbers that are not finite")
    if problems:
        listed = "; ".join(printable(each, 200) for each in sorted(problems)[:MOST_LISTED])
        more = f", and {len(problems) - MOST_LISTED} more" if len(problems) > MOST_LISTED else ""
        reason = f"{path} does not fit its configuration ({CONFIG}): {listed}{more}"
        raise StageError(f"{reason}; get it again, or {TRAIN_AGAIN}")


@contextmanager
def _config_errors(path: Path) -> Iterator[None]:
    """Within, any fault of a configuration becomes a StageError that names its file."""
    try:
        yield
    except KeyError as error:
        raise StageError(f"{path} lacks the key {error}; get it again, or {TRAIN_AGAIN}") from error
    except (ArgumentError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise StageError(
            f"{path} is not a valid policy configuration: {error}; get it again, or {TRAIN_AGAIN}"
        ) from error


def _check_config(node: Mapping[str, Any], config: PolicyConfig, view: View, spec: ObservationSpec) -> None:
    """Raises ArgumentError naming missing keys, whose defaults may have changed since, and differing ones.

    Also where a policy observes arms or subgoals that its spec lacks.
    """
    expected = {
        "policy": config.training_values,
        "acting": config.acting_values,
        "view": view.identity,
        "spec": spec.identity,
    }
    if differences := find_differences({key: node[key] for key in expected}, expected):
        listed = "; ".join(differences[:MOST_LISTED])
        raise ArgumentError(f"it differs from what this version of the learner writes: {listed}")
    if config.context != bool(spec.bases):
        raise ArgumentError(f"context is {config.context}, and spec.bases are of {len(spec.bases)} arms")
    if spec.bases and max(view.agents) > len(spec.bases):
        raise ArgumentError(f"agent {max(view.agents)} has no base; spec.bases are of {len(spec.bases)} arms")
    if bool(spec.subgoals) != (config.phases or view.coordinated):
        raise ArgumentError(
            f"spec.subgoals is {spec.subgoals} with phases {config.phases} and a view that is "
            f"{'' if view.coordinated else 'not '}coordinated"
        )


def write_small(folder: Path, target: Path) -> Path:
    """Write a copy of a finished policy for release, with its matrices in bfloat16; returns its folder.

    It is loaded like any other and computes in single precision. Raises StageError for a missing policy.
    """
    _require_model(folder)
    tensors, metadata = read_tensors(folder / MODEL)
    halved = {
        name: value.bfloat16() if value.numel() >= SMALLEST_HALVED else value
        for name, value in tensors.items()
    }
    target.mkdir(parents=True, exist_ok=True)
    for name in (CONFIG, CURVES):
        shutil.copyfile(folder / name, target / name)
    write_tensors(target / MODEL, halved, metadata)
    return target


def _require_model(folder: Path) -> None:
    if not (folder / MODEL).exists():
        missing = f"no trained policy in {folder}: {MODEL} is missing"
        raise StageError(f"{missing}; train it first (stages=[train])")
