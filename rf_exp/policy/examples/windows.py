"""Windows of a store as training batches; every picture is in memory once and encoded once per batch.

Arrays cover all streams of a view: S streams over T frames are S * T rows, one stream after the other.

A window at time t holds `observation_steps` frames t - O + 1 .. t and `horizon` actions from the oldest
of these frames on (Chi et al. 2023). Frames before an episode's start repeat its first, actions beyond
either end repeat the nearest. Batches consist of runs of consecutive windows, so that most frames of a
batch serve several windows; still each window comes exactly once in an epoch.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from rf_exp.errors import ArgumentError
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.examples.keypoints import gripper_shape, keypoints
from rf_exp.policy.examples.starts import StartOffsets
from rf_exp.policy.inputs.coordination import held_up_mask, may_go_on_mask, numbered_subgoals, phase_vectors
from rf_exp.policy.inputs.observation_spec import (
    POSE_SIZE,
    ObservationSpec,
    context,
    finger_openings,
    flat_pose,
    gripper_histories,
    other_agents,
    own_tcp_and_changes,
    proprioception,
    spec_of,
)
from rf_exp.policy.inputs.pictures import (
    calibrations,
    crop,
    pictures_of,
    rays_of,
    side_by_side,
    usual_calibration,
    with_margin,
)
from rf_exp.policy.inputs.rows import executed_commands, intended_commands, measured_joints
from rf_exp.policy.inputs.task_space import task_space_actions
from rf_exp.policy.inputs.view import ACTION_SIZE, PROPRIO_SIZE, View
from rf_exp.transforms import from_quaternion
from rf_exp.types import ARM_JOINTS, gripper_of

if TYPE_CHECKING:
    from rf_exp.store import Store

ENCODED_AT_ONCE = 256  # pictures encoded at a time
Indices = NDArray[np.int64]


def action_origin(proprio: Tensor, context: Tensor | None = None) -> Tensor:
    """Origin of relative actions: raw proprioception (..., O, 8N) -> (..., 1, 8N).

    The newest measured joint positions, and zero for the grippers, whose commands are no positions. With a
    context, the poses of the own TCPs follow behind them: (..., 1, 8N + 9N).
    """
    newest = proprio[..., -1:, :].unflatten(-1, (-1, PROPRIO_SIZE))
    joints = functional.pad(newest[..., :ARM_JOINTS], (0, ACTION_SIZE - ARM_JOINTS)).flatten(-2)
    if context is None:
        return joints
    poses = [own_tcp_and_changes(context[..., -1:, :], agent)[0] for agent in range(newest.shape[-2])]
    return torch.cat([joints, *poses], dim=-1)


def expert_steps(store: "Store") -> NDArray[np.bool_]:
    """(T,) the steps to learn from: those of the expert, without those of a policy that acted before it."""
    from_expert = np.asarray((store.subgoal >= 0).all(axis=1))
    return from_expert if from_expert.any() else ~from_expert  # older stores have no subgoals


def joints_and_commands(store: "Store") -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """Measured joints, intended and executed commands of each episode."""
    arrays = measured_joints(store), intended_commands(store), executed_commands(store)
    return zip(*(store.by_episode(array) for array in arrays), strict=True)


def _contexts_and_actions(
    store: "Store", view: View, row: int, config: PolicyConfig, spec: ObservationSpec, history: NDArray
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Context (T, C) and actions (T, A) of a stream in each episode, for the base poses of that episode."""
    stream, bases = view.streams[row], [spec.world_from_base] * len(store)
    if config.encoder.keypoints:  # which uses the calibration of each episode
        bases = [calibration.world_from_base for calibration in calibrations(store, stream.cameras)]
    poses = (from_quaternion(store.poses[name][:]) for name in spec.objects)
    arrays = map(store.by_episode, (measured_joints(store), intended_commands(store), history, *poses))
    for world_from_base, qpos, action, episode_history, *object_poses in zip(bases, *arrays, strict=True):
        poses_by_name = dict(zip(spec.objects, object_poses, strict=True))
        commands = action[:, np.array(stream.agents) - 1]
        actions = commands.reshape(len(commands), -1)
        if config.task_space_actions:
            actions = task_space_actions(spec, world_from_base, stream, commands)
        yield context(spec, view, row, qpos, poses_by_name, episode_history, world_from_base), actions


