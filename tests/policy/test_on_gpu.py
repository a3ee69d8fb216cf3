"""Learning and acting on a GPU; without one, fake tensors with a device but without values.

Either way finds tensors that are created on another device than those they are combined with. Without a GPU,
the backward pass, the fused optimiser and autocast are left out.
"""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import diffusers.training_utils  # noqa: F401, before the fixture replaces generators, whose type it names
import numpy as np
import pytest
import torch
from torch._subclasses import fake_impls
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode, unset_fake_temporarily

from rf_exp.policy import Policy, Windows, views
from rf_exp.policy.learning import training
from rf_exp.policy.networks import heads  # noqa: F401, for the same reason
from rf_exp.store import Store
from tests.conftest import experiment
from tests.policy.conftest import ARCHS, HEIGHT, WIDTH

GPU = torch.device("cuda:0")
ONE_STEP = (
    f"picture={{width: {WIDTH}, height: {HEIGHT}}}",
    *("training.batch_size=4", "training.epochs=null", "training.steps=1", "training.log_every=9"),
    *(
        "policy.head.diffusion.channels=[8,16]",
        "policy.head.diffusion.inference_steps=2",
        "policy.head.diffusion.train_timesteps=2",
    ),
)
ONE_OF_EACH = ("policy.encoder.keypoints.steps=1", "policy.head.refined.regression_steps=1")
pytestmark = pytest.mark.slow


GUARDS = "_ZN3c104impl26device_guard_impl_registryE"  # c10::impl::device_guard_impl_registry
CUDA, META = 1, 14  # indices into it, by c10::DeviceType


@pytest.fixture
def on_gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[torch.device]]:
    """The devices of all generators created meanwhile, which no tensor shows."""
    devices: list[torch.device] = []
    if torch.cuda.is_available():
        yield devices
        return
    real, learning = torch.Generator, list[Policy]()

    def generator(device: torch.device | str = "cpu") -> torch.Generator:
        devices.append(torch.device(device))
        return real()  # without CUDA there are none on a GPU

    def policy(*about: Any) -> Policy:
        """A policy with values, so that it is moved to the GPU like any other: fake modules are not moved."""
        with unset_fake_temporarily():
            learning.append(Policy(*about))
        return learning[-1]

    def backward(loss: torch.Tensor) -> None:
        """Zero gradients beside the weights: the engine needs a driver, and no backward pass is ours."""
        assert loss.requires_grad and loss.device == GPU
        for weight in learning[-1].parameters():
            weight.grad = torch.zeros_like(weight) if weight.requires_grad else None

    monkeypatch.setattr(torch, "Generator", generator)
    monkeypatch.setattr(training, "Policy", policy)
    monkeypatch.setattr(torch.Tensor, "backward", backward)
    take = torch.Tensor.to

    def to(values: torch.Tensor, *where: Any, **how: Any) -> torch.Tensor:
        """In inference mode, real values would be copied to the GPU, so an empty tensor replaces them."""
        real_values = torch.is_inference_mode_enabled() and not isinstance(values, FakeTensor)
        return take(torch.empty_like(values) if real_values else values, *where, **how)

    monkeypatch.setattr(torch.Tensor, "to", to)
    adamw = torch.optim.AdamW  # its fused kernel needs a driver
    monkeypatch.setattr(torch.optim, "AdamW", lambda *about, **how: adamw(*about, **(how | {"fused": False})))
    # Operators look up the guard of a device before they see a fake tensor; that of `meta` does nothing.
    library = ctypes.CDLL(str(Path(torch.__file__).parent / "lib/libc10.so"))
    guards = (ctypes.c_void_p * (META + 1)).in_dll(library, GUARDS)
    before, guards[CUDA] = guards[CUDA], guards[META]
    aten = torch.ops.aten
    for operator, answer in {
        aten.nonzero.default: lambda mode, _, mask: mask.new_empty(
            (mask.numel(), mask.dim()), dtype=torch.int64
        ),
        aten._local_scalar_dense.default: lambda *_: 1,
    }.items():  # operators that depend on values: a mask selects everything, and an item is 1
        monkeypatch.setitem(fake_impls.op_implementations_dict, operator, answer)
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    yield devices
    torch.__future__.set_overwrite_module_params_on_conversion(False)
    guards[CUDA] = before


@pytest.mark.filterwarnings("ignore:CUDA is not available")
@pytest.mark.parametrize(("recipe", "steps"), [("paper", ()), ("fast", ONE_OF_EACH)])
def test_a_policy_learns_and_acts_on_the_given_device(
    recipe: str, steps: tuple[str, ...], make_store: Callable[[int, int], Store], on_gpu: list[torch.device]
) -> None:
    configured = experiment(f"policy={recipe}", *ONE_STEP, *steps)
    store = make_store(2, 2)
    view = views(ARCHS[-1], 2)[0]
    mode = nullcontext() if torch.cuda.is_available() else FakeTensorMode(allow_non_fake_inputs=True)
    with mode:
        windows = Windows(store, view, configured.policy, GPU)
        fitting = training.Training(windows, view, configured.policy, configured.training)
        while not fitting.done:
            fitting.step()
        policy = fitting.averaged()
        assert {each.device for each in policy.state_dict().values()} == {GPU}
        assert act(policy, windows).device == GPU
    assert torch.cuda.is_available() or GPU in on_gpu


def act(policy: Policy, windows: Windows) -> torch.Tensor:
    """Actions (2, T, A) for two windows, whose pictures are encoded anew."""
    pictures, rays, _ = windows.labelled(np.array([0, 3]))
    features, _ = policy.encode_centre_crops(pictures, rays if len(rays[0]) else None)
    batch = windows.batch(np.array([0, 3]), None)
    seen = features[:, None].expand(-1, batch.frames.shape[1], -1)
    probabilities, context = (
        policy.transition_probabilities(seen, batch.proprio, batch.context),
        batch.context,
    )
    if probabilities is not None:
        subgoals, may_go_on = probabilities[..., :-1].argmax(dim=2), probabilities[..., -1] > 0.5
        context = policy.with_phases(context, subgoals, may_go_on)
    # On the CPU, as in a runner, so that the noise does not depend on the device.
    return policy.act(seen, batch.proprio, context, [torch.Generator() for _ in range(len(seen))])
