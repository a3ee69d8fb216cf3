"""What a policy is and how it is trained, as frozen values that check themselves.

Defaults are the paper's (section 4, supplementary "Implementation details") where it states them and
the authors' release where it does not. `conf/policy/` holds the recipes; `paper.yaml`
says the same. They stand here as well since what was stored before a field came is read without it.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rf_exp.artifacts import without
from rf_exp.errors import ArgumentError, choices
from rf_exp.types import LARGEST_PX

ENCODERS = ("resnet18", "compact", "heatmaps")
SAMPLERS = ("ddpm", "ddim")
PREDICTIONS = ("epsilon", "sample", "v_prediction")
OBSERVATIONS = ("pictures", "state")
LOSSES = ("mse", "l1")
# Of a policy; they change no weight.
ACTING = ("action_steps", "ensemble", "hold_rad", "patience", "sampler", "inference_diffusion_steps")
# Of everything between demonstrations and weights. Raise it whenever a training gives others than before.
LEARNER = 6
SMALLEST_SQUARE = 8  # pixels
CELL = 4  # pixels of a picture, shrunk, to a cell of a heat map
HOW = ("device", "log_every", "checkpoint_every")  # of a training; they do not change what comes out
# Of a policy and of its training, what heat maps that are learned first (`eyes_steps`) do not depend on.
BESIDE_EYES = (
    *(*ACTING, "keypoint_noise", "unet_channels", "horizon", "observation_steps", "train_diffusion_steps"),
    *(
        "prediction",
        "relative_actions",
        "trunk",
        "draft",
        "dropout",
        "tcp_actions",
        "binary_grippers",
        "loss",
    ),
)
AFTER_EYES = ("epochs", "steps", "draft_steps", "noise_draws", "proprio_noise")
# What each number may be at most: far above what is of use, and below what would take all memory, or for
# ever. A configuration may come with the policy of somebody else.
MOST_POLICY = {
    "keypoint_noise": 1.0,
    "shrink": 64,
    "close_up": LARGEST_PX,
    "horizon": 512,
    "observation_steps": 64,
    "action_steps": 512,
    "ensemble": 1e3,
    "hold_rad": math.pi,
    "patience": 1e6,
    "train_diffusion_steps": 1000,
    "inference_diffusion_steps": 1000,
    "height": LARGEST_PX,
    "width": LARGEST_PX,
}
MOST_TRAINING = {
    "epochs": 10**6,
    "steps": 10**9,
    "batch_size": 2**16,
    "run_length": 2**16,
    "noise_draws": 1024,
    "eyes_rate": 1e3,
    "eyes_shift_px": LARGEST_PX,
    "eyes_steps": 10**9,
    "draft_steps": 10**9,
    "epsilon": 1.0,
    "weight_decay": 1e3,
    "warmup_steps": 10**9,
    "ema_power": 1e3,
    "proprio_noise": 1e3,
    "seed": 2**32 - 1,
    "log_every": 10**9,
    "checkpoint_every": 10**9,
}
LAYERS, WIDEST = 8, 8192  # levels of a U-Net and hidden layers; channels of one


def _require(holds: bool, field: str, got: object, expected: str) -> None:
    if not holds:
        raise ArgumentError(f"{field} is {got!r}; expected {expected}")


def _bounded(config: object, most: Mapping[str, float]) -> None:
    """Numbers are finite, no truth values, and not too large; of layers there are not too many."""
    for name, value in vars(config).items():
        for each in value if isinstance(value, tuple) else (value,):
            truth = isinstance(each, bool) and isinstance(getattr(type(config), name), bool)
            if isinstance(each, bool):
                _require(truth, name, value, "a number")
            elif isinstance(each, int | float):
                high = WIDEST if isinstance(value, tuple) else most.get(name, math.inf)
                finite = isinstance(each, int) or math.isfinite(each)
                _require(finite and each <= high, name, value, f"finite, and at most {high:g}")
        if isinstance(value, tuple):
            _require(len(value) <= LAYERS, name, value, f"at most {LAYERS} of them")


def _positive(config: object, *fields: str) -> None:
    for name in fields:
        value = getattr(config, name)
        _require(value > 0, name, value, "a number above 0")


def _one_of(config: object, name: str, available: object) -> None:
    if getattr(config, name) not in available:  # pyright: ignore[reportOperatorIssue]
        raise choices(name, getattr(config, name), available)


@dataclass(frozen=True)
class PolicyConfig:
    """The networks and the diffusion process. Pictures must come in `height` x `width` pixels."""

    encoder: str = "resnet18"  # resnet18 | compact | heatmaps: see eyes.py
    # On what heat maps see (m, and parts of a picture), while the rest learns from it.
    keypoint_noise: float = 0.0
    shrink: int = 1  # times, of the picture that heat maps cover
    close_up: int = 0  # pixels, side of the squares of the whole picture that are looked at again; 0: none
    unet_channels: tuple[int, ...] = (256, 512, 1024)
    horizon: int = 8  # actions predicted, the first at the oldest observation
    observation_steps: int = 3
    action_steps: int = 6  # executed before the next prediction
    # Of all predictions of a control step the k-th oldest weighs exp(-ensemble k); None: the newest alone.
    ensemble: float | None = None
    hold_rad: float = 0.0  # a chunk whose joints all stay so near to where they are moves nothing
    # Who waits goes on once its chances of going on, summed over looks at which nothing changes, reach this;
    # 0: it waits until one look says more than a half. See patience.py.
    patience: float = 0.0
    train_diffusion_steps: int = 100
    inference_diffusion_steps: int = 100  # 0: the draft alone
    sampler: str = "ddpm"  # ddpm | ddim
    prediction: str = "epsilon"  # epsilon | sample | v_prediction
    relative_actions: bool = False  # joint targets as differences from the newest measured positions
    observation: str = "pictures"  # pictures | state: the true poses of all things, the ceiling of a recipe
    context: bool = False  # told also where the own TCP is and what the own gripper has done
    trunk: tuple[int, ...] = ()  # hidden layers between the observation and the U-Net
    draft: tuple[int, ...] = ()  # hidden layers of a perceptron whose chunk the U-Net refines; none: no draft
    dropout: float = 0.0  # in the draft
    drop_idle: bool = False  # learn nothing from moments in which nobody moves
    phases: bool = False  # predicts its subgoal and whether it may go on: see coordination.py
    tcp_actions: bool = False  # predicts where the TCP goes too, and joints follow that: see hands.py
    binary_grippers: bool = False  # commands are wholly open or wholly closed
    loss: str = "mse"  # mse | l1
    crop: float = 0.9  # side of the crop, as a part of the picture's
    height: int = 240  # pixels
    width: int = 320

    def __post_init__(self) -> None:
        object.__setattr__(self, "unet_channels", tuple(self.unet_channels))
        for name in ("trunk", "draft"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        _bounded(self, MOST_POLICY)
        _require(all(width > 0 for width in self.trunk), "trunk", self.trunk, "numbers above 0")
        _require(all(width > 0 for width in self.draft), "draft", self.draft, "numbers above 0")
        _one_of(self, "encoder", ENCODERS)
        _one_of(self, "sampler", SAMPLERS)
        _one_of(self, "prediction", PREDICTIONS)
        _one_of(self, "observation", OBSERVATIONS)
        _one_of(self, "loss", LOSSES)
        self._require_eyes()
        _require(self.hold_rad >= 0, "hold_rad", self.hold_rad, "0 or above")
        _require(self.patience >= 0, "patience", self.patience, "0 or above")
        refines = not self.draft or self.prediction == "sample"
        _require(refines, "prediction", self.prediction, "sample, where a draft of the actions is refined")
        _require(0.0 <= self.dropout < 1.0, "dropout", self.dropout, "a number in [0, 1)")
        told = self.context or self.observation != "state"
        _require(told, "context", self.context, "true with observation=state")
        predicts = not self.phases or (self.context and bool(self.draft))
        _require(predicts, "phases", self.phases, "false without context and a draft, beside which it learns")
        _require(self.context or not self.tcp_actions, "context", self.context, "true with tcp_actions")
        _positive(self, "horizon", "observation_steps", "action_steps", "height", "width")
        _positive(self, "train_diffusion_steps")
        _require(0.0 < self.crop <= 1.0, "crop", self.crop, "a number above 0, at most 1")
        halvings = 2 ** max(0, len(self.unet_channels) - 1)
        _require(self.horizon % halvings == 0, "horizon", self.horizon, f"a multiple of {halvings}")
        longest = self.horizon - self.observation_steps + 1
        _require(self.action_steps <= longest, "action_steps", self.action_steps, f"at most {longest}")
        most = self.train_diffusion_steps
        steps = self.inference_diffusion_steps
        least = 0 if self.draft else 1
        _require(least <= steps <= most, "inference_diffusion_steps", steps, f"{least} to {most}")
        _require(
            self.ensemble is None or self.ensemble >= 0, "ensemble", self.ensemble, "0 or above, or null"
        )
        if self.sampler == "ddpm":
            _require(steps == most, "inference_diffusion_steps", steps, f"{most} with sampler ddpm")

    def _require_eyes(self) -> None:
        """What heat maps need, and what only they can do."""
        eyes = self.encoder == "heatmaps"
        looks = not eyes or (self.context and self.crop == 1.0)
        _require(looks, "encoder", self.encoder, "context=true and crop=1 with heatmaps")
        _require(self.keypoint_noise >= 0, "keypoint_noise", self.keypoint_noise, "0 or above")
        _require(self.shrink == 1 or eyes, "shrink", self.shrink, f"1 with encoder={self.encoder}")
        _require(self.shrink >= 1, "shrink", self.shrink, "1 or above")
        for side in ("height", "width") if eyes else ():
            cell = CELL * self.shrink
            expected = f"a multiple of {cell} with encoder=heatmaps and shrink={self.shrink}"
            _require(getattr(self, side) % cell == 0, side, getattr(self, side), expected)
        _require(not self.close_up or eyes, "close_up", self.close_up, f"0 with encoder={self.encoder}")
        most = min(self.height, self.width)
        fits = not self.close_up or SMALLEST_SQUARE <= self.close_up <= most
        _require(fits, "close_up", self.close_up, f"0, or {SMALLEST_SQUARE} to {most} pixels")

    @property
    def identity(self) -> dict[str, Any]:
        """All fields, but for those that came later, where they change nothing."""
        return without(asdict(self), ensemble=None, patience=0.0, shrink=1, close_up=0)

    def cropped(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of what the encoder sees of such a picture, pixels."""
        return round(self.crop * height), round(self.crop * width)


