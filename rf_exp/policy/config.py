"""Configuration of a policy and of its training, as frozen, validated dataclasses.

All defaults are in conf/policy/. A policy is an encoder and a head, each chosen by name. The section of that
name in `policy.encoder` or `policy.head` configures it; a head composed of other heads also reads their
sections. A module named in a recipe may register others from outside the package (`add_encoder`, `add_head`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import reduce
from importlib import import_module
from pkgutil import resolve_name
from typing import Any, ClassVar

from rf_exp.artifacts import drop_defaults, read_values
from rf_exp.errors import ArgumentError, unknown_choice
from rf_exp.policy.bounds import ACTING, Checked, bounded, merged, one_of, require, values
from rf_exp.types import LARGEST_PX

# Version of everything from demonstrations to weights; raise it whenever a training yields other weights.
LEARNER = 10
MODEL = "model.safetensors"  # in the folder of a policy, once training has finished
CELL_PX = 4  # pixels of the downsampled picture per cell of a heat map
SMALLEST_CROP_PX = 8  # pixels
# Keys added after policies were released, with their neutral values, which are left out of identities.
LATER_DEFAULTS: Mapping[str, Any] = {
    "start_offset_rad": 0.0,
    "goal_gate": False,
    "acting": {"homing": False, "regrasp_step_m": 0.0},
    "encoder": {"keypoints": {"dilations": (1, 2, 4)}},
}
CODE_KEY = "code"  # key of `policy`: a module that registers encoders or heads; not stored with a policy
NON_IDENTITY_KEYS = ("device", "log_every", "checkpoint_every")  # training keys that do not affect the result
BUDGET_KEYS = ("epochs", "steps")  # training keys: length of the last fit; the other fits define their own


class PartConfig(Checked):
    """Base configuration of a part of a policy (encoder or head), a frozen dataclass."""

    def check_in(self, policy: "PolicyConfig") -> None:
        """Raises ArgumentError for a policy that this part cannot be used in."""


class EncoderConfig(PartConfig):
    """Configuration of an encoder. The class attributes state which inputs it needs."""

    pictures: ClassVar[bool] = True  # whether it uses pictures
    keypoints: ClassVar[bool] = False  # whether it learns from gripper poses, now and at gripper changes
    privileged: ClassVar[bool] = False  # whether the context contains the true poses of all objects instead
    large: ClassVar[bool] = False  # whether it benefits from several threads, and from bfloat16 on a GPU


@dataclass(frozen=True)
class ResNet18Config(EncoderConfig):
    """The paper's encoder."""

    large: ClassVar[bool] = True


@dataclass(frozen=True)
class CompactConfig(EncoderConfig):
    """Three small convolutions."""


@dataclass(frozen=True)
class PrivilegedConfig(EncoderConfig):
    """No encoder: true poses in place of pictures, as an upper bound for a recipe."""

    pictures: ClassVar[bool] = False
    privileged: ClassVar[bool] = True

    def check_in(self, policy: "PolicyConfig") -> None:
        require(policy.context, "context", policy.context, "true with encoder privileged")


@dataclass(frozen=True)
class KeypointsConfig(EncoderConfig):
    """Keypoint encoder: a heat map for each keypoint; with `steps` it is trained first and then frozen."""

    keypoints: ClassVar[bool] = True
    downsample: int = bounded(64, least=1)  # factor, of the picture that heat maps cover
    crop_refinement: int = bounded(LARGEST_PX, least=0)  # side of its crops of the full picture, px; 0: none
    noise: float = bounded(1, least=0)  # m, standard deviation on keypoints while the head is trained
    steps: int = bounded(10**9, least=0)  # length of its own fit, before all others; 0: trained with the head
    rate: float = bounded(1e3, above=0)  # learning rate of that fit, as a multiple of the training's
    shift_px: int = bounded(LARGEST_PX, least=0)  # largest random shift of pictures in that fit, either way
    photometric: float = bounded(2, least=0)  # strength of photometric augmentation in that fit; 0: none
    dilations: tuple[int, ...] = bounded(64, least=1, expected="whole numbers from 1 to 64")
    # Dilation of each 3x3 convolution, cells; their sum is the reach of the receptive field to each side.

    def check_in(self, policy: "PolicyConfig") -> None:
        possible = policy.context and policy.crop == 1.0
        require(possible, "encoder", "keypoints", "context=true and crop=1 with keypoints")
        cell = CELL_PX * self.downsample
        expected = f"a multiple of {cell} with encoder keypoints and downsample={self.downsample}"
        for side in ("height", "width"):
            require(getattr(policy, side) % cell == 0, side, getattr(policy, side), expected)
        largest = min(policy.height, policy.width)
        valid = not self.crop_refinement or SMALLEST_CROP_PX <= self.crop_refinement <= largest
        expected = f"0, or {SMALLEST_CROP_PX} to {largest} pixels"
        require(valid, "crop_refinement", self.crop_refinement, expected)


