"""Training loop: a store and a view in, a folder with a policy out.

The policy gives a list of fits: what is trained, by which loss and for how long. Every random number of step
k comes from (seed, k) and every epoch's order from (seed, epoch), so resuming after an interruption needs no
generator state and gives the same weights, bit for bit on a CPU.
"""

import csv
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from rf_exp.artifacts import digest, read_json
from rf_exp.errors import StageError
from rf_exp.policy.config import LEARNER, PolicyConfig, TrainConfig
from rf_exp.policy.examples.windows import Windows
from rf_exp.policy.inputs.observation_spec import spec_of
from rf_exp.policy.inputs.view import View
from rf_exp.policy.learning.checkpoint import (
    CONFIG,
    MODEL,
    STATE,
    TRAIN_AGAIN,
    claim,
    device_of,
    load_tensors,
    read_tensors,
    write_tensors,
)
from rf_exp.policy.learning.curves import COLUMN_TYPES, CURVES, Curve, begin_curves
from rf_exp.policy.networks.interfaces import Draw
from rf_exp.policy.networks.policy import Policy

if TYPE_CHECKING:
    from diffusers.training_utils import EMAModel

    from rf_exp.store import Store

ORDER, CROPS, NOISE = range(3)  # streams of random numbers of a training


def train(
    store: "Store",
    view: View,
    policy_config: PolicyConfig,
    train_config: TrainConfig,
    folder: Path,
    progress: Callable[[Curve], None] | None = None,
    fit_cache: Path | None = None,
) -> Path:
    """Train one policy into its folder (layout: `rf_exp.policy.learning.checkpoint`) and return the folder.

    A first fit that other trainings may share is read from the folder `fit_cache` if one of them has written
    it there, or else written there. The resulting weights are the same as without sharing.

    A finished folder of the same configuration is returned untouched, an unfinished one is resumed. Ctrl-C
    and SIGTERM raise a KeyboardInterrupt between two steps, once the state is written. Raises StageError when
    the folder holds another configuration or the loss is no longer finite, ArgumentError when the store does
    not fit the view or the pictures.
    """
    provenance = {
        "learner": LEARNER,
        "policy": policy_config.training_values,
        "acting": policy_config.acting_values,
        "view": view.identity,
        "spec": spec_of(policy_config, store, view).identity,
        "train": train_config.identity,
        "data": {"identity": store.identity, "seeds": np.asarray(store.seeds[:]).tolist()},
    }
    if claim(folder, provenance):
        return folder
    windows = Windows(store, view, policy_config, device_of(train_config.device))
    training = Training(windows, view, policy_config, train_config)
    if fit_cache is not None and (cache_key := training.fits[0].cache_key) is not None:
        common_key = {key: provenance[key] for key in ("learner", "view", "spec", "data")}
        name = digest({**common_key, "fit": cache_key, "train": train_config.settings_without_budget})
        training.first_fit_path = fit_cache / f"{view.name}-{name}.safetensors"
    training.resume(folder / STATE)
    begin_curves(folder / CURVES, training.step_number)
    with (folder / CURVES).open("a", newline="") as file, deferred_interrupt() as interrupted:
        while not training.done:
            curve = training.step()
            if curve is not None:
                csv.DictWriter(file, COLUMN_TYPES).writerow(asdict(curve))
                file.flush()
                if progress is not None:
                    progress(curve)
            due = training.step_number % train_config.checkpoint_every == 0 and not training.done
            if interrupted.is_set() or due:
                training.save(folder / STATE)
            if interrupted.is_set():
                raise KeyboardInterrupt
    digest_of_config = digest(
        read_json(folder / CONFIG, TRAIN_AGAIN)
    )  # which may differ in how the policy acts
    write_tensors(folder / MODEL, training.averaged().state_dict(), {"config": digest_of_config})
    (folder / STATE).unlink(missing_ok=True)
    return folder