@dataclass(frozen=True)
class TrainConfig:
    """How a policy is trained. Exactly one of `epochs` and `steps` is the budget."""

    epochs: int | None = 300
    steps: int | None = None
    batch_size: int = 128  # windows
    going: float = 0.0  # part of them that is drawn from those in which an own agent may go on
    run_length: int = 8  # consecutive windows drawn together, so that their frames are encoded once
    noise_draws: int = 1  # for each window in a batch
    eyes_rate: float = 1.0  # learning rate of the heat maps, as a multiple of the others'
    eyes_shift_px: int = 0  # by which the pictures for the heat maps are shifted at most, either way
    eyes_steps: int = 0  # before all others, of the heat maps alone, which then stay as they are
    draft_steps: int = 0  # before the others, of the draft alone
    learning_rate: float = 1e-4
    betas: tuple[float, float] = (0.95, 0.999)
    epsilon: float = 1e-8
    weight_decay: float = 1e-6
    warmup_steps: int = 500
    ema_power: float = 0.75
    ema_max_decay: float = 0.9999
    proprio_noise: float = 0.0  # standard deviation on normalised joint positions, one draw a window
    seed: int = 0
    device: str = "auto"  # auto | cpu | cuda
    log_every: int = 20  # steps between rows of the curves
    checkpoint_every: int = 1000  # steps between resumable states

    def __post_init__(self) -> None:
        object.__setattr__(self, "betas", tuple(self.betas))
        _bounded(self, MOST_TRAINING)
        budgets = {name: getattr(self, name) for name in ("epochs", "steps")}
        given = {name: value for name, value in budgets.items() if value is not None}
        _require(len(given) == 1, "the training budget", given, "exactly one of epochs and steps")
        _positive(
            self, *given, "batch_size", "run_length", "noise_draws", "learning_rate", "eyes_rate", "epsilon"
        )
        _positive(self, "log_every", "checkpoint_every", "ema_power")
        counts = "warmup_steps", "eyes_shift_px", "eyes_steps", "draft_steps", "seed"
        for name in ("weight_decay", "proprio_noise", *counts):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "0 or above")
        _require(all(0 <= beta < 1 for beta in self.betas), "betas", self.betas, "two numbers in [0, 1)")
        _require(0 <= self.going <= 1, "going", self.going, "a number from 0 to 1")
        _require(0 <= self.ema_max_decay < 1, "ema_max_decay", self.ema_max_decay, "a number in [0, 1)")
        _one_of(self, "device", ("auto", "cpu", "cuda"))

    @property
    def identity(self) -> dict[str, Any]:
        """The fields that decide what comes out, but for those that came later, where they change nothing."""
        decides = {name: value for name, value in asdict(self).items() if name not in HOW}
        return without(decides, going=0.0)

    def rate(self, step: int, steps: int) -> float:
        """Of learning: linear warm-up, then half a cosine down to zero at the end (paper, supplementary)."""
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / self.warmup_steps
        part = (step - self.warmup_steps) / max(1, steps - self.warmup_steps)
        return self.learning_rate * 0.5 * (1.0 + math.cos(math.pi * part))
