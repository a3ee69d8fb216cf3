"""The diffusion policy: pictures and joint positions in, a chunk of actions out (Chi et al. 2023).

The observation vector is [features, joint positions, context] of each observed frame, oldest first. Sampling
computes what stays the same once: the FiLM table over the diffusion steps and the projection of the
observation.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from diffusers.utils.torch_utils import randn_tensor
from torch import Tensor, nn
from torch.nn import functional

from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.examples.windows import Batch, action_origin
from rf_exp.policy.inputs.observation_spec import POSE, near, of_agent
from rf_exp.policy.inputs.view import ACTION_SIZE
from rf_exp.policy.networks.encoders import Blind, Compact, ResNet18, encoder
from rf_exp.policy.networks.keypoint_encoder import OUT, PLACED, Eyes
from rf_exp.policy.networks.layers import hidden, scaled, scheduler
from rf_exp.policy.networks.normaliser import Normaliser
from rf_exp.policy.networks.unet import ConditionalUNet1D
from rf_exp.types import ARM_JOINTS

NEXT = OUT + 3 + 3  # numbers that say where an own arm goes next


def _encoder(
    config: PolicyConfig, keypoints: int, watched: tuple[int, int]
) -> ResNet18 | Compact | Eyes | Blind:
    if config.observation != "pictures":
        return Blind()
    if config.encoder == "heatmaps":
        return Eyes(keypoints, *watched, config.shrink, config.close_up)
    return encoder(config.encoder)


class DiffusionPolicy(nn.Module):
    """One policy: actions of size A from proprioception of size P and context of size C in O frames.

    `action_size` counts joints and grippers; with `tcp_actions` the poses of TCPs come behind them.
    """

    def __init__(
        self,
        config: PolicyConfig,
        proprio_size: int,
        action_size: int,
        context_size: int = 0,
        keypoints: int = 0,
        keys: int = 0,
        phase: int = 0,
        watched: tuple[int, int] = (0, 0),
    ) -> None:
        """Heat maps look for so many `keypoints`: `keys` of each own agent's gripper, its end, the others.

        So many last numbers of the context for each own agent are a `phase` that the policy predicts. So many
        others, each of which has so many subgoals, are `watched`.
        """
        super().__init__()
        self.config, self._keys, self._agents = config, keys, action_size // ACTION_SIZE
        action_size += self._agents * POSE * config.tcp_actions
        self.action_size = action_size  # of joints and grippers, and behind them of the poses of TCPs
        self.encoder = _encoder(config, keypoints, watched)
        seen = self.encoder.features
        if isinstance(self.encoder, Eyes):
            seen += self._agents * NEXT
        size = config.observation_steps * (seen + proprio_size + context_size)
        self._told = self._agents * phase  # the last numbers of a context
        self.phase: nn.Module | None = None
        if phase:
            self.phase = nn.Sequential(*hidden([size, 256, 256], config.dropout), nn.Linear(256, self._told))
        self.trunk = nn.Sequential(*hidden([size, *config.trunk]))
        given = action_size if config.draft else 0
        self.unet = ConditionalUNet1D(action_size, [size, *config.trunk][-1], config.unet_channels, given)
        self.draft: nn.Module | None = None
        if config.draft:
            self.draft = nn.Sequential(
                *hidden([size, *config.draft], config.dropout),
                nn.Linear(config.draft[-1], config.horizon * action_size),
                nn.Unflatten(1, (config.horizon, action_size)),
            )
        self.normaliser = Normaliser(
            proprio_size, action_size, context_size, seen if isinstance(self.encoder, Eyes) else 0
        )
        self.scheduler = scheduler(config)
        self._film_table: Tensor | None = None  # (inference steps, F), once the weights are final
        self._quick: Callable[[Tensor, Tensor], Tensor] | None = None  # the U-Net, then

    def train(self, mode: bool = True) -> "DiffusionPolicy":
        self._film_table = self._quick = None  # weights may change: what was derived from them is not valid
        return super().train(mode)

    def encode(self, pictures: Tensor) -> Tensor:
        """Cropped uint8 pictures (U, h, w, 3) -> features (U, F)."""
        return self.encoder(scaled(pictures))

    def encode_whole(self, pictures: Tensor) -> Tensor:
        """Uncropped uint8 pictures (U, H, W, 3) -> features (U, F) of their centres."""
        height, width = self.config.cropped(*pictures.shape[1:3])
        top, left = (pictures.shape[1] - height) // 2, (pictures.shape[2] - width) // 2
        return self.encode(pictures[:, top : top + height, left : left + width])

    def look(self, pictures: Tensor) -> tuple[Tensor, Tensor | None]:
        """Features of pictures (U, H, W, 3), and where in them heat maps see their keypoints: (U, M, 2)."""
        if isinstance(self.encoder, Eyes):
            return self.encoder.see(scaled(pictures))
        return self.encode_whole(pictures), None

    def observation(self, features: Tensor, proprio: Tensor, context: Tensor) -> Tensor:
        """Features (B, O, F), proprioception (B, O, P) and context (B, O, C), all raw -> (B, observation)."""
        if isinstance(self.encoder, Eyes):
            features = self.normaliser.seen.normalise(self.pointed(features, context))
        proprio = self.normaliser.proprio.normalise(proprio)
        context = self.normaliser.context.normalise(context)
        return torch.cat([features, proprio, context], dim=2).flatten(1)

    def loss(
        self, batch: Batch, generator: torch.Generator, noise_draws: int = 1, proprio_noise: float = 0.0
    ) -> Tensor:
        """Mean squared error of the prediction over `noise_draws` draws of step and noise a window.

        `proprio_noise` is the standard deviation of a shift of the normalised joint positions, one for
        each window: it makes the policy look at the pictures rather than infer the goal from its own pose.
        """
        device = batch.action.device
        observation = self._observed(batch, generator, proprio_noise)
        draft = self._draft(observation)
        clean = self._clean(batch).repeat_interleave(noise_draws, dim=0)
        noise = torch.randn(clean.shape, generator=generator, device=device)
        count = self.config.train_diffusion_steps
        steps = torch.randint(count, (len(clean),), generator=generator, device=device)
        noisy = self.scheduler.add_noise(clean, noise, steps)  # pyright: ignore[reportArgumentType]
        # The observation is projected once for all its draws, every diffusion step once for the batch.
        table = self.unet.film_of_steps(torch.arange(count, device=device))
        projected = self.unet.film_of_observations(self.trunk(observation))
        film = table[steps] + projected.repeat_interleave(noise_draws, 0)
        if draft is not None:
            draft = draft.repeat_interleave(noise_draws, 0)
        prediction = self._refined(noisy, draft, film)
        error = functional.mse_loss if self.config.loss == "mse" else functional.l1_loss
        return error(prediction.float(), self._target(clean, noise, steps))

    def eyes_loss(self, pictures: Tensor, pixels: Tensor, headings: Tensor, doing: Tensor) -> Tensor:
        """Of pictures (B, H, W, 3), places and headings of their keypoints, and subgoals of the others."""
        assert isinstance(self.encoder, Eyes)
        return self.encoder.loss(scaled(pictures), pixels, headings, doing)

    def lift_eyes(self, pixels: Tensor, points: Tensor) -> None:
        """Tells heat maps where the points (N, M, 3) are that stand at `pixels` (N, M, 2) of pictures."""
        assert isinstance(self.encoder, Eyes)
        self.encoder.fit(pixels, points)

    def draft_loss(
        self, batch: Batch, weights: Tensor, generator: torch.Generator, proprio_noise: float = 0.0
    ) -> Tensor:
        """Mean absolute error of the draft, which is learned before the U-Net and then stays as it is.

        And the cross entropy of the phase, where it is predicted: windows count by their weights (B,) there.
        """
        assert self.draft is not None
        draft = self.draft(self._observed(batch, generator, proprio_noise))
        loss = functional.l1_loss(draft.float(), self._clean(batch))
        if self.phase is None:
            return loss
        unknown = replace(batch, context=self._without_phase(batch.context))
        found = self.phase(self._observed(unknown, generator, proprio_noise)).float()
        found = found.unflatten(1, (self._agents, -1)).flatten(0, 1)
        phase = batch.context[:, -1, -self._told :].reshape(found.shape)
        subgoal = functional.cross_entropy(found[:, :-1], phase[:, :-1], reduction="none")
        free = functional.binary_cross_entropy_with_logits(found[:, -1], phase[:, -1], reduction="none")
        return loss + (weights.repeat_interleave(self._agents) * (subgoal + free)).mean()

    def _without_phase(self, context: Tensor) -> Tensor:
        return functional.pad(context[..., : -self._told], (0, self._told))

    @torch.inference_mode()
    def chances(self, features: Tensor, proprio: Tensor, context: Tensor) -> Tensor | None:
        """Of raw features (B, O, F), proprioception (B, O, P) and context (B, O, C): how likely each own
        agent is at each subgoal and, in the last column, that it may go on (B, n, K + 1). None if it does
        not say.
        """
        if self.phase is None:
            return None
        found = self.phase(self.observation(features, proprio, self._without_phase(context)))
        found = found.unflatten(1, (self._agents, -1))
        return torch.cat([found[..., :-1].softmax(dim=2), found[..., -1:].sigmoid()], dim=2)

    def in_phase(self, context: Tensor, numbers: Tensor, free: Tensor) -> Tensor:
        """Context (B, O, C) with the subgoals (B, n) of the own agents and whether they may go on (B, n)."""
        subgoal = functional.one_hot(numbers, self._told // self._agents - 1)
        phase = torch.cat([subgoal, free[..., None]], dim=2).flatten(1).to(context.dtype)
        told = phase[:, None].expand(-1, context.shape[1], -1)
        return torch.cat([context[..., : -self._told], told], dim=2)

    def _observed(self, batch: Batch, generator: torch.Generator, proprio_noise: float) -> Tensor:
        features, proprio, device = self._features(batch), batch.proprio, batch.proprio.device
        if proprio_noise:
            shift = torch.randn(len(batch), 1, proprio.shape[2], generator=generator, device=device)
            proprio = proprio + proprio_noise * self.normaliser.proprio.radius * shift
        if isinstance(self.encoder, Eyes) and self.config.keypoint_noise:
            shape = len(batch), 1, self.encoder.keypoints, PLACED
            shift = torch.randn(shape, generator=generator, device=device)
            shift = self.config.keypoint_noise * functional.pad(shift, (0, OUT - PLACED)).flatten(2)
            features = features + functional.pad(shift, (0, features.shape[2] - shift.shape[2]))
        return self.observation(features, proprio, batch.context)

    def pointed(self, features: Tensor, context: Tensor) -> Tensor:
        """What the eyes see (B, O, M * OUT), and where each own arm goes next, also as seen from its TCP.

        And that once more where it is near: scaled to a range over the whole table, millimetres are lost.
        """
        assert isinstance(self.encoder, Eyes)
        keypoints = features[..., : self.encoder.keypoints * OUT].unflatten(2, (-1, OUT))
        parts = [features]
        for agent in range(self._agents):
            tcp, changes = of_agent(context, agent)
            now = functional.one_hot(changes.argmax(dim=2).clamp(max=self._keys), self._keys + 1)
            own = keypoints[:, :, agent * (self._keys + 1) : (agent + 1) * (self._keys + 1)]
            ahead = (own * now[..., None]).sum(dim=2)
            offset = ahead[..., :3] - tcp[..., :3]
            parts += [ahead, offset, near(offset)]
        return torch.cat(parts, dim=2)

    def _clean(self, batch: Batch) -> Tensor:
        """The normalised actions (B, T, A) of a batch."""
        return self.normaliser.action.normalise(batch.action - self._origin(batch.proprio, batch.context))

    def _draft(self, observation: Tensor) -> Tensor | None:
        """(B, T, A), which no gradient of the U-Net reaches."""
        if self.draft is None:
            return None
        with torch.no_grad():
            training = self.draft.training
            draft = self.draft.eval()(observation)
            self.draft.train(training)
        return draft

    def _refined(self, noisy: Tensor, draft: Tensor | None, film: Tensor) -> Tensor:
        """The prediction of the U-Net: with a draft of clean actions, its difference from that."""
        network = self._quick or self.unet.modulated
        if draft is None:
            return network(noisy, film)
        return draft + network(torch.cat([noisy, draft], dim=2), film)

    def _features(self, batch: Batch) -> Tensor:
        """(B, O, F) of a batch."""
        if batch.features is not None:
            return batch.features
        if self.encoder.features:
            return self.encode(batch.pictures)[batch.frames]
        return batch.proprio.new_zeros(*batch.frames.shape, 0)

    def _target(self, clean: Tensor, noise: Tensor, steps: Tensor) -> Tensor:
        if self.config.prediction == "epsilon":
            return noise
        if self.config.prediction == "sample":
            return clean
        return self.scheduler.get_velocity(clean, noise, steps)  # pyright: ignore[reportArgumentType]

    @torch.inference_mode()
    def act(
        self, features: Tensor, proprio: Tensor, context: Tensor, generators: list[torch.Generator]
    ) -> Tensor:
        """Features (B, O, F), raw proprioception (B, O, P) and context (B, O, C) -> actions (B, T, A), raw.

        All noise of row b comes from `generators[b]`, so a row does not depend on its neighbours.
        """
        shape = (len(features), self.config.horizon, self.action_size)
        observation = self.observation(features, proprio, context)
        film, draft = self.unet.film_of_observations(self.trunk(observation)), self._draft(observation)
        sample = randn_tensor(shape, generator=generators, device=features.device, dtype=features.dtype)
        steps = self.scheduler.timesteps
        if draft is not None and not self.config.inference_diffusion_steps:
            sample, steps = draft, steps[:0]
        if self._film_table is None:
            self._film_table = self.unet.film_of_steps(steps.to(features.device))
            if len(steps) and features.device.type == "cpu":
                known = sample if draft is None else torch.cat([sample, draft], dim=2)
                self._quick = self.unet.quick(known, film)
        for step, film_of_step in zip(steps, self._film_table, strict=True):
            prediction = self._refined(sample, draft, film + film_of_step)
            # A scheduler returns a tuple only when it is asked to.
            stepped = self.scheduler.step(prediction, step, sample, generator=generators)  # pyright: ignore[reportArgumentType]
            sample = stepped.prev_sample  # pyright: ignore[reportAttributeAccessIssue]
        actions = self.normaliser.action.restore(sample) + self._origin(proprio, context)
        if self.config.binary_grippers:
            told = actions[..., : self._agents * ACTION_SIZE]
            grippers = told.unflatten(-1, (-1, ACTION_SIZE))[..., ARM_JOINTS]
            grippers.copy_(torch.where(grippers > 0, 1.0, -1.0))
        return actions

    def _origin(self, proprio: Tensor, context: Tensor) -> Tensor | float:
        """What is added to a prediction to make targets of it (B, 1, A)."""
        if not self.config.relative_actions:
            return 0.0
        return action_origin(proprio, context if self.config.tcp_actions else None)
