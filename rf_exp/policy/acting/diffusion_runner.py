"""A diffusion policy that acts through the streams of its view."""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from rf_exp.errors import StageError
from rf_exp.policy.acting.patience import Patience
from rf_exp.policy.acting.runner import PolicyRunner
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.inputs.coordination import phases
from rf_exp.policy.inputs.gripper_history import Memory
from rf_exp.policy.inputs.observation_spec import ObservationSpec, context, others, proprioception, widths
from rf_exp.policy.inputs.pictures import side_by_side
from rf_exp.policy.inputs.task_space import joint_actions
from rf_exp.policy.inputs.view import ACTION_SIZE, Stream, View
from rf_exp.policy.learning.checkpoint import MODEL, load_policy
from rf_exp.policy.networks.policy import Policy
from rf_exp.types import ARM_JOINTS, Scene, Sight

WAIT_STEPS = 4  # after which one who waits looks again


@dataclass
class _Recent:
    """The last observations of an episode, and what else the next prediction depends on."""

    features: deque[torch.Tensor]  # of (S, F)
    proprio: deque[torch.Tensor]  # of (S, P)
    context: deque[torch.Tensor]  # of (S, C)
    patience: Patience
    generators: list[torch.Generator]  # of the streams
    memory: Memory | None = None  # of the grippers, once it knows how many there are
    widths: NDArray[np.floating] = field(default_factory=lambda: np.zeros(0))  # of all, as measured last
    # control step, commands (T, agents, 8)
    predicted: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)


