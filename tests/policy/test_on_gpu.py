"""Learning and acting on a GPU. Where there is none, tensors say where they would lie, and hold no numbers.

A tensor that is made on another device than those that it meets is found by either. Without a GPU the
backward pass, the fused optimiser and autocast are left out.
"""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import diffusers.training_utils  # noqa: F401, before generators are others: it names their type
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
CUDA, META = 1, 14  # where they are in it, by c10::DeviceType


@pytest.fixture
def on_gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[torch.device]]:
    """Where generators were made meanwhile, which no tensor says."""
    made: list[torch.device] = []
    if torch.cuda.is_available():
        yield made
        return
    real, learning = torch.Generator, list[Policy]()

    def generator(device: torch.device | str = "cpu") -> torch.Generator:
        made.append(torch.device(device))
        return real()  # without CUDA there is no other

    def policy(*about: Any) -> Policy:
        """With numbers, so that it is brought to the GPU as any other: what holds none is not moved."""
        with unset_fake_temporarily():
            learning.append(Policy(*about))
        return learning[-1]

    def backward(loss: torch.Tensor) -> None:
        """The engine wants a driver. No backward pass is our own: gradients lie where weights do."""
        assert loss.requires_grad and loss.device == GPU
        for weight in learning[-1].parameters():
            weight.grad = torch.zeros_like(weight) if weight.requires_grad else None

    monkeypatch.setattr(torch, "Generator", generator)
    monkeypatch.setattr(training, "Policy", policy)
    monkeypatch.setattr(torch.Tensor, "backward", backward)
    take = torch.Tensor.to

    def to(values: torch.Tensor, *where: Any, **how: Any) -> torch.Tensor:
        """Where nothing is learned, numbers would be copied in earnest."""
        known = torch.is_inference_mode_enabled() and not isinstance(values, FakeTensor)
        return take(torch.empty_like(values) if known else values, *where, **how)

    monkeypatch.setattr(torch.Tensor, "to", to)
    adamw = torch.optim.AdamW  # whose fused kernel is one of a driver
    monkeypatch.setattr(torch.optim, "AdamW", lambda *about, **how: adamw(*about, **(how | {"fused": False})))
    # Operators ask who guards a device before they see that a tensor is none; that of `meta` does nothing.
    library = ctypes.CDLL(str(Path(torch.__file__).parent / "lib/libc10.so"))
    guards = (ctypes.c_void_p * (META + 1)).in_dll(library, GUARDS)
    before, guards[CUDA] = guards[CUDA], guards[META]
    aten = torch.ops.aten
    for operator, answer in {
        aten.nonzero.default: lambda mode, _, mask: mask.new_empty(
            (mask.numel(), mask.dim()), dtype=torch.int64
        ),
        aten._local_scalar_dense.default: lambda *_: 1,
    }.items():  # what depends on numbers: a mask chooses everything, and a number is one
        monkeypatch.setitem(fake_impls.op_implementations_dict, operator, answer)
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    yield made
    torch.__future__.set_overwrite_module_params_on_conversion(False)
    guards[CUDA] = before


@pytest.mark.filterwarnings("ignore:CUDA is not available")
@pytest.mark.parametrize(("recipe", "steps"), [("paper", ()), ("fast", ONE_OF_EACH)])
def test_a_policy_learns_and_acts_where_it_is_told(
    recipe: str, steps: tuple[str, ...], make_store: Callable[[int, int], Store], on_gpu: list[torch.device]
) -> None:
    asked = experiment(f"policy={recipe}", *ONE_STEP, *steps)
    store = make_store(2, 2)
    view = views(ARCHS[-1], 2)[0]
    mode = nullcontext() if torch.cuda.is_available() else FakeTensorMode(allow_non_fake_inputs=True)
    with mode:
        windows = Windows(store, view, asked.policy, GPU)
        begun = training.Training(windows, view, asked.policy, asked.training)
        while not begun.done:
            begun.step()
        policy = begun.averaged()
        assert {each.device for each in policy.state_dict().values()} == {GPU}
        assert act(policy, windows).device == GPU
    assert torch.cuda.is_available() or GPU in on_gpu


def act(policy: Policy, windows: Windows) -> torch.Tensor:
    """Two actions (T, A) of what two windows show, looked at anew."""
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
    # Those of a runner are on the CPU, so that the noise does not depend on the device.
    return policy.act(seen, batch.proprio, context, [torch.Generator() for _ in range(len(seen))])
