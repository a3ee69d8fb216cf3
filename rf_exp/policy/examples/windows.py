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
from rf_exp.policy.examples.keypoints import keypoints, shape_of_hand
from rf_exp.policy.examples.starts import Starts
from rf_exp.policy.inputs.coordination import hesitates, may_go, numbered, phases
from rf_exp.policy.inputs.observation_spec import (
    POSE,
    ObservationSpec,
    context,
    flat_pose,
    of_agent,
    others,
    proprioception,
    remembered,
    spec_of,
    widths,
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
from rf_exp.policy.inputs.rows import executed, meant, measured
from rf_exp.policy.inputs.task_space import task_space_actions
from rf_exp.policy.inputs.view import ACTION_SIZE, PROPRIO_SIZE, View
from rf_exp.transforms import from_quaternion
from rf_exp.types import ARM_JOINTS, gripper_of

if TYPE_CHECKING:
    from rf_exp.store import Store

LOOK_AT = 256  # pictures encoded at a time
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
    poses = [of_agent(context[..., -1:, :], agent)[0] for agent in range(newest.shape[-2])]
    return torch.cat([joints, *poses], dim=-1)


def shown(store: "Store") -> NDArray[np.bool_]:
    """(T,) the steps to learn from: those of the expert, without those of a policy that acted before it."""
    said = np.asarray((store.subgoal >= 0).all(axis=1))
    return said if said.any() else ~said  # older stores have no subgoals


def by_episode(store: "Store") -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """Measured joints, intended and executed commands of each episode."""
    arrays = measured(store), meant(store), executed(store)
    return zip(*(store.by_episode(each) for each in arrays), strict=True)


def _told_and_sent(
    store: "Store", view: View, row: int, config: PolicyConfig, spec: ObservationSpec, memory: NDArray
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Context (T, C) and actions (T, A) of a stream in each episode, for the base poses of that episode."""
    stream, bases = view.streams[row], [spec.world_from_base] * len(store)
    if config.encoder.keypoints:  # which uses the calibration of each episode
        bases = [each.world_from_base for each in calibrations(store, stream.cameras)]
    poses = (from_quaternion(store.poses[name][:]) for name in spec.objects)
    arrays = map(store.by_episode, (measured(store), meant(store), memory, *poses))
    for stands, qpos, action, remembers, *things in zip(bases, *arrays, strict=True):
        seen = dict(zip(spec.objects, things, strict=True))
        own = action[:, np.array(stream.agents) - 1]
        sent = own.reshape(len(own), -1)
        if config.task_space_actions:
            sent = task_space_actions(spec, stands, stream, own)
        yield context(spec, view, row, qpos, seen, remembers, stands), sent


class _Meant:
    """The steps in which an agent does not hesitate, see `hesitates`."""

    def __init__(self, hesitates: NDArray[np.bool_]) -> None:
        self._steps = np.flatnonzero(~hesitates)
        self._next = np.searchsorted(self._steps, np.arange(len(hesitates)))  # that step or the next

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
    headings: Tensor  # (B, M, HEADING)
    doing: Tensor  # (B, N) subgoals of the other agents


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
    # (B, O, n, 3 * P + HEADING) offsets of points (m) and headings of the own grippers from the pictures.
    hands: Tensor | None = None

    def __len__(self) -> int:
        return len(self.frames)


class Windows:
    """All windows of all streams of a view, on one device. Index w is the window at frame w."""

    def __init__(self, store: "Store", view: View, config: PolicyConfig, device: torch.device) -> None:
        """Raises ArgumentError when the store lacks what the view shows, or has another picture size."""
        self._config, self._device = config, device
        if len(store) == 0:
            raise ArgumentError("the store holds no episode; expected at least one to train on")
        kept, ends = slice(None), store.episode_ends  # a slice copies no pictures
        if not (chosen := shown(store)).all():
            kept, ends = chosen, np.cumsum(chosen)[ends - 1]
        lengths = np.diff(ends, prepend=0)
        starts = ends - lengths
        offsets = np.arange(len(view.streams))[:, None] * ends[-1]
        self._spans = np.stack([(offsets + starts).ravel(), (offsets + ends).ravel()], axis=1)  # (S * E, 2)
        repeats = np.tile(lengths, len(view.streams))
        self._first = np.repeat(self._spans[:, 0], repeats)  # of the episode of each window
        self._last = np.repeat(self._spans[:, 1] - 1, repeats)
        spec = self.spec = spec_of(config, store, view)
        # A policy without subgoals may learn from a store without them.
        numbers = numbered(store)[0] if spec.subgoals else store.subgoal[:].astype(np.int64)
        free = np.concatenate([may_go(*each) for each in by_episode(store)])
        columns = [np.array(stream.agents) - 1 for stream in view.streams]

        def stacked(arrays: Sequence[NDArray]) -> Tensor:
            """Concatenate over streams; a single array is not copied, which matters for pictures."""
            return torch.from_numpy(np.concatenate(arrays) if len(arrays) > 1 else arrays[0]).to(device)

        qpos, action = measured(store)[kept], meant(store)[kept]
        self.proprio = stacked([proprioception(qpos[:, agents]) for agents in columns])  # raw (S * T, P)
        memory = np.zeros((store.steps, store.agents, 0), np.float32)  # of grippers, then of subgoals
        if spec.bases:
            told_and_done = gripper_of(store.action), widths(store.qpos)
            episodes = zip(*map(store.by_episode, told_and_done), strict=True)
            memory = np.concatenate([remembered(*each) for each in episodes])
        if spec.subgoals:
            memory = np.concatenate([memory, phases(numbers, free, spec.subgoals)], axis=-1)
        known, commands = [], []
        for row in range(len(columns)):
            told, sent = zip(*_told_and_sent(store, view, row, config, spec, memory), strict=True)
            known.append(np.concatenate(told)[kept])
            commands.append(np.concatenate(sent)[kept])
        self.context = stacked(known)  # raw (S * T, C)
        self.action = stacked(commands)  # raw (S * T, A)

        self._pictures = torch.empty((0, 0, 0, 3), dtype=torch.uint8, device=device)  # (S * T, H, W, 3)
        if config.encoder.pictures:
            cameras = [stream.cameras for stream in view.streams]
            taken = ([pictures_of(store, each, config)[kept] for each in names] for names in cameras)
            self._pictures = stacked([side_by_side(each) for each in taken])
        # As in `Keypoints`; (S * T, N) the subgoals of the other agents; (S, K, 3, 4) rays of the cameras
        # as usually mounted.
        nothing = torch.empty(len(view.streams) * len(action), 0, device=device)
        self.pixels = self.points = self.headings = self.rays = self.doing = self.usual_rays = nothing
        if config.encoder.keypoints:
            found = [keypoints(store, stream, spec, kept) for stream in view.streams]
            arrays = map(stacked, zip(*found, strict=True))
            self.pixels, self.points, self.headings, self.rays = arrays
            watched = [np.array(others(spec, stream), int) - 1 for stream in view.streams]
            self.doing = stacked([numbers[kept][:, agents] for agents in watched])
            usual = [rays_of(usual_calibration(store, each.cameras), each) for each in view.streams]
            self.usual_rays = torch.from_numpy(np.stack(usual)).to(device)
        # Windows in which an own agent may go on.
        self.active = np.flatnonzero(np.concatenate([free[kept][:, each].any(axis=1) for each in columns]))
        late = np.concatenate([hesitates(*each[1:]) for each in by_episode(store)])[kept]
        stays = (np.concatenate([late[:, row] for row in rows]) for rows in zip(*columns, strict=True))
        self._meant = [*map(_Meant, stays)]  # for each agent of a stream
        self._starts = Starts(store, view, spec, kept) if config.start_offset_rad else None
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
        found = [self.action[self._index(steps)] for steps in self._ahead(windows)]
        if len(found) == 1:
            return found[0]
        commands = len(found) * ACTION_SIZE
        parts = [each.tensor_split([commands], dim=2) for each in found]  # TCP poses behind them
        joined = []
        for part in zip(*parts, strict=True):
            joined += [each.chunk(len(found), dim=2)[row] for row, each in enumerate(part)]
        return torch.cat(joined, dim=2)

    def _ahead(self, windows: Indices) -> list[Indices]:
        """For each own agent, the steps (B, T) of the actions of windows (B,)."""
        first, last = self._first[windows, None], self._last[windows, None]
        ahead = windows[:, None] + np.arange(self._config.horizon) - (self._config.observation_steps - 1)
        return [each.rows(ahead, first, last) for each in self._meant]

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
        behind = np.arange(config.observation_steps) - (config.observation_steps - 1)
        frames = np.maximum(windows[:, None] + behind, first[:, None])
        breaks = (np.diff(windows, prepend=windows[0]) != 1) | (np.diff(first, prepend=first[0]) != 0)
        run = np.cumsum(breaks)
        keys, inverse = np.unique(run[:, None] * len(self) + frames, return_inverse=True)
        run_of_frame, unique = np.divmod(keys, len(self))
        seen, rays, features = self._pictures, self.rays[:0], None
        if self._features is not None:
            seen, features = seen[:0], self._features[self._index(frames)]
        elif len(seen):
            rays = self.rays[self._index(unique)]
            whole, size = seen.shape[1:3], config.cropped(*seen.shape[1:3])
            slack = np.array(whole, np.int64) - np.array(size, np.int64)
            corners = slack // 2 + np.zeros((run[-1] + 1, 2), dtype=np.int64)
            if rng is not None:
                corners = rng.integers(0, slack + 1, size=corners.shape)
            seen = crop(seen, unique, corners[run_of_frame], size)
        chosen, places = self._index(frames), self._index(inverse.reshape(frames.shape))
        told = self.proprio[chosen], self.context[chosen], self._actions(windows)
        batch = Batch(seen, rays, places, *told, features)
        if self._starts is None or rng is None:
            return batch
        return self._started(self._starts, batch, frames, windows, rng)

    def _started(
        self, starts: Starts, batch: Batch, frames: Indices, windows: Indices, rng: np.random.Generator
    ) -> Batch:
        """The batch with start offsets, one draw for each window and own agent."""
        agents = len(self._meant)
        proprio, context, action = batch.proprio.clone(), batch.context.clone(), batch.action.clone()
        hands = []
        for row, ahead in enumerate(self._ahead(windows)):
            offset = self._config.start_offset_rad * rng.standard_normal((len(windows), ARM_JOINTS))
            own = proprio[..., row * PROPRIO_SIZE :][..., :ARM_JOINTS]
            joints = own.double().cpu().numpy()
            _, seen = starts.moved(joints, frames, 0 * offset, row)
            joints, pose = starts.moved(joints, frames, offset, row)
            own.copy_(torch.from_numpy(joints))
            of_agent(context, row)[0].copy_(torch.from_numpy(flat_pose(pose)))
            hands.append(torch.from_numpy(shape_of_hand(pose) - shape_of_hand(seen)).to(proprio))
            own = action[..., row * ACTION_SIZE :][..., :ARM_JOINTS]
            joints, pose = starts.moved(own.double().cpu().numpy(), ahead, offset, row)
            own.copy_(torch.from_numpy(joints))
            if self._config.task_space_actions:
                own = action[..., agents * ACTION_SIZE + row * POSE :][..., :POSE]
                own.copy_(torch.from_numpy(flat_pose(pose)))
        hands = torch.stack(hands, dim=2)
        return replace(batch, proprio=proprio, context=context, action=action, hands=hands)

    def sample_active(
        self, windows: Indices, part: float, rng: np.random.Generator
    ) -> tuple[Indices, Tensor]:
        """Windows (B,), a `part` of them replaced by ones in which an own agent may go on, and weights (B,).

        In a long task an agent waits most of the time. The weights undo the sampling in losses that estimate
        probabilities.
        """
        if not part or not len(self.active):
            return windows, torch.ones(len(windows), device=self._device)
        drawn = rng.choice(self.active, round(part * len(windows)))
        chosen = np.concatenate([drawn, windows[len(drawn) :]])
        part = len(drawn) / len(windows)
        free = np.isin(chosen, self.active)
        weights = 1 / (1 - part + part * free * len(self) / len(self.active))
        return chosen, torch.from_numpy(weights.astype(np.float32)).to(self._device)

    def labelled(
        self, windows: Indices, shift_px: int = 0, rng: np.random.Generator | None = None
    ) -> tuple[Tensor, Tensor, Labels]:
        """The newest pictures (B, H, W, 3) of windows, the rays of their cameras, and their labels.

        With `rng` each picture is shifted by up to `shift_px` pixels either way, and its keypoints with it.
        """
        chosen = self._index(windows)
        pictures, pixels, rays = self._pictures[chosen], self.pixels[chosen], self.rays[chosen]
        if rng is not None and shift_px:
            height, width = pictures.shape[1:3]
            shifts = rng.integers(-shift_px, shift_px + 1, (len(windows), 2))  # down, to the right
            whole = with_margin(pictures, shift_px)
            pictures = crop(whole, np.arange(len(windows)), shift_px - shifts, (height, width))
            by = (shifts / (height, width))[:, None, ::-1].astype(np.float32)
            by = torch.from_numpy(by).to(self._device)
            pixels, rays = pixels + by, rays.clone()
            rays[..., 2:3] -= rays[..., :2] @ by[..., None]
        return pictures, rays, Labels(pixels, self.points[chosen], self.headings[chosen], self.doing[chosen])

    def look_once(self, look: Callable[[Tensor, Tensor], tuple[Tensor, Any]]) -> Tensor:
        """Encode all pictures, and use these features (S * T, F), which are returned, from now on."""
        with torch.no_grad():
            parts = zip(self._pictures.split(LOOK_AT), self.rays.split(LOOK_AT), strict=True)
            self._features = torch.cat([look(*each)[0] for each in parts])
        return self._features

    def _index(self, values: Indices) -> Tensor:
        return torch.from_numpy(values).to(self._device)