class HeadConfig(PartConfig):
    """Configuration of a head. A field that is the configuration of another head has its own section."""


@dataclass(frozen=True)
class DiffusionConfig(HeadConfig):
    """Diffusion head: trunk, U-Net and diffusion process; sampler and inference steps affect no weights."""

    trunk: tuple[int, ...] = bounded(above=0, expected="numbers above 0")  # hidden layers before the U-Net
    channels: tuple[int, ...] = bounded()  # per level of the U-Net
    train_timesteps: int = bounded(1000, above=0)
    prediction: str = one_of("epsilon", "sample", "v_prediction")
    loss: str = one_of("mse", "l1")
    noise_draws: int = bounded(1024, above=0)  # draws of step and noise for each window of a batch
    sampler: str = one_of("ddpm", "ddim", acting=True)
    inference_steps: int = bounded(1000, acting=True)  # 0: the regression chunk, unrefined

    def check_in(self, policy: "PolicyConfig", least: int = 1) -> None:
        halvings = 2 ** max(0, len(self.channels) - 1)
        require(policy.horizon % halvings == 0, "horizon", policy.horizon, f"a multiple of {halvings}")
        steps, most = self.inference_steps, self.train_timesteps
        require(least <= steps <= most, "inference_steps", steps, f"{least} to {most}")
        valid = self.sampler != "ddpm" or steps == most
        require(valid, "inference_steps", steps, f"{most} with sampler ddpm")


@dataclass(frozen=True)
class RegressionConfig(HeadConfig):
    """Regression head: a perceptron."""

    hidden: tuple[int, ...] = bounded(above=0, expected="numbers above 0")
    dropout: float = bounded(least=0, below=1)

    def check(self) -> None:
        require(len(self.hidden) > 0, "hidden", self.hidden, "at least one hidden layer")


@dataclass(frozen=True)
class RefinedConfig(HeadConfig):
    """Refined head: regression, trained first for `regression_steps`; diffusion then refines its chunk."""

    regression: RegressionConfig
    diffusion: DiffusionConfig
    regression_steps: int = bounded(10**9, least=0)

    def check_in(self, policy: "PolicyConfig") -> None:
        predicts_sample = self.diffusion.prediction == "sample"
        expected = "sample, where a chunk of actions is refined"
        require(predicts_sample, "prediction", self.diffusion.prediction, expected)
        self.diffusion.check_in(policy, least=0)


@dataclass(frozen=True)
class Registration:
    """A registered encoder or head: its configuration, and its class or, to import torch late, its path."""

    config: type
    part: Callable[..., Any] | str

    def make(self, *arguments: Any) -> Any:
        """The encoder or head, from its configuration and the other arguments of its class."""
        part = self.part
        if isinstance(part, str):
            part = resolve_name(f"rf_exp.policy.networks.{part}")
        return part(*arguments)


ENCODERS: dict[str, Registration] = {
    "resnet18": Registration(ResNet18Config, "encoders:ResNet18"),
    "compact": Registration(CompactConfig, "encoders:Compact"),
    "keypoints": Registration(KeypointsConfig, "keypoint_encoder:KeypointEncoder"),
    "privileged": Registration(PrivilegedConfig, "interfaces:Encoder"),
}
HEADS: dict[str, Registration] = {
    "diffusion": Registration(DiffusionConfig, "heads:DiffusionHead"),
    "regression": Registration(RegressionConfig, "heads:RegressionHead"),
    "refined": Registration(RefinedConfig, "heads:RefinedHead"),
}
PARTS = {"encoder": ENCODERS, "head": HEADS}