class _StepsNotHeldUp:
    """The steps in which an agent is not held up, see `held_up_mask`."""

    def __init__(self, held_up: NDArray[np.bool_]) -> None:
        self._steps = np.flatnonzero(~held_up)
        self._next = np.searchsorted(self._steps, np.arange(len(held_up)))  # that step or the next

    def rows(self, ahead: Indices, first: Indices, last: Indices) -> Indices:
        """(B, T) consecutive steps from `ahead[:, 0]` on, in episodes from `first` (B, 1) to `last`."""
        start = np.clip(ahead[:, :1], first, last)
        at = self._next[start] + ahead - start
        return self._steps[np.clip(at, self._next[first], self._next[last])]


def largest_change(action: Tensor, within: Tensor) -> Tensor:
    """(A,) largest change between consecutive actions (K, A), of pairs `within` (K - 1,) an episode."""
    change = action.diff(dim=0).abs()[within]
    return change.amax(dim=0) if len(change) else torch.zeros_like(action[0])


@dataclass(frozen=True)
class Labels:
    """Labels of B pictures; NaN where a keypoint is not in view, or is past."""

    pixels: Tensor  # (B, M * P, 2) of keypoints, from 0 to 1
    points: Tensor  # (B, M * P, 3) m
    headings: Tensor  # (B, M, HEADING_SIZE)
    other_subgoals: Tensor  # (B, N) subgoals of the other agents


@dataclass(frozen=True)
class Batch:
    """B windows of U different frames."""

    pictures: Tensor  # (U, h, w, 3) uint8, cropped; without pictures (0, ...)
    rays: Tensor  # (U, K, 3, 4) of their cameras, see `rays_of`; without pictures (0, ...)
    frames: Tensor  # (B, O) int64 index into `pictures`
    proprio: Tensor  # (B, O, P) raw
    context: Tensor  # (B, O, C) raw
    action: Tensor  # (B, T, A) raw
    features: Tensor | None = None  # (B, O, F) of the pictures, if they are encoded already
    gripper_offsets: Tensor | None = None
    # (B, O, n, 3 * P + HEADING_SIZE) offsets of points (m) and headings of the own grippers from those shown
    # in the pictures.

    def __len__(self) -> int:
        return len(self.frames)


