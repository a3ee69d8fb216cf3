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
    differing,
    digest,
    expect_same,
    plain,
    read_json,
    restored,
    sweep,
    whole,
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
SAID = "rf_exp"  # the only key of a file's metadata: the order of several would be random
CHECKSUM = "sha256"
MATRIX = 1024  # values of a tensor from which on half precision suffices; ranges and rays have fewer
NUMBERS = (torch.float32, torch.bfloat16)  # types of tensors: as trained, or halved
LISTED = 3  # tensors that an error lists
ANEW = "delete the folder and train again (stages=[train])"


def device_of(name: str) -> torch.device:
    """`auto` is the GPU where there is one. Raises ArgumentError for cuda without one."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ArgumentError("device is 'cuda', but torch finds no CUDA GPU; use device=cpu or device=auto")
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Replace a safetensors file atomically. Raises StageError where it cannot be written."""
    kept = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    with whole(path) as draft:
        said = {**metadata, CHECKSUM: _checksum(kept, metadata)}
        try:
            save_file(kept, draft, {SAID: json.dumps(said, sort_keys=True)})
        except SafetensorError as error:
            raise StageError(
                f"cannot write {path}: {error}; make room there, the same command goes on from here"
            ) from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a file. Raises StageError where it is damaged."""
    with _opened(path) as file:
        metadata = _said(file)
        said = metadata.pop(CHECKSUM)
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator
        found = _checksum(tensors, metadata)
    if said != found:
        raise _damaged(path, "what is in it does not fit its checksum")
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


def _said(file: Any) -> dict[str, str]:
    """The metadata of an open file, CHECKSUM included."""
    said = json.loads((file.metadata() or {}).get(SAID, "{}"))
    if CHECKSUM not in said:
        raise ValueError("it has no checksum")
    return said


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
    sweep(folder)
    if (folder / CONFIG).exists():
        expect_policy(folder, provenance)
    else:
        write_json(folder / CONFIG, plain(provenance))
    return (folder / MODEL).exists()


def expect_policy(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Raises StageError naming what differs unless a folder's policy has this provenance, but for acting."""
    found = _described(folder)
    made, asked = ({key: each.get(key) for key in wanted if key != "acting"} for each in (found, wanted))
    expect_same(folder, made, asked, "delete the folder or choose another `out`")


def provenance(folder: Path) -> dict[str, Any]:
    """Provenance of a trained policy, with the checksum of its weights. Raises StageError if missing."""
    _require_model(folder)
    with _opened(folder / MODEL) as file:
        weights = _said(file)[CHECKSUM]
    return {**_described(folder), "weights": weights}


def _described(folder: Path) -> dict[str, Any]:
    """The configuration of a policy, as plain values. Raises StageError for one that is no object."""
    said = read_json(folder / CONFIG, ANEW)
    if not isinstance(said, dict):
        raise StageError(f"{folder / CONFIG} holds a {type(said).__name__}; expected an object; {ANEW}")
    return said


def load_policy(
    folder: Path, device: str = "auto", acting: PolicyConfig | None = None
) -> tuple[Policy, View, ObservationSpec]:
    """A trained policy, ready to act, its view and its spec.

    It acts as configured when it was trained, or as in `acting`. Raises StageError for a policy that is
    missing, damaged, or by another version of the learner.
    """
    _require_model(folder)
    tensors, metadata = read_tensors(folder / MODEL)
    said = _described(folder)
    with _faults_of(folder / CONFIG):
        same = metadata.get("config") == digest(said)
    if not same:
        raise StageError(f"{folder / CONFIG} is damaged or edited: {MODEL} was made of another; {ANEW}")
    if said.get("learner") != LEARNER:
        found = f"the policy in {folder} is by version {said.get('learner')!r} of the learner"
        raise StageError(f"{found}, this is version {LEARNER}; {ANEW}")
    with _faults_of(folder / CONFIG):
        view, spec = restored(View, said["view"]), restored(ObservationSpec, said["spec"])
        config = PolicyConfig.read(said["policy"], said["acting"])
        _check(said, config, view, spec)
        with torch.device("meta"):  # takes no memory, whatever the configuration asks for
            expected = Policy(config, view, spec).state_dict()
    _check_tensors(tensors, expected, folder / MODEL)
    policy = Policy(config if acting is None else config.acting_as(acting), view, spec)
    policy.load_state_dict(tensors)
    return policy.to(device_of(device)).eval(), view, spec


def fill(module: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load the tensors of a file into a network. Raises StageError where they do not fit."""
    _check_tensors(tensors, module.state_dict(), path)
    module.load_state_dict(tensors)


def _check_tensors(found: Mapping[str, Tensor], expected: Mapping[str, Tensor], path: Path) -> None:
    """Raises StageError naming tensors that are missing, unknown, of another shape or type, or not finite."""
    wrong = [f"{name} is missing" for name in expected.keys() - found.keys()]
    wrong += [f"{name} is none of its tensors" for name in found.keys() - expected.keys()]
    for name in expected.keys() & found.keys():
        tensor, shape = found[name], tuple(expected[name].shape)
        if tuple(tensor.shape) != shape:
            wrong.append(f"{name} has shape {tuple(tensor.shape)}, expected {shape}")
        elif tensor.dtype not in NUMBERS:
            types = [str(each).removeprefix("torch.") for each in (tensor.dtype, *NUMBERS)]
            wrong.append(f"{name} is of type {types[0]}, expected {' or '.join(types[1:])}")
        elif not tensor.isfinite().all():
            wrong.append(f"{name} holds numbers that are not finite")
    if wrong:
        listed = "; ".join(printable(each, 200) for each in sorted(wrong)[:LISTED])
        more = f", and {len(wrong) - LISTED} more" if len(wrong) > LISTED else ""
        why = f"{path} does not fit its configuration ({CONFIG}): {listed}{more}"
        raise StageError(f"{why}; get it again, or {ANEW}")


@contextmanager
def _faults_of(path: Path) -> Iterator[None]:
    """Within, any fault of a configuration becomes a StageError that names its file."""
    try:
        yield
    except KeyError as error:
        raise StageError(f"{path} does not say {error}; get it again, or {ANEW}") from error
    except (ArgumentError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise StageError(f"{path} describes no policy: {error}; get it again, or {ANEW}") from error


def _check(said: Mapping[str, Any], config: PolicyConfig, view: View, spec: ObservationSpec) -> None:
    """Raises ArgumentError naming missing keys, whose defaults may have changed since, and differing ones.

    Also where a policy observes arms or subgoals that its spec lacks.
    """
    meant = {"policy": config.learned, "acting": config.acted, "view": view.identity, "spec": spec.identity}
    if wrong := differing({key: said[key] for key in meant}, meant):
        listed = "; ".join(wrong[:LISTED])
        raise ArgumentError(f"it is not as this version of the learner writes it: {listed}")
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
    small = {name: value.bfloat16() if value.numel() >= MATRIX else value for name, value in tensors.items()}
    target.mkdir(parents=True, exist_ok=True)
    for name in (CONFIG, CURVES):
        shutil.copyfile(folder / name, target / name)
    write_tensors(target / MODEL, small, metadata)
    return target


def _require_model(folder: Path) -> None:
    if not (folder / MODEL).exists():
        missing = f"no trained policy in {folder}: {MODEL} is missing"
        raise StageError(f"{missing}; train it first (stages=[train])")