@contextmanager
def deferred_interrupt() -> Iterator[threading.Event]:
    """Within, Ctrl-C and SIGTERM only set the event: steps are completed. A second Ctrl-C acts at once."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # signals reach the main thread only
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def on_signal(*_: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, handlers[signal.SIGINT])

    for number in handlers:
        signal.signal(number, on_signal)
    try:
        yield event
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def learning_rate(config: TrainConfig, step: int, steps: int) -> float:
    """Linear warm-up, then half a cosine down to zero at the end of `steps` (paper, supplementary)."""
    if step < config.warmup_steps:
        return config.learning_rate * (step + 1) / config.warmup_steps
    progress = (step - config.warmup_steps) / max(1, steps - config.warmup_steps)
    return config.learning_rate * 0.5 * (1.0 + math.cos(math.pi * progress))


class Training:
    """State of a training between two steps."""

    def __init__(
        self, windows: Windows, view: View, policy_config: PolicyConfig, train_config: TrainConfig
    ) -> None:
        self._windows, self._config = windows, train_config
        self._per_epoch = windows.batches(train_config.batch_size)
        self._device = windows.action.device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(train_config.seed)
            self.policy = Policy(policy_config, view, windows.spec)
        self.policy.to(self._device).normaliser.fit(windows)
        if self._device.type == "cpu":  # GroupNorm on CUDA prefers NCHW, convolutions on a CPU do not
            self.policy.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        budget = train_config.steps or (train_config.epochs or 0) * self._per_epoch
        self.fits = self.policy.fits(windows)
        # First step of each fit, and the total number of steps.
        self._fit_bounds = [0, *accumulate(budget if fit.steps is None else fit.steps for fit in self.fits)]
        self.steps = self._fit_bounds[-1]
        self.step_number = 0  # number of completed steps
        self._parameters = list(self.policy.parameters())
        self._optimiser = torch.optim.AdamW(
            self._parameters,
            betas=train_config.betas,
            eps=train_config.epsilon,
            weight_decay=train_config.weight_decay,
            fused=True,
        )
        self._average = self._ema(self._parameters)
        # Average and parameters of the current fit.
        self._fit_state: tuple[EMAModel, list[nn.Parameter]] | None = None
        self._epoch_batches: Sequence[NDArray[np.int64]] = ()  # windows of this epoch, in batches
        self._loss = torch.zeros((), device=self._device)  # sum since the last curve
        self._samples, self._curve_began_s = 0, time.perf_counter()  # windows since the last curve; its time
        # File of the first fit, shared with other trainings.
        self.first_fit_path: Path | None = None
        self._began_s = time.process_time()

    @property
    def done(self) -> bool:
        """Whether all fits are done."""
        return self.step_number == self.steps

    def step(self) -> Curve | None:
        """One step of the optimiser; returns a curve when one is due."""
        config, number = self._config, self.step_number
        if self._fit_state is None:
            self._begin_fit()
        if not self._epoch_batches or number % self._per_epoch == 0:
            rng = np.random.default_rng([config.seed, ORDER, number // self._per_epoch])
            self._epoch_batches = self._windows.epoch(config.batch_size, config.run_length, rng)
        batch, fit = self._epoch_batches[number % self._per_epoch], self.fits[self._fit_index]
        first, last = self._fit_bounds[self._fit_index : self._fit_index + 2]
        rate = fit.rate * learning_rate(config, number - first, last - first)
        rng = np.random.default_rng([config.seed, CROPS, number])
        noise_seed = int(np.random.SeedSequence([config.seed, NOISE, number]).generate_state(1)[0])
        generator = torch.Generator(self._device).manual_seed(noise_seed)
        # Small networks are bound by kernel launches, and bfloat16 would round places to a pixel.
        mixed = self._device.type == "cuda" and self.policy.config.encoder.large
        with (
            torch.autocast(self._device.type, torch.bfloat16, enabled=mixed),
            torch.random.fork_rng(devices=[]),  # dropout draws from the global generator
        ):
            torch.manual_seed(noise_seed)
            windows_and_weights = self._windows.sample_active(batch, config.active_agent_sampling, rng)
            loss = fit.loss(Draw(*windows_and_weights, rng, generator))
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        assert self._fit_state is not None
        average, parameters = self._fit_state
        average.step(parameters)
        self._loss += loss.detach()
        self.step_number, self._samples = number + 1, self._samples + len(batch)
        due = self.step_number % config.log_every == 0 or self.done
        curve = self._curve(rate) if due else None
        if self.step_number == last and not self.done:
            self._finish_fit()
        return curve

    @property
    def _fit_index(self) -> int:
        """Index of the fit of this step."""
        return next(k for k, last in enumerate(self._fit_bounds[1:]) if self.step_number < last)

    def _begin_fit(self) -> None:
        """Start a fit: its parameters are trained and averaged; all others equal their averages."""
        trained_ids = {
            id(weight) for part in self.fits[self._fit_index].parts for weight in part.parameters()
        }
        indices = [k for k, weight in enumerate(self._parameters) if id(weight) in trained_ids]
        for weight in self._parameters:
            weight.requires_grad_(id(weight) in trained_ids)
        average = self._ema([self._parameters[k] for k in indices])
        average.shadow_params = [self._average.shadow_params[k] for k in indices]
        # It does not warm up anew, so in a late and short fit, as that of the U-Net of `fast`, nearly half of
        # the initial value stays. Warmed up anew, Take Photo succeeds less often (docs/recipe_ablation.md).
        average.optimization_step = self.step_number
        self._fit_state = average, [self._parameters[k] for k in indices]

    def _finish_fit(self) -> None:
        """Finish a fit: keep its averaged weights, call its `finish`, and share a first fit."""
        self._average.copy_to(self._parameters)
        self._fit_state = None
        self.fits[self._fit_index - 1].finish()
        if self._fit_index == 1 and self.first_fit_path is not None and not self.first_fit_path.exists():
            self._write(self.first_fit_path, self.fits[0].parts[0].state_dict())

    def _ema(self, parameters: Sequence[nn.Parameter]) -> "EMAModel":
        """Exponential moving average of parameters, from now on."""
        from diffusers.training_utils import EMAModel  # slow to import, and needed in training only

        decay, power = self._config.ema_max_decay, self._config.ema_power
        return EMAModel(parameters, decay=decay, use_ema_warmup=True, power=power, foreach=True)

    def _curve(self, rate: float) -> Curve:
        count = self.step_number % self._config.log_every or self._config.log_every
        loss = self._loss.item() / count  # the only time the host waits for the device
        self._loss.zero_()
        if not math.isfinite(loss):
            raise StageError(
                f"the training loss is {loss} at step {self.step_number}; expected a finite number: "
                f"lower learning_rate (now {self._config.learning_rate:g}) or check the data"
            )
        now, epoch = time.perf_counter(), (self.step_number - 1) // self._per_epoch
        speed = self._samples / (now - self._curve_began_s)
        self._samples, self._curve_began_s = 0, now
        return Curve(self.step_number, self.steps, epoch, loss, rate, speed, self._spent_s)

    @property
    def _spent_s(self) -> float:
        """CPU seconds of all threads since the beginning, earlier processes included."""
        return round(time.process_time() - self._began_s, 2)

    def averaged(self) -> Policy:
        """The policy with its averaged weights, for acting. Training cannot be continued from it."""
        self._average.copy_to(self._parameters)
        return self.policy.eval()

    # -- its state in files --------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write everything that `resume` needs."""
        tensors = {f"policy.{name}": value for name, value in self.policy.state_dict().items()}
        tensors |= {f"average.{k}": value for k, value in enumerate(self._average.shadow_params)}
        moments: dict[int, dict[str, Tensor]] = self._optimiser.state_dict()["state"]
        tensors |= {f"optimiser.{k}.{n}": v for k, state in moments.items() for n, v in state.items()}
        self._write(path, tensors)

    def _write(self, path: Path, tensors: dict[str, Tensor]) -> None:
        metadata = {"step": str(self.step_number), "core_s": str(self._spent_s)}
        write_tensors(path, tensors | {"loss": self._loss}, metadata)

    def resume(self, path: Path) -> None:
        """Resume from a saved state or first fit, if any. Raises StageError for one of another training."""
        source = next(
            (each for each in (path, self.first_fit_path) if each is not None and each.exists()), None
        )
        if source is None:
            return
        tensors, metadata = read_tensors(source)
        try:
            self.step_number = int(metadata["step"])
            self._began_s -= float(metadata["core_s"])
            self._loss.copy_(tensors.pop("loss"))
            self._fit_state = None
            if source == self.first_fit_path:
                load_tensors(self.fits[0].parts[0], tensors, source)
                self._average = self._ema(self._parameters)
            else:
                self._restore(source, tensors)
            for fit, end in zip(self.fits, self._fit_bounds[1:], strict=True):
                if end <= self.step_number < self.steps:
                    fit.finish()
        except (LookupError, ValueError, RuntimeError) as error:
            raise StageError(
                f"{source} does not fit this training ({error}); delete it and train again"
            ) from error

    def _restore(self, path: Path, tensors: dict[str, Tensor]) -> None:
        """Load weights, their averages and the moments of the optimiser from a saved state."""
        parts: dict[str, dict[str, Tensor]] = {"policy": {}, "average": {}, "optimiser": {}}
        for key, value in tensors.items():
            part, name = key.split(".", 1)
            parts[part][name] = value
        load_tensors(self.policy, parts["policy"], path)
        for k, shadow in enumerate(self._average.shadow_params):
            shadow.copy_(parts["average"][str(k)])
        moments: dict[int, dict[str, Tensor]] = {}
        for key, value in parts["optimiser"].items():
            index, name = key.split(".", 1)
            if value.dim():  # fused AdamW needs moments in the memory layout of their parameter
                value = torch.empty_like(self._parameters[int(index)]).copy_(value)
            moments.setdefault(int(index), {})[name] = value
        groups = self._optimiser.state_dict()["param_groups"]
        self._optimiser.load_state_dict({"state": moments, "param_groups": groups})