class Windows:
    """All windows of all streams of a view, on one device. Index w is the window at frame w."""

    def __init__(self, store: "Store", view: View, config: PolicyConfig, device: torch.device) -> None:
        """Raises ArgumentError when the store lacks what the view shows, or has another picture size."""
        self._config, self._device = config, device
        if len(store) == 0:
            raise ArgumentError("the store holds no episode; expected at least one to train on")
        selection, ends = slice(None), store.episode_ends  # a slice copies no pictures
        if not (from_expert := expert_steps(store)).all():
            selection, ends = from_expert, np.cumsum(from_expert)[ends - 1]
        lengths = np.diff(ends, prepend=0)
        starts = ends - lengths
        offsets = np.arange(len(view.streams))[:, None] * ends[-1]
        self._spans = np.stack([(offsets + starts).ravel(), (offsets + ends).ravel()], axis=1)  # (S * E, 2)
        repeats = np.tile(lengths, len(view.streams))
        self._first = np.repeat(self._spans[:, 0], repeats)  # of the episode of each window
        self._last = np.repeat(self._spans[:, 1] - 1, repeats)
        spec = self.spec = spec_of(config, store, view)
        # A policy without subgoals may learn from a store without them.
        subgoal_numbers = numbered_subgoals(store)[0] if spec.subgoals else store.subgoal[:].astype(np.int64)
        may_go_on = np.concatenate([may_go_on_mask(*each) for each in joints_and_commands(store)])
        columns = [np.array(stream.agents) - 1 for stream in view.streams]

        def stacked(arrays: Sequence[NDArray]) -> Tensor:
            """Concatenate over streams; a single array is not copied, which matters for pictures."""
            return torch.from_numpy(np.concatenate(arrays) if len(arrays) > 1 else arrays[0]).to(device)

        qpos, action = measured_joints(store)[selection], intended_commands(store)[selection]
        self.proprio = stacked([proprioception(qpos[:, agents]) for agents in columns])  # raw (S * T, P)
        history = np.zeros((store.steps, store.agents, 0), np.float32)  # of grippers, then of subgoals
        if spec.bases:
            commands_and_openings = gripper_of(store.action), finger_openings(store.qpos)
            episodes = zip(*map(store.by_episode, commands_and_openings), strict=True)
            history = np.concatenate([gripper_histories(*each) for each in episodes])
        if spec.subgoals:
            history = np.concatenate(
                [history, phase_vectors(subgoal_numbers, may_go_on, spec.subgoals)], axis=-1
            )
        contexts, actions = [], []
        for row in range(len(columns)):
            stream_contexts, stream_actions = zip(
                *_contexts_and_actions(store, view, row, config, spec, history), strict=True
            )
            contexts.append(np.concatenate(stream_contexts)[selection])
            actions.append(np.concatenate(stream_actions)[selection])
        self.context = stacked(contexts)  # raw (S * T, C)
        self.action = stacked(actions)  # raw (S * T, A)

        self._pictures = torch.empty((0, 0, 0, 3), dtype=torch.uint8, device=device)  # (S * T, H, W, 3)
        if config.encoder.pictures:
            cameras = [stream.cameras for stream in view.streams]
            pictures = ([pictures_of(store, each, config)[selection] for each in names] for names in cameras)
            self._pictures = stacked([side_by_side(each) for each in pictures])
        # As in `Keypoints`; (S * T, N) the subgoals of the other agents; (S, K, 3, 4) rays of the cameras
        # as usually mounted.
        empty = torch.empty(len(view.streams) * len(action), 0, device=device)
        self.pixels = self.points = self.headings = self.rays = self.other_subgoals = self.usual_rays = empty
        if config.encoder.keypoints:
            stream_keypoints = [keypoints(store, stream, spec, selection) for stream in view.streams]
            arrays = map(stacked, zip(*stream_keypoints, strict=True))
            self.pixels, self.points, self.headings, self.rays = arrays
            observed_agents = [np.array(other_agents(spec, stream), int) - 1 for stream in view.streams]
            self.other_subgoals = stacked(
                [subgoal_numbers[selection][:, agents] for agents in observed_agents]
            )
            usual_rays = [rays_of(usual_calibration(store, each.cameras), each) for each in view.streams]
            self.usual_rays = torch.from_numpy(np.stack(usual_rays)).to(device)
        # Windows in which an own agent may go on.
        self.active = np.flatnonzero(
            np.concatenate([may_go_on[selection][:, each].any(axis=1) for each in columns])
        )
        held_up = np.concatenate([held_up_mask(*each[1:]) for each in joints_and_commands(store)])[selection]
        held_up_by_agent = (
            np.concatenate([held_up[:, row] for row in rows]) for rows in zip(*columns, strict=True)
        )
        self._steps_not_held_up = [*map(_StepsNotHeldUp, held_up_by_agent)]  # for each agent of a stream
        self._start_offsets = StartOffsets(store, view, spec, selection) if config.start_offset_rad else None
        self._features: Tensor | None = None  # (S * T, F) of all frames, once the encoder is frozen

    def __len__(self) -> int:
        return len(self._first)

    def fastest(self) -> Tensor:
        """(A,) the largest change of each action between two control steps of a demonstration."""
        within = torch.from_numpy(self._first[1:] == self._first[:-1]).to(self._device)
        return largest_change(self.action, within)

    def learned_actions(self) -> Tensor:
        """All actions that a policy may have to predict (K, A)."""
        if not self._config.relative_actions:
            return self.action
        actions = self._actions(np.arange(len(self)))
        context = self.context[:, None] if self._config.task_space_actions else None
        origin = action_origin(self.proprio[:, None], context)
        return (actions - origin).flatten(0, 1)

    def _actions(self, windows: Indices) -> Tensor:
        """Actions (B, T, A) of windows (B,), for each agent without its hesitations."""
        by_agent = [self.action[self._index(steps)] for steps in self._action_steps(windows)]
        if len(by_agent) == 1:
            return by_agent[0]
        commands = len(by_agent) * ACTION_SIZE
        parts = [actions.tensor_split([commands], dim=2) for actions in by_agent]  # TCP poses behind them
        columns = []
        for part in zip(*parts, strict=True):
            columns += [actions.chunk(len(by_agent), dim=2)[row] for row, actions in enumerate(part)]
        return torch.cat(columns, dim=2)

    def _action_steps(self, windows: Indices) -> list[Indices]:
        """For each own agent, the steps (B, T) of the actions of windows (B,)."""
        first, last = self._first[windows, None], self._last[windows, None]
        steps = windows[:, None] + np.arange(self._config.horizon) - (self._config.observation_steps - 1)
        return [not_held_up.rows(steps, first, last) for not_held_up in self._steps_not_held_up]

    def batches(self, batch_size: int) -> int:
        """Number of batches of an epoch."""
        return -(-len(self) // batch_size)

    def epoch(self, batch_size: int, run_length: int, rng: np.random.Generator) -> list[Indices]:
        """Window indices of each batch of an epoch: shuffled runs; sizes differ by at most one."""
        runs: list[Indices] = []
        for start, end in self._spans:  # cut at a random phase
            cuts = np.arange(start + rng.integers(1, run_length + 1), end, run_length)
            runs += np.split(np.arange(start, end), cuts - start)
        order = np.concatenate([runs[k] for k in rng.permutation(len(runs))])
        return np.array_split(order, self.batches(batch_size))

    def batch(self, windows: Indices, rng: np.random.Generator | None) -> Batch:
        """The batch of window indices (B,). With `rng` every run has a random crop, else the centre crop.

        Frames of one run share a crop, so that what moves between them has moved in the scene.
        """
        config = self._config
        first = self._first[windows]
        offsets = np.arange(config.observation_steps) - (config.observation_steps - 1)
        frames = np.maximum(windows[:, None] + offsets, first[:, None])
        breaks = (np.diff(windows, prepend=windows[0]) != 1) | (np.diff(first, prepend=first[0]) != 0)
        run = np.cumsum(breaks)
        keys, inverse = np.unique(run[:, None] * len(self) + frames, return_inverse=True)
        run_of_frame, unique = np.divmod(keys, len(self))
        pictures, rays, features = self._pictures, self.rays[:0], None
        if self._features is not None:
            pictures, features = pictures[:0], self._features[self._index(frames)]
        elif len(pictures):
            rays = self.rays[self._index(unique)]
            full_size, size = pictures.shape[1:3], config.cropped(*pictures.shape[1:3])
            slack = np.array(full_size, np.int64) - np.array(size, np.int64)
            corners = slack // 2 + np.zeros((run[-1] + 1, 2), dtype=np.int64)
            if rng is not None:
                corners = rng.integers(0, slack + 1, size=corners.shape)
            pictures = crop(pictures, unique, corners[run_of_frame], size)
        rows, frame_index = self._index(frames), self._index(inverse.reshape(frames.shape))
        arrays = self.proprio[rows], self.context[rows], self._actions(windows)
        batch = Batch(pictures, rays, frame_index, *arrays, features)
        if self._start_offsets is None or rng is None:
            return batch
        return self._with_start_offsets(self._start_offsets, batch, frames, windows, rng)

    def _with_start_offsets(
        self,
        start_offsets: StartOffsets,
        batch: Batch,
        frames: Indices,
        windows: Indices,
        rng: np.random.Generator,
    ) -> Batch:
        """The batch with start offsets, one draw for each window and own agent."""
        agents = len(self._steps_not_held_up)
        proprio, context, action = batch.proprio.clone(), batch.context.clone(), batch.action.clone()
        gripper_offsets = []
        for row, steps in enumerate(self._action_steps(windows)):
            offset = self._config.start_offset_rad * rng.standard_normal((len(windows), ARM_JOINTS))
            own = proprio[..., row * PROPRIO_SIZE :][..., :ARM_JOINTS]
            joints = own.double().cpu().numpy()
            _, original_pose = start_offsets.shifted(joints, frames, 0 * offset, row)
            joints, pose = start_offsets.shifted(joints, frames, offset, row)
            own.copy_(torch.from_numpy(joints))
            own_tcp_and_changes(context, row)[0].copy_(torch.from_numpy(flat_pose(pose)))
            gripper_offsets.append(
                torch.from_numpy(gripper_shape(pose) - gripper_shape(original_pose)).to(proprio)
            )
            own = action[..., row * ACTION_SIZE :][..., :ARM_JOINTS]
            joints, pose = start_offsets.shifted(own.double().cpu().numpy(), steps, offset, row)
            own.copy_(torch.from_numpy(joints))
            if self._config.task_space_actions:
                own = action[..., agents * ACTION_SIZE + row * POSE_SIZE :][..., :POSE_SIZE]
                own.copy_(torch.from_numpy(flat_pose(pose)))
        gripper_offsets = torch.stack(gripper_offsets, dim=2)
        return replace(
            batch, proprio=proprio, context=context, action=action, gripper_offsets=gripper_offsets
        )

    def sample_active(
        self, windows: Indices, fraction: float, rng: np.random.Generator
    ) -> tuple[Indices, Tensor]:
        """Windows (B,), a fraction of them replaced by ones where an own agent may go on, and weights (B,).

        In a long task an agent waits most of the time. The weights undo the sampling in losses that estimate
        probabilities.
        """
        if not fraction or not len(self.active):
            return windows, torch.ones(len(windows), device=self._device)
        drawn = rng.choice(self.active, round(fraction * len(windows)))
        chosen = np.concatenate([drawn, windows[len(drawn) :]])
        fraction = len(drawn) / len(windows)
        may_go_on = np.isin(chosen, self.active)
        weights = 1 / (1 - fraction + fraction * may_go_on * len(self) / len(self.active))
        return chosen, torch.from_numpy(weights.astype(np.float32)).to(self._device)

    def labelled(
        self, windows: Indices, shift_px: int = 0, rng: np.random.Generator | None = None
    ) -> tuple[Tensor, Tensor, Labels]:
        """The newest pictures (B, H, W, 3) of windows, the rays of their cameras, and their labels.

        With `rng` each picture is shifted by up to `shift_px` pixels either way, and its keypoints with it.
        """
        rows = self._index(windows)
        pictures, pixels, rays = self._pictures[rows], self.pixels[rows], self.rays[rows]
        if rng is not None and shift_px:
            height, width = pictures.shape[1:3]
            shifts = rng.integers(-shift_px, shift_px + 1, (len(windows), 2))  # down, to the right
            padded = with_margin(pictures, shift_px)
            pictures = crop(padded, np.arange(len(windows)), shift_px - shifts, (height, width))
            shift = (shifts / (height, width))[:, None, ::-1].astype(np.float32)
            shift = torch.from_numpy(shift).to(self._device)
            pixels, rays = pixels + shift, rays.clone()
            rays[..., 2:3] -= rays[..., :2] @ shift[..., None]
        return (
            pictures,
            rays,
            Labels(pixels, self.points[rows], self.headings[rows], self.other_subgoals[rows]),
        )

    def encode_once(self, encode: Callable[[Tensor, Tensor], tuple[Tensor, Any]]) -> Tensor:
        """Encode all pictures, and use these features (S * T, F), which are returned, from now on."""
        with torch.no_grad():
            parts = zip(self._pictures.split(ENCODED_AT_ONCE), self.rays.split(ENCODED_AT_ONCE), strict=True)
            self._features = torch.cat([encode(*part)[0] for part in parts])
        return self._features

    def _index(self, values: Indices) -> Tensor:
        return torch.from_numpy(values).to(self._device)