def add_encoder(name: str, config: type[EncoderConfig], encoder: Callable[..., Any]) -> None:
    """Register an encoder, `encoder(config, view, spec)`. Raises ArgumentError for a used or invalid name."""
    _add("encoder", name, Registration(config, encoder))


def add_head(name: str, config: type[HeadConfig], head: Callable[..., Any]) -> None:
    """Register a head, `head(config, condition, horizon, actions)`. Raises ArgumentError as `add_encoder`."""
    _add("head", name, Registration(config, head))


def _add(kind: str, name: str, registration: Registration) -> None:
    if name in PARTS[kind] or not name.isidentifier() or name == "name":
        reason = "is registered already" if name in PARTS[kind] else "is not a valid key"
        raise ArgumentError(f"{kind} {name!r} {reason}")
    PARTS[kind][name] = registration


def name_of(part: PartConfig) -> str:
    """The registered name of an encoder or head."""
    registered = (entry for registrations in PARTS.values() for entry in registrations.items())
    return next(name for name, registration in registered if registration.config is type(part))


def import_code(policy: object) -> None:
    """Import the module that a recipe names, if it names one. Raises ArgumentError where that fails."""
    if not isinstance(policy, Mapping) or (code := policy.get(CODE_KEY)) is None:
        return
    try:
        import_module(code)
    except Exception as error:  # an import may raise anything
        raise ArgumentError(
            f"policy.code: {code!r} cannot be imported: {type(error).__name__}: {error}; expected a module "
            "that Python finds, in this folder or by PYTHONPATH"
        ) from error


@dataclass(frozen=True)
class ActingConfig(Checked):
    """What a policy does with the chunks that its head samples."""

    homing: bool
    # An arm moves to its rest posture, in a straight line in joint space, before its first observation and
    # after a failed grasp (fingers closed on nothing).
    regrasp_step_m: float = bounded(0.1, least=0)
    # After a failed grasp or press the goal is displaced in steps of this length along the camera ray: a new
    # observation would repeat the error, most of which is along the ray.
    action_steps: int = bounded(512, above=0)  # executed before the next prediction
    deadband_rad: float = bounded(math.pi, least=0)  # chunks smaller than this move nothing
    transition_integrator: float = bounded(1e6, least=0)
    # A waiting agent goes on once its predicted probabilities of going on, summed while the scene does not
    # change, reach this; 0: once a single one exceeds 0.5.


