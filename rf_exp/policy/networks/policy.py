"""Policy: pictures and joint positions in, a chunk of actions out, by an encoder and a head.

The condition of the head is [features, joint positions, context] of each observed frame, oldest first, each
scaled to its range in the demonstrations. The transition predictor and the goal gate, if any, are trained
with the first fit of the head.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.errors import StageError
from rf_exp.policy.config import ENCODERS, HEADS, PolicyConfig, name_of
from rf_exp.policy.examples.windows import Batch, Windows, action_origin
from rf_exp.policy.inputs.observation_spec import POSE_SIZE, ObservationSpec
from rf_exp.policy.inputs.pictures import scaled
from rf_exp.policy.inputs.view import ACTION_SIZE, View
from rf_exp.policy.networks.interfaces import Draw, Encoder, Fit, Head, hidden
from rf_exp.types import ARM_JOINTS

GATE_WIDTH = 256  # width of the hidden layer of a goal gate
LEAST_RANGE = 0.02  # rad or m: a joint that hardly moves is centred, without scaling its noise to [-1, 1]


class Range(nn.Module):
    """Affine map of the last axis (D) from its smallest and largest value to [-1, 1]."""

    centre: Tensor
    radius: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("centre", torch.zeros(size))
        self.register_buffer("radius", torch.ones(size))

    def fit(self, values: Tensor) -> None:
        """Take the range of values (K, D); it is at least `LEAST_RANGE` wide."""
        low, high = values.amin(dim=0), values.amax(dim=0)
        self.centre.copy_((low + high) / 2)
        self.radius.copy_(((high - low) / 2).clamp(min=LEAST_RANGE / 2))

    def normalise(self, values: Tensor) -> Tensor:
        return (values - self.centre) / self.radius

    def restore(self, values: Tensor) -> Tensor:
        return values * self.radius + self.centre


class Normaliser(nn.Module):
    """Statistics of the demonstrations: ranges, and the largest change of each target in a control step."""

    fastest: Tensor  # (A,) largest change of each action between two control steps of a demonstration

    def __init__(self, proprio_size: int, action_size: int, context_size: int, features: int) -> None:
        super().__init__()
        self.proprio, self.action = Range(proprio_size), Range(action_size)
        self.context, self.features = Range(context_size), Range(features)
        self.register_buffer("fastest", torch.zeros(action_size))

    def fit(self, windows: Windows) -> None:
        """Fit all ranges but that of the picture features, whose encoder may have to be trained first."""
        self.proprio.fit(windows.proprio)
        self.context.fit(windows.context)
        self.action.fit(windows.learned_actions())
        self.fastest.copy_(windows.fastest())


class TransitionPredictor(nn.Module):
    """Transition predictor: condition (B, C) -> subgoal, of K, and whether to go on, for n own agents."""

    def __init__(self, condition: int, agents: int, size: int, dropout: float) -> None:
        """`size` is K + 1."""
        super().__init__()
        self._agents, self._size = agents, agents * size
        self.layers = nn.Sequential(*hidden([condition, 256, 256], dropout), nn.Linear(256, self._size))

    def without_phases(self, context: Tensor) -> Tensor:
        """Context (..., C) with the phases, which are predicted, set to zero."""
        return functional.pad(context[..., : -self._size], (0, self._size))

    def with_phases(self, context: Tensor, subgoals: Tensor, may_go_on: Tensor) -> Tensor:
        """Context (B, O, C) with these subgoals (B, n) of the own agents and permissions to go on (B, n)."""
        subgoal = functional.one_hot(subgoals, self._size // self._agents - 1)
        phase = torch.cat([subgoal, may_go_on[..., None]], dim=2).flatten(1).to(context.dtype)
        repeated = phase[:, None].expand(-1, context.shape[1], -1)
        return torch.cat([context[..., : -self._size], repeated], dim=2)

    def loss(self, condition: Tensor, context: Tensor, weights: Tensor) -> Tensor:
        """Weighted cross entropy to the phases in `context`, which `condition` hides; weights (B,)."""
        logits = self.layers(condition).float().unflatten(1, (self._agents, -1)).flatten(0, 1)
        phase = context[:, -1, -self._size :].reshape(logits.shape)
        subgoal_loss = functional.cross_entropy(logits[:, :-1], phase[:, :-1], reduction="none")
        may_go_on_loss = functional.binary_cross_entropy_with_logits(
            logits[:, -1], phase[:, -1], reduction="none"
        )
        return (weights.repeat_interleave(self._agents) * (subgoal_loss + may_go_on_loss)).mean()

    def probabilities(self, condition: Tensor) -> Tensor:
        """Probabilities (B, n, K + 1) of each subgoal and, in the last column, of going on."""
        logits = self.layers(condition).unflatten(1, (self._agents, -1))
        return torch.cat([logits[..., :-1].softmax(dim=2), logits[..., -1:].sigmoid()], dim=2)


class GoalGate(nn.Module):
    """Goal gate: condition (B, C) -> fraction of the way to its goal (B, T, n), for n own arms and T steps.

    Relative actions are offsets from the current TCP; in a chunk of decimetres a millimetre close to the goal
    is lost. With a gate near 1 they are offsets from the goal, where nearly nothing is left to predict.
    """

    def __init__(self, condition: int, horizon: int, agents: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *hidden([condition, GATE_WIDTH]),
            nn.Linear(GATE_WIDTH, horizon * agents),
            nn.Unflatten(1, (horizon, agents)),
        )

    def forward(self, condition: Tensor) -> Tensor:
        return self.layers(condition).sigmoid()


class Policy(nn.Module):
    """Policy of one view: O frames of pictures, proprioception and context -> actions (T, A).

    Actions are joint targets and gripper commands; with task-space actions, TCP poses follow behind them.
    """

    def __init__(self, config: PolicyConfig, view: View, spec: ObservationSpec | None = None) -> None:
        super().__init__()
        spec = spec or ObservationSpec()
        self.config, self._agents = config, view.action_size // ACTION_SIZE
        actions = view.action_size + self._agents * POSE_SIZE * config.task_space_actions
        self.encoder: Encoder = ENCODERS[name_of(config.encoder)].make(config.encoder, view, spec)
        frame_size = self.encoder.size + view.proprio_size + spec.size(view)
        condition_size = config.observation_steps * frame_size
        self.transitions: TransitionPredictor | None = None
        if config.phases and not view.coordinated:
            sizes = self._agents, spec.phase_size, config.phase_dropout
            self.transitions = TransitionPredictor(condition_size, *sizes)
        self.head: Head = HEADS[name_of(config.head)].make(
            config.head, condition_size, config.horizon, actions
        )
        self.normaliser = Normaliser(view.proprio_size, actions, spec.size(view), self.encoder.size)
        self.gate = GoalGate(condition_size, config.horizon, self._agents) if config.goal_gate else None

    # -- learning ------------------------------------------------------------------------------------

    def fits(self, examples: Windows) -> list[Fit]:
        """The fits of its training, in order: that of the encoder, if it has one, then those of the head."""
        result, trained_jointly, config = [], [self.encoder], self.config
        if (encoder_fit := self.encoder.fit(examples)) is not None:
            picture = [config.height, config.width]
            cache_key = encoder_fit.cache_key and {
                name_of(config.encoder): encoder_fit.cache_key,
                "picture": picture,
            }
            finish = partial(self._finish_encoder, examples, encoder_fit.finish)
            result, trained_jointly = [replace(encoder_fit, finish=finish, cache_key=cache_key)], []
        for number, fit in enumerate(fit for fit in self.head.fits() if fit.steps != 0):
            transitions = self.transitions if number == 0 else None
            gate = self.gate if number == 0 else None
            parts = [*fit.parts, *(part for part in (transitions, gate) if part), *trained_jointly]
            result.append(replace(fit, parts=parts, loss=partial(self._loss, examples, fit, transitions)))
        return result

    def _loss(
        self, examples: Windows, fit: Fit, transitions: TransitionPredictor | None, draw: Draw
    ) -> Tensor:
        """Loss of a fit of the head, with that of a transition predictor trained beside it."""
        batch = examples.batch(draw.windows, draw.rng)
        observed = self._observed(batch, draw.generator)
        condition = self.condition(*observed)
        targets = self.normaliser.action.normalise(batch.action - self._origin(*observed, condition))
        loss = fit.loss(condition, targets, draw.generator)
        if loss.dim():
            raise self._wrong_head(f"gives a loss of shape {tuple(loss.shape)}; expected one number")
        if transitions is None:
            return loss
        batch_without_phases = replace(batch, context=transitions.without_phases(batch.context))
        condition_without_phases = self.condition(*self._observed(batch_without_phases, draw.generator))
        return loss + transitions.loss(condition_without_phases, batch.context, draw.weights)

    def _finish_encoder(self, examples: Windows, finish: Callable[[], None]) -> None:
        """Freeze the encoder: encode all pictures once, and fit the range of the features."""
        finish()
        features = examples.encode_once(self.eval().encode_centre_crops)
        conditioning = self.encoder.conditioning(features[:, None], examples.context[:, None])
        self.normaliser.features.fit(conditioning[:, 0])
        self.train()

    def _observed(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Features (B, O, F), proprioception and context of a batch, with training noise."""
        features, proprio, device = batch.features, batch.proprio, batch.proprio.device
        if features is None:
            features = proprio.new_zeros(*batch.frames.shape, 0)
            if self.encoder.features:
                features = self.encode(batch.pictures, batch.rays)[batch.frames]
        if batch.gripper_offsets is not None:
            features = self.encoder.displaced(features, batch.gripper_offsets)
        if noise := self.config.proprio_noise:
            # One shift per window: the policy has to use the pictures instead of inferring the goal from its
            # own pose.
            shift = torch.randn(len(batch), 1, proprio.shape[2], generator=generator, device=device)
            proprio = proprio + noise * self.normaliser.proprio.radius * shift
        return self.encoder.perturbed(features, generator), proprio, batch.context

    # -- both ----------------------------------------------------------------------------------------

    def encode(self, pictures: Tensor, rays: Tensor | None = None) -> Tensor:
        """Cropped uint8 pictures (U, h, w, 3), and the rays of their cameras -> features (U, F)."""
        return self.encoder.encode(scaled(pictures), rays)[0]

    def encode_centre_crops(
        self, pictures: Tensor, rays: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Features (U, F) of centre crops of uint8 pictures (U, H, W, 3), and detected points (U, M, 2)."""
        height, width = self.config.cropped(*pictures.shape[1:3])
        top, left = (pictures.shape[1] - height) // 2, (pictures.shape[2] - width) // 2
        return self.encoder.encode(scaled(pictures[:, top : top + height, left : left + width]), rays)

    def condition(self, features: Tensor, proprio: Tensor, context: Tensor) -> Tensor:
        """Features (B, O, F), proprioception (B, O, P) and context (B, O, C), all raw -> (B, condition)."""
        features = self.normaliser.features.normalise(self.encoder.conditioning(features, context))
        proprio = self.normaliser.proprio.normalise(proprio)
        return torch.cat([features, proprio, self.normaliser.context.normalise(context)], dim=2).flatten(1)

    def _wrong_head(self, how: str) -> StageError:
        return StageError(f"head {name_of(self.config.head)!r} ({type(self.head).__name__}) {how}")

    def _origin(
        self,
        features: Tensor,
        proprio: Tensor,
        context: Tensor,
        condition: Tensor,
        goal_shift: Tensor | float = 0.0,
    ) -> Tensor | float:
        """Origin (B, 1 or T, A) that is added to predictions to get targets; for `goal_shift` see `act`."""
        if not self.config.relative_actions:
            return 0.0
        origin = action_origin(proprio, context if self.config.task_space_actions else None)
        if self.gate is None:
            return origin
        to_goals = self.encoder.offsets(features, context)[:, -1] + goal_shift  # (B, n, 3)
        shares = self.gate(condition)[..., None] * to_goals[:, None]  # (B, T, n, 3)
        poses = functional.pad(shares, (0, POSE_SIZE - to_goals.shape[2])).flatten(2)
        return origin + functional.pad(poses, (self._agents * ACTION_SIZE, 0))

    # -- acting --------------------------------------------------------------------------------------

    @torch.inference_mode()
    def transition_probabilities(self, features: Tensor, proprio: Tensor, context: Tensor) -> Tensor | None:
        """Probabilities (B, n, K + 1) of each own agent: each subgoal and, in the last column, going on.

        From raw features (B, O, F), proprioception (B, O, P) and context (B, O, C). None if not predicted.
        """
        if self.transitions is None:
            return None
        return self.transitions.probabilities(
            self.condition(features, proprio, self.transitions.without_phases(context))
        )

    def with_phases(self, context: Tensor, subgoals: Tensor, may_go_on: Tensor) -> Tensor:
        """Context (B, O, C) with these subgoals (B, n) of the own agents and permissions to go on (B, n)."""
        assert self.transitions is not None
        return self.transitions.with_phases(context, subgoals, may_go_on)

    @torch.inference_mode()
    def act(
        self,
        features: Tensor,
        proprio: Tensor,
        context: Tensor,
        generators: list[torch.Generator],
        goal_shift: Tensor | float = 0.0,
    ) -> Tensor:
        """Features (B, O, F), raw proprioception (B, O, P) and context (B, O, C) -> actions (B, T, A), raw.

        All noise of row b comes from `generators[b]`, so a row does not depend on its neighbours. With a goal
        gate, `goal_shift` (B, n, 3) displaces the detected own goals, in m in the footprint of the first own
        arm.
        """
        condition = self.condition(features, proprio, context)
        sample = self.head.sample(condition, generators)
        expected = len(context), self.config.horizon, self.normaliser.action.centre.shape[0]
        if sample.shape != expected:
            raise self._wrong_head(f"samples actions of shape {tuple(sample.shape)}; expected {expected}")
        origin = self._origin(features, proprio, context, condition, goal_shift)
        actions = self.normaliser.action.restore(sample) + origin
        if self.config.binary_grippers:
            commands = actions[..., : self._agents * ACTION_SIZE]
            grippers = commands.unflatten(-1, (-1, ACTION_SIZE))[..., ARM_JOINTS]
            grippers.copy_(torch.where(grippers > 0, 1.0, -1.0))
        return actions