class DiffusionRunner(PolicyRunner):
    """One policy acting through all streams of its view, batched: each stream is a row.

    Keeps the last observations already encoded, so every picture is encoded at most once, and only
    those are taken that an observation will hold.
    """

    def __init__(self, policy: Policy, view: View, spec: ObservationSpec | None = None) -> None:
        self._policy, self._config, self.spec = policy.eval(), policy.config, spec or ObservationSpec()
        self._device = policy.normaliser.fastest.device
        fastest = policy.normaliser.fastest.cpu().double().numpy()
        fastest = fastest[: view.action_size].reshape(-1, ACTION_SIZE)
        of_stream = fastest[:, :ARM_JOINTS].max(axis=1)  # (agents of a stream,) rad a control step
        super().__init__(view, np.tile(of_stream, len(view.streams)))
        self._recent = self._nothing_yet(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode. All noise of the next comes from its seed and the agents."""
        super().reset(seed)
        self._recent = self._nothing_yet(seed)

    def _nothing_yet(self, seed: int) -> _Recent:
        features, proprio, context = (deque(maxlen=self._config.observation_steps) for _ in range(3))
        generators = [_generator(seed, stream.agents[0]) for stream in self.view.streams]
        return _Recent(
            features, proprio, context, Patience(self._config.acting.transition_integrator), generators
        )

    @property
    def looks(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return self._config.encoder.pictures and self._observes

    @property
    def _observes(self) -> bool:
        """Whether this moment is part of it. Who was kept from acting may have to predict at any step."""
        runs_out = len(self.state.targets) < self._config.observation_steps
        return not self._recent.features or self.state.kept or runs_out

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8), as `PolicyRunner` gives them; remembers those of the grippers."""
        commands = super().act(decision)
        recent = self._recent
        if recent.memory is not None:
            grippers = dict(zip(self.view.agents, commands[:, ARM_JOINTS], strict=True))
            recent.memory.told(grippers, recent.widths)
        return commands

    @torch.inference_mode()
    def observe(self, scene: Scene, pictures: Mapping[str, NDArray[np.uint8]]) -> None:
        """Keep what belongs to the next prediction."""
        recent = self._recent
        if recent.memory is None:
            recent.memory = Memory(len(scene.qpos))
        recent.widths = widths(scene.qpos)
        if not self._observes:
            return
        streams, memory = self.view.streams, recent.memory.vector
        if self.spec.subgoals:
            said = np.zeros(len(memory), int), np.ones(len(memory), bool)  # until it says so itself
            if self.view.coordinated:
                if self.state.coordinated is None:
                    raise StageError(
                        f"policy {self.view.name!r} has learned with a coordinator; there is none here"
                    )
                said = self.state.coordinated
            memory = np.concatenate([memory, phases(*said, self.spec.subgoals)], axis=-1)
        qpos = np.stack([scene.qpos[np.array(stream.agents) - 1] for stream in streams])
        proprio = torch.from_numpy(proprioception(qpos)).to(self._device)
        known = np.stack(
            [
                context(self.spec, self.view, row, scene.qpos, scene.poses, memory)
                for row in range(len(streams))
            ]
        )
        features = proprio.new_zeros(len(streams), 0)
        if self.looks:
            seen = torch.from_numpy(np.stack([self._picture(pictures, stream) for stream in streams]))
            features, places = self._policy.look(seen.to(self._device))
            if places is not None:
                self.state.seen = tuple(self._sights(places.cpu().double().numpy(), recent.memory.changes))
        # Before an episode's start its first frame repeats, as in training.
        for _ in range(1 if recent.features else self._config.observation_steps):
            recent.features.append(features)
            recent.proprio.append(proprio)
            recent.context.append(torch.from_numpy(known).to(self._device))

    def _sights(self, places: NDArray[np.float64], changes: NDArray[np.int64]) -> Iterator[Sight]:
        """What heat maps see at (S, M, 2), but for what is past."""
        for stream, of_stream in zip(self.view.streams, places, strict=True):
            meant = [
                (agent, key, key == min(changes[agent - 1], self.spec.keyframes))
                for agent in stream.agents
                for key in range(self.spec.keyframes + 1)
            ]
            meant += [(agent, self.spec.keyframes, False) for agent in others(self.spec, stream)]
            count = len(stream.cameras)
            parts = zip(stream.cameras, np.split(of_stream, count), strict=True)
            for row, (camera, in_picture) in enumerate(parts):
                for (agent, key, goes), (x, y) in zip(meant, in_picture, strict=True):
                    if key >= min(changes[agent - 1], self.spec.keyframes):
                        yield Sight(camera, agent, float(count * x - row), float(y), bool(goes))

    def predict(self, scene: Scene) -> NDArray[np.float64]:
        """Sampled from what was observed. Who may not go on, or goes nowhere, stays where it was sent."""
        recent, targets, coordinated = self._recent, self.state.targets, self.state.coordinated
        assert recent.memory is not None
        features, proprio, known = (
            torch.stack([*each], dim=1) for each in (recent.features, recent.proprio, recent.context)
        )
        agents = np.array(self.view.agents) - 1
        free = np.ones(len(agents), dtype=bool)
        chances = self._policy.chances(features, proprio, known)
        if chances is not None:
            numbers, free = recent.patience(chances.flatten(0, 1).cpu().double().numpy())
            phase = (
                torch.from_numpy(each).to(known.device).unflatten(0, (len(known), -1))
                for each in (numbers, free)
            )
            known = self._policy.in_phase(known, *phase)
        opened = recent.memory.opened[agents]
        waits = ~free
        if self.view.coordinated and coordinated is not None:
            waits = ~coordinated[1][agents]
        if size := self.spec.phase_size:
            numbers = known[:, -1, -size * len(self.view.streams[0].agents) :].reshape(len(agents), size)
            doing = numbers[:, :-1].argmax(dim=1).tolist()
            self.state.phases = {
                agent: (number, not waiting)
                for agent, number, waiting in zip(self.view.agents, doing, waits.tolist(), strict=True)
            }
        if waits.all():
            stay = np.column_stack([targets.last, np.where(opened, 1.0, -1.0)])
            return np.tile(stay, (WAIT_STEPS, 1, 1))
        actions = self._policy.act(features, proprio, known, recent.generators).cpu().double().numpy()
        if not np.isfinite(actions).all():
            raise StageError(
                f"policy {self.view.name!r}, control step {scene.step}: it predicts actions that are not "
                "finite; its weights are of no use"
            )
        actions = actions[:, self._config.observation_steps - 1 :]  # a chunk starts at the oldest observation
        stays = waits | self._goes_nowhere(actions, scene.qpos[agents, :ARM_JOINTS], opened)
        chunk = self._chunk(actions, scene.step, waits)
        chunk[:, stays, :ARM_JOINTS] = targets.last[stays]
        chunk[:, waits, ARM_JOINTS] = np.where(opened, 1.0, -1.0)[waits]
        # Who goes carries its chunk out. Cut short each time another looks again, it would never come to open
        # a gripper: in the pictures alone nothing tells how long it has been where it opens.
        return chunk[:WAIT_STEPS] if waits.any() and stays.all() else chunk

    def _chunk(self, actions: NDArray[np.float64], now: int, waits: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Predicted actions (S, T, A) -> the commands (K, agents of the view, 8) to execute next.

        In an ensemble (Zhao et al. 2023, temporal ensembling) those predicted earlier for the same control
        steps count too. What was predicted before somebody had to wait is about other steps.
        """
        steps, decay = self._config.acting.action_steps, self._config.acting.ensemble
        if decay is None:
            return self._commands(actions[:, :steps])
        recent = self._recent
        known = [] if waits.any() else [(at, of) for at, of in recent.predicted if at + len(of) > now]
        recent.predicted = [*known, (now, self._commands(actions))]
        rows = []
        for step in range(now, now + steps):
            same = np.stack([of[step - at] for at, of in recent.predicted if step - at < len(of)])
            rows.append(np.average(same, axis=0, weights=np.exp(-decay * np.arange(len(same)))))
        chunk = np.stack(rows)
        if self._config.binary_grippers:  # a mean of the two is neither
            chunk[..., ARM_JOINTS] = np.where(chunk[..., ARM_JOINTS] > 0, 1.0, -1.0)
        return chunk

    def _commands(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Predicted actions (S, T, A) -> commands (T, agents of the view, 8)."""
        if self._config.task_space_actions:
            streams = zip(self.view.streams, actions, strict=True)
            return np.concatenate(
                [joint_actions(self.spec, stream, rows) for stream, rows in streams], axis=1
            )
        return actions.transpose(1, 0, 2).reshape(actions.shape[1], -1, ACTION_SIZE).copy()

    def _goes_nowhere(
        self, actions: NDArray[np.float64], joints: NDArray[np.float64], opened: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """(agents of the view,) whose predicted actions (S, T, A) all stay near their joints and gripper.

        A prediction is some millimetres off. From where an arm stands still that would be a slow drift to
        where no demonstration has been.
        """
        told = actions[..., : self.view.action_size].transpose(1, 0, 2)
        told = told.reshape(len(told), -1, ACTION_SIZE)  # (T, agents, 8)
        near = np.abs(told[..., :ARM_JOINTS] - joints).max(axis=(0, 2)) < self._config.acting.deadband_rad
        return near & ((told[..., ARM_JOINTS] > 0) == opened).all(axis=0)

    def _picture(self, pictures: Mapping[str, NDArray[np.uint8]], stream: Stream) -> NDArray[np.uint8]:
        expected = (self._config.height, self._config.width, 3)
        for camera in stream.cameras:
            if pictures[camera].shape != expected:
                raise StageError(
                    f"camera {camera!r} gives pictures {pictures[camera].shape}; "
                    f"policy {self.view.name!r} was trained on {expected}"
                )
        return side_by_side([pictures[camera] for camera in stream.cameras])


def load_runners(
    folder: Path, device: str = "auto", acting: PolicyConfig | None = None
) -> tuple[DiffusionRunner, ...]:
    """The runners of an architecture: one for each policy in a subfolder of `folder`, see `load_policy`."""
    found = sorted(path.parent for path in folder.glob(f"*/{MODEL}"))
    if not found:
        raise StageError(f"no trained policies in {folder}; train them first (stages=[train])")
    return tuple(DiffusionRunner(*load_policy(path, device, acting)) for path in found)


def _generator(seed: int, agent: int) -> torch.Generator:
    """On the CPU, so that the noise does not depend on the device."""
    state = np.random.SeedSequence([seed, agent]).generate_state(1)[0]
    return torch.Generator().manual_seed(int(state))