@dataclass(frozen=True)
class PolicyConfig(Checked):
    """Configuration of a policy: networks, inputs and outputs; pictures have `height` x `width` pixels."""

    encoder: EncoderConfig
    head: HeadConfig
    acting: ActingConfig = field(metadata={ACTING: True})
    context: bool  # observes the own TCP pose and gripper history too
    phases: bool  # predicts its subgoal and whether it may go on
    relative_actions: bool  # joint targets as differences from the newest measured positions
    task_space_actions: bool  # predicts poses of the TCP too, which the joints follow
    goal_gate: bool  # predicts these relative to a learned fraction of the way to the next keyframe
    binary_grippers: bool  # gripper commands are fully open or fully closed
    horizon: int = bounded(512, above=0)  # actions in a chunk, the first at the oldest observation
    observation_steps: int = bounded(64, above=0)
    phase_dropout: float = bounded(least=0, below=1)
    proprio_noise: float = bounded(1e3, least=0)
    # Standard deviation on normalised joint positions in training, one draw per window.
    start_offset_rad: float = bounded(1.0, least=0)
    # Standard deviation of start offsets of each joint in training, see `rf_exp.policy.examples.starts`.
    crop: float = bounded(1, above=0, expected="a number above 0, at most 1")
    # Side of the crop, as a fraction of the picture's.
    height: int = bounded(LARGEST_PX, above=0)  # pixels
    width: int = bounded(LARGEST_PX, above=0)

    def check(self) -> None:
        for name in ("phases", "task_space_actions"):
            valid = self.context or not getattr(self, name)
            require(valid, "context", self.context, f"true with {name}")
        can_home = self.context or not self.acting.homing  # without context the spec has no rest postures
        require(can_home, "context", self.context, "true with acting.homing")
        step_m = self.acting.regrasp_step_m
        can_search = self.acting.homing and self.goal_gate
        require(
            can_search or not step_m,
            "acting.regrasp_step_m",
            step_m,
            "0 without acting.homing and goal_gate",
        )
        can_offset = self.encoder.keypoints or not self.start_offset_rad  # pictures cannot be shifted along
        require(can_offset, "start_offset_rad", self.start_offset_rad, "0 but with encoder keypoints")
        can_gate = self.encoder.keypoints and self.relative_actions and self.task_space_actions
        expected = "false but with encoder keypoints, relative_actions and task_space_actions"
        require(can_gate or not self.goal_gate, "goal_gate", self.goal_gate, expected)
        self.encoder.check_in(self)
        self.head.check_in(self)
        most = self.horizon - self.observation_steps + 1
        executed = self.acting.action_steps
        require(executed <= most, "action_steps", executed, f"at most {most}")

    @staticmethod
    def read(*nodes: Mapping[str, Any]) -> "PolicyConfig":
        """From a recipe, or `training_values` and `acting_values`; later values win.

        Raises ArgumentError naming the key.
        """
        if invalid := [each for each in nodes if not isinstance(each, Mapping)]:
            raise ArgumentError(f"policy is {invalid[0]!r}; expected keys below it")
        node = reduce(merged, nodes, LATER_DEFAULTS)
        parts = {kind: _read_part(kind, node.get(kind)) for kind in PARTS}
        return read_values(PolicyConfig, {**node, **parts}, "policy.")

    @property
    def identity(self) -> dict[str, Any]:
        """All values, nested as in a recipe, but for neutral ones of `LATER_DEFAULTS`."""
        return self._values(None)

    @property
    def complete(self) -> dict[str, Any]:
        """All values, those of `LATER_DEFAULTS` included, for comparison with other recipes."""
        return self._values(None, {})

    @property
    def training_values(self) -> dict[str, Any]:
        """The values that determine the weights."""
        return self._values(False)

    @property
    def acting_values(self) -> dict[str, Any]:
        """The values that affect acting only."""
        return self._values(True)

    def _values(self, acting: bool | None, omitted: Mapping[str, Any] = LATER_DEFAULTS) -> dict[str, Any]:
        result = values(self, acting)
        for kind in PARTS:
            part, section = getattr(self, kind), result.pop(kind, {})
            own_fields = {
                key: value for key, value in section.items() if not is_dataclass(getattr(part, key))
            }
            nested = {key: value for key, value in section.items() if key not in own_fields}
            name = name_of(part)
            entry = ({} if acting else {"name": name}) | ({name: own_fields} if own_fields else {}) | nested
            result |= {kind: entry} if entry else {}
        return _without(result, omitted)

    def acting_as(self, other: "PolicyConfig") -> "PolicyConfig":
        """This policy with the acting values of another one with the same encoder and head."""
        defaults = {"acting": LATER_DEFAULTS["acting"]}  # `acting_values` omits these
        return PolicyConfig.read(self.identity, defaults, other.acting_values)

    @property
    def observation(self) -> str:
        """The kind of its observations in rows: `state` for a privileged-state policy."""
        return "state" if self.encoder.privileged else "pictures"

    def cropped(self, height: int, width: int) -> tuple[int, int]:
        """Height and width, in pixels, of the crop of such a picture that the encoder gets."""
        return round(self.crop * height), round(self.crop * width)


