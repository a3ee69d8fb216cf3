"""Diffusion runner: a trained policy of this suite that acts through the streams of its view."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rf_exp.errors import StageError
from rf_exp.observations import Coordination, Declaration, Observation
from rf_exp.policy.acting.rollouts import PolicyRunner
from rf_exp.policy.acting.search import Search
from rf_exp.policy.acting.self_calibration import CameraEstimate, camera_estimates
from rf_exp.policy.acting.shield import Decision
from rf_exp.policy.config import PolicyConfig
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS
from rf_exp.policy.inputs.coordination import phase_vectors
from rf_exp.policy.inputs.observation_spec import (
    EMPTY_OPENING_M,
    MOST_CHANGES,
    GripperHistory,
    ObservationSpec,
    context,
    finger_openings,
    footprint,
    footprint_from_tcps,
    other_agents,
    own_tcp_and_changes,
    proprioception,
)
from rf_exp.policy.inputs.pictures import rays_of, side_by_side
from rf_exp.policy.inputs.task_space import joint_actions, nearest_postures
from rf_exp.policy.inputs.view import ACTION_SIZE, View
from rf_exp.policy.learning.checkpoint import MODEL, load_policy
from rf_exp.policy.networks.policy import Policy
from rf_exp.robots import Arm
from rf_exp.transforms import Matrix, transform_by_poses
from rf_exp.types import ARM_JOINTS, KeypointDetection

SETTLE_STEPS = 2  # steps until an arm has settled at its target
WAIT_STEPS = 4  # executed steps of a chunk in which every agent waits; then the policy predicts again
# A press has failed if the TCP has moved by less than STILL_M since the last prediction, near the goal; it is
# blocked if it is short of its command by BLOCKED_M. Then the fingers are lifted by LIFT_M and moved above
# the next goal, LIFT_STEPS each.
STILL_M, NEAR_GOAL_M, BLOCKED_M, LIFT_M, LIFT_STEPS = 0.006, 0.08, 0.002, 0.03, (4, 6)
UNCHANGED_SCENE = 0.03  # predicted probabilities that differ by less are of an unchanged scene


class TransitionIntegrator:
    """Decides which agents go on, by summing the predicted probabilities while the scene does not change.

    Whether an arm may go on is learned from single moments. Where the moments before it leaves look like
    those in which it has to stay (a shutter looks the same after it was pressed, a late arm stands still),
    what is learned is the rate of leaving: a probability below 0.5, the same at every prediction. An arm that
    only left above 0.5 would wait forever. The rate is per control step, and a waiting agent predicts once in
    WAIT_STEPS: at a sum of 1 / WAIT_STEPS, demonstrations would have left once. With a `bound` of 0 every
    prediction is judged on its own.
    """

    def __init__(self, bound: float) -> None:
        self._bound = bound
        self._last = self._sums = np.zeros(())  # (n, K + 1) last, and summed since the scene changed

    def __call__(self, probabilities: NDArray[np.float64]) -> Coordination:
        """From probabilities (n, K + 1) of each of K subgoals and, last, of going on, for each of n agents.

        An agent that goes on because its sum reaches the bound gets the latest subgoal whose probabilities
        add up to at least half of that sum, if this is later than the most likely one.
        """
        changes = np.abs(probabilities - self._last).max(axis=1) > UNCHANGED_SCENE
        self._sums = np.where(changes[:, None], 0, self._sums) + probabilities
        self._last = probabilities
        numbers, may_go_on = probabilities[:, :-1].argmax(axis=1), probabilities[:, -1] > 0.5
        if not self._bound:
            return numbers, may_go_on
        reached = ~may_go_on & (self._sums[:, -1] >= self._bound)
        for agent in np.flatnonzero(reached):
            *subgoal_sums, leaving_sum = self._sums[agent]
            likely_subgoals = np.flatnonzero(np.array(subgoal_sums) >= leaving_sum / 2)
            numbers[agent] = max([numbers[agent], *likely_subgoals])
        return numbers, may_go_on | reached


@dataclass
class _Episode:
    """State of an episode: the last observed frames, and all else that the next prediction depends on."""

    frames: deque[tuple[Tensor, ...]]  # features (S, F), proprioception (S, P) and context (S, C) of each
    transitions: TransitionIntegrator
    generators: list[torch.Generator]  # per stream
    grippers: GripperHistory
    openings: NDArray[np.floating]  # (N,) m, last measured finger openings; NaN where not declared
    cameras: list[tuple[CameraEstimate, ...]]  # per stream; only for uncalibrated cameras
    homing: NDArray[np.bool_]  # (agents of the view,) whether to move to rest before the next observation
    search: Search
    pressing_m: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    # agent -> its TCP (3,) at the last prediction, while its closed fingers press


class DiffusionRunner(PolicyRunner):
    """One policy acting through all streams of its view, batched: each stream is a row.

    Observations are kept encoded, so every picture is encoded at most once, and only pictures that an
    observation will hold are requested. It declares the joints of its own agents, and its cameras; a
    privileged-state policy declares the joints of all agents and the poses of all objects.
    """

    def __init__(self, policy: Policy, view: View, spec: ObservationSpec | None = None) -> None:
        self._policy, self._config, self.spec = policy.eval(), policy.config, spec or ObservationSpec()
        self._device = policy.normaliser.fastest.device
        fastest = policy.normaliser.fastest.cpu().double().numpy()
        fastest = fastest[: view.action_size].reshape(-1, ACTION_SIZE)
        fastest_of_agents = fastest[:, :ARM_JOINTS].max(axis=1)  # (agents of a stream,) rad a control step
        cameras = dict.fromkeys(camera for stream in view.streams for camera in stream.cameras)
        all_agents = tuple(range(1, len(self.spec.bases) + 1))
        declared = Declaration(
            all_agents if self.spec.objects else view.agents,
            objects=self.spec.objects,
            cameras=tuple(cameras) if self._config.encoder.pictures else (),
            coordinated=view.agents if view.coordinated else (),
            calibrated=self._config.encoder.keypoints,
        )
        super().__init__(view, np.tile(fastest_of_agents, len(view.streams)), declared)
        self._rows = np.array(view.agents) - 1  # of the own agents among all
        self._agents = max(declared.agents)  # rows of measured joints; NaN for agents that are not declared
        self._episode = self._begin(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode. All noise of the next comes from its seed and the agents."""
        super().reset(seed)
        self._episode = self._begin(seed)

    def _begin(self, seed: int) -> _Episode:
        frames: deque[tuple[Tensor, ...]] = deque(maxlen=self._config.observation_steps)
        sequences = [np.random.SeedSequence([seed, stream.agents[0]]) for stream in self.view.streams]
        # On the CPU, so that the noise does not depend on the device.
        generators = [torch.Generator().manual_seed(int(each.generate_state(1)[0])) for each in sequences]
        transitions = TransitionIntegrator(self._config.acting.transition_integrator)
        grippers, openings = GripperHistory(self._agents), np.full(self._agents, np.nan)
        size_px, usual_rays = (self._config.width, self._config.height), self._policy.encoder.usual_rays
        cameras = (
            []
            if usual_rays is None
            else [camera_estimates(rays, size_px) for rays in usual_rays.cpu().double().numpy()]
        )
        homing = np.full(len(self.view.agents), self._config.acting.homing)
        search = Search(self._config.acting.regrasp_step_m)
        return _Episode(frames, transitions, generators, grippers, openings, cameras, homing, search)

    # observation

    @property
    def needs_pictures(self) -> bool:
        """Whether the present pictures are part of the observation of the next prediction."""
        return self._config.encoder.pictures and self._observation_due

    @property
    def _observation_due(self) -> bool:
        """Whether this step is part of that observation. After a withheld command any step may have to be."""
        soon_due = self.state.withheld or len(self.state.targets) < self._config.observation_steps
        return soon_due and not self._episode.homing.any()

    @torch.inference_mode()
    def observe(self, observation: Observation) -> None:
        """Keep what the next prediction needs of an observation."""
        episode, qpos = self._episode, np.full((self._agents, ARM_JOINTS + 2), np.nan)
        for agent, joints in observation.qpos.items():
            qpos[agent - 1] = joints
        episode.openings = finger_openings(qpos)
        if self._config.acting.homing and (failed := self._failed_grasps()).any():
            episode.homing |= failed
            for row in range(len(failed)):
                self.state.targets.clear(row)
            # Keyed by the change that closed the fingers, which is counted until they open.
            for row in self._rows[failed].tolist():
                episode.search.failed_grasps[row + 1, int(episode.grippers.changes[row]) - 1] += 1
        if not self._observation_due:
            return
        own = np.stack([qpos[np.array(stream.agents) - 1] for stream in self.view.streams])
        proprio = torch.from_numpy(proprioception(own)).to(self._device)
        history, streams = episode.grippers.vector, range(len(own))
        if self.spec.subgoals:
            history = np.concatenate([history, self._phases(observation)], axis=-1)
        bases = self._bases(observation)
        stream_contexts = [
            context(self.spec, self.view, row, qpos, observation.poses, history, bases) for row in streams
        ]
        contexts = torch.from_numpy(np.stack(stream_contexts)).to(self._device)
        features = self._encode(observation) if self.needs_pictures else proprio.new_zeros(len(own), 0)
        # Before an episode's start its first frame repeats, as in training.
        for _ in range(1 if episode.frames else self._config.observation_steps):
            episode.frames.append((features, proprio, contexts))

    def _phases(self, observation: Observation) -> NDArray[np.float32]:
        """Phases (N, subgoals + 1): from the coordinator, or placeholders until the policy predicts them."""
        numbers, may_go_on = np.zeros(self._agents, int), np.ones(self._agents, bool)
        if self.view.coordinated:
            if observation.subgoals is None:
                name = self.view.name
                raise StageError(f"policy {name!r} was trained with a coordinator; none is running")
            for agent, (number, agent_may_go_on) in observation.subgoals.items():
                numbers[agent - 1], may_go_on[agent - 1] = number, agent_may_go_on
        return phase_vectors(numbers, may_go_on, self.spec.subgoals)

    def _encode(self, observation: Observation) -> Tensor:
        """Features (S, F) of the present pictures; records the keypoints detected in them."""
        pictures, expected = [], (self._config.height, self._config.width, 3)
        for stream in self.view.streams:
            stream_pictures = [observation.pictures[camera] for camera in stream.cameras]
            for camera, picture in zip(stream.cameras, stream_pictures, strict=True):
                if picture.shape != expected:
                    raise StageError(
                        f"camera {camera!r} gives pictures {picture.shape}; "
                        f"policy {self.view.name!r} was trained on {expected}"
                    )
            pictures.append(side_by_side(stream_pictures))
        batch = torch.from_numpy(np.stack(pictures)).to(self._device)
        features, places = self._policy.encode_centre_crops(batch, self._rays(observation))
        if places is None:
            return features
        detected = places.cpu().double().numpy()
        self.state.detections = tuple(self._detections(detected[:, :: len(GRIPPER_POINTS)]))
        if observation.calibration is None:
            self._calibrate(observation, detected)
            features, _ = self._policy.encode_centre_crops(batch, self._rays(observation))
        return features

    def _bases(self, observation: Observation) -> Sequence[Matrix]:
        """Base pose (4, 4) of every arm: calibrated, or else the usual one."""
        calibration = observation.calibration
        return self.spec.world_from_base if calibration is None else calibration.world_from_base

    def _rays(self, observation: Observation) -> Tensor | None:
        """Rays (S, K, 3, 4) of the cameras: calibrated, or else estimated."""
        if self._policy.encoder.usual_rays is None:
            return None
        if (calibration := observation.calibration) is not None:
            rays = [rays_of(calibration, stream) for stream in self.view.streams]
        else:
            rays = [[estimate.rays for estimate in estimates] for estimates in self._episode.cameras]
        return torch.from_numpy(np.array(rays, np.float32)).to(self._device)

    def _calibrate(self, observation: Observation, places: NDArray[np.float64]) -> None:
        """Estimate each camera from detections of the own grippers, in places (S, M, 2) of all points."""
        for stream, stream_places, cameras in zip(
            self.view.streams, places, self._episode.cameras, strict=True
        ):
            joints = np.stack([observation.qpos[agent][:ARM_JOINTS] for agent in stream.agents])
            poses = footprint_from_tcps(self.spec, self.spec.world_from_base, stream, joints)
            points = transform_by_poses(poses, GRIPPER_POINTS).reshape(-1, 3)
            first = (self.spec.keyframes + 1) * len(points)
            for camera, camera_places in zip(cameras, np.split(stream_places, len(cameras)), strict=True):
                camera.add_detections(points, camera_places[first : first + len(points)])

    def _detections(self, places: NDArray[np.float64]) -> Iterator[KeypointDetection]:
        """Keypoints detected at (S, M, 2), but for past gripper changes and the own current TCPs."""
        changes, last = self._episode.grippers.changes, self.spec.keyframes
        for stream, stream_places in zip(self.view.streams, places, strict=True):
            keypoints = []  # per keypoint: agent, whether it is the next one, whether to yield it
            for agent in stream.agents:
                next_change = min(changes[agent - 1], last)
                keypoints += [(agent, key == next_change, key >= next_change) for key in range(last + 1)]
            keypoints += [(agent, False, False) for agent in stream.agents]
            keypoints += [(agent, False, True) for agent in other_agents(self.spec, stream)]
            count = len(stream.cameras)
            for row, picture_places in enumerate(np.split(stream_places, count)):
                for (agent, is_next, is_reported), (x, y) in zip(keypoints, picture_places, strict=True):
                    if is_reported:
                        place = float(count * x - row), float(y)
                        yield KeypointDetection(stream.cameras[row], agent, *place, bool(is_next))

    # prediction

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        """Sample a chunk from the kept observations. Agents that wait or stand still keep their targets."""
        if self._episode.homing.any():
            return self._home()
        frames = zip(*self._episode.frames, strict=True)
        # (S, O, ...), oldest frame first.
        features, proprio, contexts = (torch.stack(each, dim=1) for each in frames)
        contexts, waiting = self._with_predicted_phases(observation, features, proprio, contexts)
        opened = self._episode.grippers.opened[self._rows]
        if waiting.all():
            stay = np.column_stack([self.state.targets.last, np.where(opened, 1.0, -1.0)])
            return np.tile(stay, (WAIT_STEPS, 1, 1))
        directions = self._directions(observation, contexts) if self._config.acting.regrasp_step_m else None
        if directions is not None:
            goals = self._policy.encoder.offsets(features, contexts)[:, -1]
            presses = self._next_presses(observation, waiting, goals.flatten(0, 1), directions.flatten(0, 1))
            if presses is not None:
                return presses
        goal_shift = 0.0 if directions is None else self._shifts_m()[..., None] * directions
        sampled = self._policy.act(features, proprio, contexts, self._episode.generators, goal_shift)
        actions = sampled.cpu().double().numpy()
        if not np.isfinite(actions).all():
            raise StageError(
                f"policy {self.view.name!r}, control step {observation.step}: it predicts actions that are "
                "not finite; its weights are unusable"
            )
        actions = actions[:, self._config.observation_steps - 1 :]  # a chunk starts at the oldest observation
        joints = np.stack([observation.qpos[agent] for agent in self.view.agents])[:, :ARM_JOINTS]
        stationary = waiting | self._within_deadband(actions, joints, opened)
        actions = actions[:, : self._config.acting.action_steps]
        if self._config.task_space_actions:
            streams, bases = zip(self.view.streams, actions, strict=True), self._bases(observation)
            chunk = np.concatenate([joint_actions(self.spec, bases, *each) for each in streams], axis=1)
        else:
            chunk = self._joint_actions(actions).copy()
        chunk[:, stationary, :ARM_JOINTS] = self.state.targets.last[stationary]
        chunk[:, waiting, ARM_JOINTS] = np.where(opened, 1.0, -1.0)[waiting]
        # An agent that goes on executes its whole chunk. Cut short whenever another predicts again, it would
        # never open a gripper: pictures alone do not tell how long it has been where it opens.
        return chunk[:WAIT_STEPS] if waiting.any() and stationary.all() else chunk

    def _shifts_m(self) -> Tensor:
        """Displacements (S, n) of the own goals along camera rays."""
        changes, search = self._episode.grippers.changes, self._episode.search
        shifts = [
            [search.shift_m(agent, int(changes[agent - 1])) for agent in stream.agents]
            for stream in self.view.streams
        ]
        return torch.tensor(shifts, device=self._device)

    def _directions(self, observation: Observation, contexts: Tensor) -> Tensor | None:
        """Directions (S, n, 3) from the cameras to own TCPs, and so to their goals once they are there."""
        if (rays := self._rays(observation)) is None:
            return None
        own = range(len(self.view.streams[0].agents))
        tcps = torch.stack([own_tcp_and_changes(contexts[:, -1], agent)[0][..., :3] for agent in own], dim=1)
        directions = tcps[:, None] - rays[..., 3][:, :, None]  # (S, K, n, 3) from each of K cameras
        return (directions / directions.norm(dim=3, keepdim=True)).mean(dim=1)

    def _next_presses(
        self, observation: Observation, waiting: NDArray[np.bool_], offsets: Tensor, directions: Tensor
    ) -> NDArray[np.float64] | None:
        """Targets (T, agents of the view, 8) from failed presses to above the next ones; None without any.

        Offsets (agents of the view, 3) from TCPs to detected goals, and directions (agents of the view, 3) of
        rays, are in the footprint of the first arm of each stream.
        """
        episode, last, bases = self._episode, self.state.targets.last, self._bases(observation)
        pressing, again = self._closed_on_nothing(meant=True) & ~waiting, False
        first_agents = [stream.agents[0] for stream in self.view.streams for _ in stream.agents]
        grippers = np.where(episode.grippers.opened[self._rows], 1.0, -1.0)
        targets = np.tile(np.column_stack([last, grippers]), (2, 1, 1))
        before_m, episode.pressing_m = episode.pressing_m, {}
        for row in np.flatnonzero(pressing).tolist():
            agent, search = self.view.agents[row], episode.search
            arm, joints = Arm(self.spec.robot(agent), bases[agent - 1]), observation.qpos[agent]
            pose, commanded = arm.tcp(joints), arm.tcp(last[row])
            place_m = episode.pressing_m[agent] = pose[:3, 3]
            offset, direction = (each[row].cpu().double().numpy() for each in (offsets, directions))
            still = agent in before_m and np.linalg.norm(place_m - before_m[agent]) < STILL_M
            if not still or np.linalg.norm(offset) > NEAR_GOAL_M:
                continue
            approach, change = pose[:3, 2], int(episode.grippers.changes[agent - 1])
            blocked = bool(approach @ (commanded[:3, 3] - place_m) > BLOCKED_M)
            if not search.press_failed(agent, change, offset[2], -direction[2], blocked=blocked):
                continue
            to_goal = offset + search.shift_m(agent, change) * direction
            world_from_footprint = footprint(bases[first_agents[row] - 1])
            lifted, above = pose.copy(), pose.copy()
            lifted[:3, 3] -= LIFT_M * approach
            above[:3, 3] += world_from_footprint[:3, :3] @ to_goal - LIFT_M * approach
            near = np.tile(joints[: arm.robot.dof], (2, 1))
            targets[:, row, : arm.robot.dof] = nearest_postures(arm, np.stack([lifted, above]), near)
            del episode.pressing_m[agent]
            again = True
        return np.repeat(targets, LIFT_STEPS, axis=0) if again else None

    def _failed_grasps(self) -> NDArray[np.bool_]:
        """(agents of the view,) whether fingers have closed on nothing, unlike in the demonstrations.

        Seen from there, the gripper hides the missed object, and a wrong detection would repeat.
        """
        return self._closed_on_nothing(meant=False)

    def _closed_on_nothing(self, *, meant: bool) -> NDArray[np.bool_]:
        """(agents of the view,) whether fingers have closed on nothing, like demonstrations or not."""
        grippers, empty_closings = self._episode.grippers, self.spec.shuts
        demonstrated = [
            bool(empty_closings) and min(grippers.changes[row], MOST_CHANGES) in empty_closings[row]
            for row in self._rows
        ]
        closed = (~grippers.opened & (self._episode.openings < EMPTY_OPENING_M))[self._rows]
        return closed & (np.array(demonstrated) == meant)

    def _home(self) -> NDArray[np.float64]:
        """Targets (T, agents of the view, 8) at rest with open grippers, for as long as the motion takes.

        Agents that need not go there stand still.
        """
        homing, self._episode.homing = self._episode.homing, np.zeros_like(self._episode.homing)
        opened = homing | self._episode.grippers.opened[self._rows]
        targets = np.column_stack([self.state.targets.last, np.where(opened, 1.0, -1.0)])
        rests = np.stack([self.spec.rest_rad(agent) for agent in self.view.agents])
        targets[homing, :ARM_JOINTS] = rests[homing]
        distance_rad = np.abs(targets[:, :ARM_JOINTS] - self.state.targets.last).max(axis=1)
        mobile = self._fastest_rad > 0  # the others never move in demonstrations
        steps = np.ceil(np.max(distance_rad[mobile] / self._fastest_rad[mobile], initial=0)) + SETTLE_STEPS
        return np.tile(targets, (int(steps), 1, 1))

    def _with_predicted_phases(
        self, observation: Observation, features: Tensor, proprio: Tensor, contexts: Tensor
    ) -> tuple[Tensor, NDArray[np.bool_]]:
        """Context (S, O, C) with predicted phases, if any, and (agents of the view,) whether each waits."""
        agents = self.view.agents
        waiting = np.zeros(len(agents), dtype=bool)
        probabilities = self._policy.transition_probabilities(features, proprio, contexts)
        if probabilities is not None:
            phase = self._episode.transitions(probabilities.flatten(0, 1).cpu().double().numpy())
            subgoals, may_go_on = (torch.from_numpy(values).to(contexts.device) for values in phase)
            rows = len(contexts), -1
            contexts = self._policy.with_phases(
                contexts, subgoals.unflatten(0, rows), may_go_on.unflatten(0, rows)
            )
            waiting = ~phase[1]
        if observation.subgoals is not None:
            waiting = np.array([not observation.subgoals[agent][1] for agent in agents])
        if size := self.spec.phase_size:
            phases = contexts[:, -1, -size * len(self.view.streams[0].agents) :].reshape(len(agents), size)
            phases_of = zip(phases[:, :-1].argmax(dim=1).tolist(), (~waiting).tolist(), strict=True)
            self.state.phases = dict(zip(agents, phases_of, strict=True))
        return contexts, waiting

    def _within_deadband(
        self, actions: NDArray[np.float64], joints: NDArray[np.float64], opened: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """(agents of the view,) whether predicted actions (S, T, A) all stay near joints and gripper state.

        Predictions are some millimetres off. For an arm that stands still they would be a slow drift to
        states that no demonstration has visited.
        """
        commands = self._joint_actions(actions)
        near = np.abs(commands[..., :ARM_JOINTS] - joints).max(axis=(0, 2)) < self._config.acting.deadband_rad
        return near & ((commands[..., ARM_JOINTS] > 0) == opened).all(axis=0)

    def _joint_actions(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joint and gripper commands (T, agents of the view, 8) of predicted actions (S, T, A)."""
        joints = actions[..., : self.view.action_size].transpose(1, 0, 2)
        return joints.reshape(len(joints), -1, ACTION_SIZE)

    def act(self, decision: Decision | None = None) -> NDArray[np.float64]:
        """Commands (agents of the view, 8), as in `PolicyRunner`; records those of the grippers."""
        commands = super().act(decision)
        grippers = dict(zip(self.view.agents, commands[:, ARM_JOINTS], strict=True))
        self._episode.grippers.record(grippers, self._episode.openings)
        return commands


def load_runners(folder: Path, acting: PolicyConfig | None = None) -> tuple[DiffusionRunner, ...]:
    """The runners of an architecture: one for each policy in a subfolder of `folder`, see `load_policy`."""
    folders = sorted(path.parent for path in folder.glob(f"*/{MODEL}"))
    if not folders:
        raise StageError(f"no trained policies in {folder}; train them first (stages=[train])")
    return tuple(DiffusionRunner(*load_policy(path, acting=acting)) for path in folders)
