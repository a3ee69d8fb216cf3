"""The one training loop: a store and a view in, a folder with a policy out.

Every random number of step k comes from (seed, k) and every epoch's order from (seed, epoch), so going
on after an interruption needs no generator state and gives the same weights, bit for bit on a CPU.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from diffusers.training_utils import EMAModel
from numpy.typing import NDArray
from torch import Tensor, nn

from rf_exp.artifacts import digest, read_json
from rf_exp.errors import StageError
from rf_exp.policy.config import LEARNER, PolicyConfig, TrainConfig
from rf_exp.policy.examples.windows import Windows
from rf_exp.policy.inputs.observation_spec import senses_of
from rf_exp.policy.inputs.view import View
from rf_exp.policy.learning.checkpoint import (
    ANEW,
    CONFIG,
    CURVES,
    MODEL,
    STATE,
    claim,
    device_of,
    eyes_file,
    fill,
    identity_of,
    policy_of,
    read_tensors,
    write_tensors,
)
from rf_exp.policy.learning.curves import Curve, curves
from rf_exp.policy.learning.interrupts import deferred_interrupt
from rf_exp.policy.networks.diffusion import DiffusionPolicy

if TYPE_CHECKING:
    from rf_exp.store import Store

ORDER, CROPS, NOISE = range(3)  # streams of random numbers of a training


def train(
    store: "Store",
    view: View,
    policy_config: PolicyConfig,
    train_config: TrainConfig,
    folder: Path,
    progress: Callable[[Curve], None] | None = None,
    shared: Path | None = None,
) -> Path:
    """Train one policy into its folder (layout: `rf_exp.policy.learning.checkpoint`) and return the folder.

    Heat maps that are learned first are taken from the folder `shared` where another training has left the
    same ones, or left there. The weights are those of one that has learned them itself.

    A finished folder of the same configuration is returned untouched, an unfinished one is gone on with.
    Ctrl-C and SIGTERM are answered between two steps by a KeyboardInterrupt, once the state is written.
    Raises StageError when the folder holds another configuration or the loss is no longer finite,
    ArgumentError when the store does not fit the view or the pictures.
    """
    provenance = {
        "learner": LEARNER,
        "policy": policy_config.identity,
        "view": view.identity,
        "senses": identity_of(senses_of(policy_config, store, view)),
        "train": train_config.identity,
        "data": {"identity": store.identity, "seeds": np.asarray(store.seeds[:]).tolist()},
    }
    if claim(folder, provenance):
        return folder
    windows = Windows(store, view, policy_config, device_of(train_config.device))
    training = Training(windows, view, policy_config, train_config)
    if shared is not None and train_config.eyes_steps:
        training.eyes = eyes_file(shared, view.name, provenance)
    training.resume(folder / STATE)
    with curves(folder / CURVES, training.step) as write, deferred_interrupt() as interrupted:
        for curve in training.run():
            if curve is not None:
                write(curve)
                if progress is not None:
                    progress(curve)
            done = training.step == training.steps
            if interrupted.is_set() or (training.step % train_config.checkpoint_every == 0 and not done):
                training.save(folder / STATE)
            if interrupted.is_set():
                raise KeyboardInterrupt
    said = digest(read_json(folder / CONFIG, ANEW))  # which may differ in how the policy acts
    write_tensors(folder / MODEL, training.averaged().state_dict(), {"config": said})
    (folder / STATE).unlink(missing_ok=True)
    return folder


class Training:
    """The state of a training between two steps."""

    def __init__(
        self, windows: Windows, view: View, policy_config: PolicyConfig, train_config: TrainConfig
    ) -> None:
        self._windows, self._config = windows, train_config
        self._per_epoch = windows.batches(train_config.batch_size)
        self.steps = train_config.steps or (train_config.epochs or 0) * self._per_epoch
        self.steps += train_config.eyes_steps + train_config.draft_steps
        self.step = 0
        self._device = windows.action.device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(train_config.seed)
            self.policy = policy_of(policy_config, view, windows.senses)
        seen = self.policy.normaliser.seen.centre
        self.policy.normaliser.load_state_dict(windows.normaliser(len(seen)).state_dict())
        self.policy.to(self._device)
        if self._device.type == "cpu":  # GroupNorm on CUDA wants NCHW, the CPU's convolutions do not
            self.policy.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self._parameters = list(self.policy.parameters())
        self._optimiser = torch.optim.AdamW(
            self._parameters,
            betas=train_config.betas,
            eps=train_config.epsilon,
            weight_decay=train_config.weight_decay,
            fused=True,
        )
        self._average = self._ema(self._parameters)
        self._stage: tuple[EMAModel, list[nn.Parameter]] | None = None  # an average of what is learned now
        self._loss = torch.zeros((), device=self._device)  # sum since the last curve
        self.eyes: Path | None = None  # where heat maps lie, or will, for other trainings too
        self._began_s = time.process_time()

    def _ema(self, parameters: Sequence[nn.Parameter]) -> EMAModel:
        """An average over time of parameters, from now on."""
        decay, power = self._config.ema_max_decay, self._config.ema_power
        return EMAModel(parameters, decay=decay, use_ema_warmup=True, power=power, foreach=True)

    def _learning(self) -> list[nn.Module]:
        """What is learned at this step. All else equals its average, which need not be kept up."""
        policy, seen = self.policy, self._config.eyes_steps
        drawn = seen + self._config.draft_steps
        if self.step < seen:
            return [policy.encoder]
        parts = [policy.draft, policy.phase] if self.step < drawn else [policy.trunk, policy.unet]
        return [part for part in (*parts, None if seen else policy.encoder) if part is not None]

    def _keep_average(self) -> None:
        """After a step of the optimiser."""
        if self._stage is None:
            learned = {id(weight) for part in self._learning() for weight in part.parameters()}
            chosen = [k for k, weight in enumerate(self._parameters) if id(weight) in learned]
            average = self._ema([self._parameters[k] for k in chosen])
            average.shadow_params = [self._average.shadow_params[k] for k in chosen]
            average.optimization_step = self.step
            self._stage = average, [self._parameters[k] for k in chosen]
        average, parameters = self._stage
        average.step(parameters)

    def run(self) -> Iterator[Curve | None]:
        """Step until the end; yields after every step, a curve when one is due."""
        config, since = self._config, time.perf_counter()
        samples, order = 0, self._order()
        eyes, drafts = config.eyes_steps, config.eyes_steps + config.draft_steps
        if eyes and self.step > eyes:  # gone on with: what the eyes see is the same again
            self._windows.look_once(self.policy.eval().encode_whole)
            self.policy.train()
        while self.step < self.steps:
            if self.step % self._per_epoch == 0:
                order = self._order()
            if self.step and self.step in (eyes, drafts):
                self._settle(eyes == self.step)
            batch = order[self.step % self._per_epoch]
            stages = pairwise((0, eyes, drafts, self.steps))
            done, steps = next((a, b) for a, b in stages if a <= self.step < b)
            rate = config.rate(self.step - done, steps - done)
            if self.step < eyes:
                rate *= config.eyes_rate
            self._update(batch, rate)
            self.step += 1
            samples += len(batch)
            if self.step % config.log_every and self.step < self.steps:
                yield None
                continue
            count = self.step % config.log_every or config.log_every
            loss = self._loss.item() / count  # the only time the host waits for the device
            self._loss.zero_()
            if not math.isfinite(loss):
                raise StageError(
                    f"the training loss is {loss} at step {self.step}; expected a finite number: "
                    f"lower learning_rate (now {config.learning_rate:g}) or check the data"
                )
            now = time.perf_counter()
            epoch = (self.step - 1) // self._per_epoch
            yield Curve(self.step, self.steps, epoch, loss, rate, samples / (now - since), self._spent_s)
            since, samples = now, 0

    @property
    def _spent_s(self) -> float:
        """CPU seconds of all threads since the beginning, in earlier processes too."""
        return round(time.process_time() - self._began_s, 2)

    def _order(self) -> Sequence[NDArray[np.int64]]:
        rng = np.random.default_rng([self._config.seed, ORDER, self.step // self._per_epoch])
        return self._windows.epoch(self._config.batch_size, self._config.run_length, rng)

    def _update(self, windows: NDArray[np.int64], rate: float) -> None:
        config = self._config
        seeing = self.step < config.eyes_steps
        rng = np.random.default_rng([config.seed, CROPS, self.step])
        noise_seed = np.random.SeedSequence([config.seed, NOISE, self.step]).generate_state(1)[0]
        generator = torch.Generator(self._device).manual_seed(int(noise_seed))
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._device.type == "cuda"):
            windows, weights = self._windows.going(windows, config.going, rng)
            if seeing:
                loss = self.policy.eyes_loss(*self._windows.marked(windows, config.eyes_shift_px, rng))
            else:
                batch = self._windows.batch(windows, rng)
                if self.step < config.eyes_steps + config.draft_steps:
                    with torch.random.fork_rng(devices=[]):  # dropout draws from the global generator
                        torch.manual_seed(int(noise_seed))
                        loss = self.policy.draft_loss(batch, weights, generator, config.proprio_noise)
                else:
                    loss = self.policy.loss(batch, generator, config.noise_draws, config.proprio_noise)
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        self._keep_average()
        self._loss += loss.detach()

    def _settle(self, seeing: bool) -> None:
        """What has been learned so far stays, averaged; after `seeing`, all pictures are looked at once."""
        self._average.copy_to(self._parameters)
        self._stage = None
        if seeing:
            self.policy.lift_eyes(self._windows.pixels, self._windows.points)
            if self.eyes is not None and not self.eyes.exists():
                self._write(self.eyes, self.policy.encoder.state_dict())
            features = self._windows.look_once(self.policy.eval().encode_whole)
            pointed = self.policy.pointed(features[:, None], self._windows.context[:, None])[:, 0]
            self.policy.normaliser.seen.fit(pointed)
            self.policy.train()

    def averaged(self) -> DiffusionPolicy:
        """The policy with its averaged weights, for acting. Training cannot go on from it."""
        self._average.copy_to(self._parameters)
        return self.policy.eval()

    def save(self, path: Path) -> None:
        """Write everything that `resume` needs."""
        tensors = {f"policy.{name}": value for name, value in self.policy.state_dict().items()}
        tensors |= {f"average.{k}": value for k, value in enumerate(self._average.shadow_params)}
        moments: dict[int, dict[str, Tensor]] = self._optimiser.state_dict()["state"]
        tensors |= {f"optimiser.{k}.{n}": v for k, state in moments.items() for n, v in state.items()}
        self._write(path, tensors)

    def _write(self, path: Path, tensors: dict[str, Tensor]) -> None:
        said = {"step": str(self.step), "core_s": str(self._spent_s)}
        write_tensors(path, tensors | {"loss": self._loss}, said)

    def resume(self, path: Path) -> None:
        """Go on from a saved state, if there is one, else from heat maps that are there already.

        Raises StageError for one that is of another training.
        """
        found = next((each for each in (path, self.eyes) if each is not None and each.exists()), None)
        if found is None:
            return
        try:
            self._go_on(found, *read_tensors(found))
        except (LookupError, ValueError, RuntimeError) as error:
            raise StageError(
                f"{found} does not fit this training ({error}); delete it and train again"
            ) from error

    def _go_on(self, found: Path, tensors: dict[str, Tensor], metadata: Mapping[str, str]) -> None:
        self.step = int(metadata["step"])
        self._began_s -= float(metadata["core_s"])
        self._loss.copy_(tensors.pop("loss"))
        self._stage = None
        if found == self.eyes:
            fill(self.policy.encoder, tensors, found)
            self._average = self._ema(self._parameters)
            return
        parts: dict[str, dict[str, Tensor]] = {"policy": {}, "average": {}, "optimiser": {}}
        for key, value in tensors.items():
            part, name = key.split(".", 1)
            parts[part][name] = value
        fill(self.policy, parts["policy"], found)
        for k, shadow in enumerate(self._average.shadow_params):
            shadow.copy_(parts["average"][str(k)])
        moments: dict[int, dict[str, Tensor]] = {}
        for key, value in parts["optimiser"].items():
            index, name = key.split(".", 1)
            if value.dim():  # fused AdamW walks the memory: moments must lie as their parameter does
                value = torch.empty_like(self._parameters[int(index)]).copy_(value)
            moments.setdefault(int(index), {})[name] = value
        groups = self._optimiser.state_dict()["param_groups"]
        self._optimiser.load_state_dict({"state": moments, "param_groups": groups})