def _without(mapping: Mapping[str, Any], neutral: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values without those that equal the neutral ones in `neutral`."""
    nested = [key for key, value in neutral.items() if isinstance(value, Mapping) and key in mapping]
    return drop_defaults(
        {**mapping, **{key: _without(mapping[key], neutral[key]) for key in nested}}, **neutral
    )


def read_recipe(node: Mapping[str, Any], picture: Mapping[str, int]) -> PolicyConfig:
    """The policy of a user's recipe; imports the module that it names, if any."""
    import_code(node)
    return PolicyConfig.read({key: value for key, value in node.items() if key != CODE_KEY}, picture)


def policy_keys() -> dict[str, Any]:
    """The nested keys of `policy` in a recipe, with a section for each registered encoder and head."""
    keys: dict[str, Any] = {CODE_KEY: None}
    for field_ in fields(PolicyConfig):
        if field_.name in PARTS:
            sections = {
                name: _own_keys(registration.config) for name, registration in PARTS[field_.name].items()
            }
            keys[field_.name] = {"name": None, **{name: own for name, own in sections.items() if own}}
        elif field_.name not in ("height", "width"):  # these come from `picture`
            keys[field_.name] = _own_keys(field_.type) if is_dataclass(field_.type) else None
    return keys


def _own_keys(config: Any) -> dict[str, None]:
    """Keys of a configuration, but for parts that have a section of their own."""
    return {field_.name: None for field_ in fields(config) if not is_dataclass(field_.type)}


def _read_part(kind: str, node: object) -> Any:
    """The configuration of the chosen encoder or head, from the sections of all."""
    name = node.get("name") if isinstance(node, Mapping) else None
    if not isinstance(node, Mapping) or not isinstance(name, str):
        raise ArgumentError(f"policy.{kind} is {node!r}; expected a mapping with a name")
    if name not in PARTS[kind]:
        raise unknown_choice(kind, name, PARTS[kind])
    config, section = PARTS[kind][name].config, node.get(name, {})
    if not isinstance(section, Mapping):
        raise ArgumentError(f"policy.{kind}.{name} is {section!r}; expected a mapping")
    nested: dict[str, Any] = {
        field_.name: field_.type for field_ in fields(config) if is_dataclass(field_.type)
    }
    parts = {
        key: read_values(part, node.get(key, {}), f"policy.{kind}.{key}.") for key, part in nested.items()
    }
    return read_values(config, {**section, **parts}, f"policy.{kind}.{name}.")


@dataclass(frozen=True)
class TrainConfig(Checked):
    """How a policy is trained. Exactly one of `epochs` and `steps` is the budget."""

    epochs: int | None = bounded(10**6, above=0)
    steps: int | None = bounded(10**9, above=0)
    batch_size: int = bounded(2**16, above=0)  # windows
    active_agent_sampling: float = bounded(1, least=0)
    # Fraction of a batch drawn from windows in which an own agent may go on.
    run_length: int = bounded(2**16, above=0)  # consecutive windows drawn together, encoded once
    learning_rate: float = bounded(math.inf, above=0)
    betas: tuple[float, float] = bounded(least=0, below=1, expected="two numbers in [0, 1)")
    epsilon: float = bounded(1, above=0)
    weight_decay: float = bounded(1e3, least=0)
    warmup_steps: int = bounded(10**9, least=0)
    ema_power: float = bounded(1e3, above=0)
    ema_max_decay: float = bounded(least=0, below=1)
    device: str = one_of("auto", "cpu", "cuda")
    log_every: int = bounded(10**9, above=0)  # steps between rows of the curves
    checkpoint_every: int = bounded(10**9, above=0)  # steps between resumable states
    seed: int = 0  # `train_seed` of an experiment

    def check(self) -> None:
        budget = {name: value for name in BUDGET_KEYS if (value := getattr(self, name)) is not None}
        require(len(budget) == 1, "the training budget", budget, "exactly one of epochs and steps")
        require(0 <= self.seed < 2**32, "seed", self.seed, f"0 to {2**32 - 1}")

    @staticmethod
    def read(identity: Mapping[str, Any]) -> "TrainConfig":
        """The inverse of `identity`. Raises ArgumentError naming the key."""
        defaults = {"device": "auto", "log_every": 1, "checkpoint_every": 1}
        return read_values(TrainConfig, {**defaults, **identity}, "training.")

    @property
    def identity(self) -> dict[str, Any]:
        """The fields that affect the result."""
        return {name: value for name, value in values(self).items() if name not in NON_IDENTITY_KEYS}

    @property
    def settings_without_budget(self) -> dict[str, Any]:
        """Those of them that affect the result of a fit with its own number of steps."""
        return {name: value for name, value in self.identity.items() if name not in BUDGET_KEYS}
