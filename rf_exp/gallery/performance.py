"""Expert episodes for the gallery: generated without pictures, then replayed with rendering.

The same actions from the same seed give the same episode, so that only the shown steps are rendered.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen import EpisodeGenerator, NullObserver, Planned, Settings
from rf_exp.errors import StageError
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import SuccessEvaluator
from rf_exp.types import CONTROL_DT_S, CameraModel, Scene, activity

GRIPPER_HEIGHT_M = 0.12  # height of a gripper above its fingertips, to be in view
CROP_MARGIN = 1.3  # size of the shown part relative to its content
MIN_CROP = 0.55  # least fraction of a picture that is shown
Pictures = Mapping[str, NDArray[np.uint8]]  # camera -> (H, W, 3)
Crop = tuple[float, float, float, float]  # left, top, right, bottom in pixels


@dataclass(frozen=True)
class Activity:
    """Activity of an agent at one control step."""

    text: str  # its subgoal; empty when none is left
    moving: bool


@dataclass(frozen=True)
class Still:
    """Pictures of one moment of an episode from all cameras."""

    title: str  # start | middle | end
    time_s: float
    pictures: Pictures
    activities: tuple[Activity, ...]  # one per agent


@dataclass(frozen=True)
class Performance:
    """A successful episode and its three stills."""

    seed: int
    crop: Crop  # part of the global view that contains the action
    actions: NDArray[np.float64]  # (T, N, A)
    activities: tuple[tuple[Activity, ...], ...]  # (T, N)
    stills: tuple[Still, ...]

    @property
    def seconds(self) -> float:
        return len(self.actions) * CONTROL_DT_S

    def activities_at(self, step: int) -> tuple[Activity, ...]:
        """Activities of the agents at a step; after the last step, the last ones without motion."""
        if step < len(self.activities):
            return self.activities[step]
        return tuple(Activity(activity.text, False) for activity in self.activities[-1])


class ActivityRecorder(NullObserver):
    """Observer that records at every step each agent's subgoal, and how many agents touch an object."""

    def __init__(self) -> None:
        self.actions: list[NDArray[np.float64]] = []
        self.scenes: list[Scene] = []
        self.activities: list[tuple[Activity, ...]] = []
        self.touching: list[int] = []  # number of agents that hold or push an object
        self._plan: Planned | None = None
        self._plan_start = 0

    def planned(self, plan: Planned) -> None:
        self._plan, self._plan_start = plan, len(self.activities)

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Pictures) -> None:
        assert self._plan is not None  # nothing moves without a plan
        step = len(self.activities) - self._plan_start + 1
        self.actions.append(action)
        self.scenes.append(scene)
        held = dict(enumerate(scene.held, start=1))
        self.activities.append(
            tuple(_activity_at(self._plan, agent, step, name) for agent, name in held.items())
        )
        touching = {agent for agent, name in held.items() if name}
        self.touching.append(len(touching | {agent for agent, _ in scene.finger_forces}))


def _activity_at(plan: Planned, agent: int, step: int, held: str | None) -> Activity:
    """Activity of an agent at a step of a plan, which may be holding an object only."""
    current = activity(plan.trajectories[agent - 1], plan.schedule, step)
    if current.segment is None:
        return Activity(f"hold {held}" if held else "", False)
    return Activity(current.segment.subgoal.text, current.moves)


def perform(settings: Settings, world: Simulator, seed: int) -> tuple[Performance | None, str]:
    """(the expert's episode of a seed with its stills, ""), or (None, reason) where it fails."""
    recorder = ActivityRecorder()
    outcome = EpisodeGenerator(settings, CameraSubset(world), settings.make_brain(seed), recorder).make(seed)
    if not outcome.success:
        return None, outcome.reason
    actions, activities = np.stack(recorder.actions), tuple(recorder.activities)
    moments = {"start": 0, "middle": _busiest_step(recorder.touching), "end": len(actions)}
    pictures = dict(replay(world, seed, actions, set(moments.values())))
    scenes = [recorder.scenes[max(0, step - 1)] for step in moments.values()]
    positions_m = np.concatenate([_positions_m(world, scene) for scene in scenes])
    performance = Performance(
        seed, _crop_around(world.camera_models()["global"], positions_m), actions, activities, ()
    )
    stills = [
        Still(title, moment * CONTROL_DT_S, pictures[moment], performance.activities_at(moment))
        for title, moment in moments.items()
    ]
    return replace(performance, stills=tuple(stills)), ""


def _busiest_step(touching: list[int]) -> int:
    """The step within the middle half with the most agents at work, of these the nearest to half-way.

    The half-way step itself often falls between two subgoals; without the limit to the middle half, tasks
    that end with all grippers on one object would show their end twice.
    """
    steps = np.arange(len(touching) // 4, 3 * len(touching) // 4 + 1)
    at_work = np.array(touching)[steps]
    busiest = steps[at_work == at_work.max()]
    return int(busiest[np.abs(busiest - len(touching) / 2).argmin()])


def _positions_m(world: Simulator, scene: Scene) -> NDArray[np.float64]:
    """Positions (K, 3) of objects, of TCPs and of points HAND_M above these."""
    arms = zip(world.task.arms.values(), scene.qpos, strict=True)
    tcps = np.array([arm.tcp(qpos)[:3, 3] for arm, qpos in arms])
    objects = np.array([pose[:3, 3] for pose in scene.poses.values()])
    return np.concatenate([objects, tcps, tcps + np.array([0, 0, GRIPPER_HEIGHT_M])])


def _crop_around(camera: CameraModel, positions_m: NDArray[np.float64]) -> Crop:
    """The part of a camera's picture, at its aspect ratio, that holds all positions (K, 3) with a margin."""
    camera_from_world = np.linalg.inv(camera.world_from_camera)
    projected = (positions_m @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]) @ camera.intrinsics.T
    pixels, size = projected[:, :2] / projected[:, 2:], np.array([camera.width_px, camera.height_px])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    fraction = np.clip(CROP_MARGIN * ((high - low) / size).max(), MIN_CROP, 1.0)
    left, top = np.clip((low + high) / 2 - fraction * size / 2, 0, (1 - fraction) * size).tolist()
    return left, top, left + fraction * camera.width_px, top + fraction * camera.height_px


def replay(
    world: Simulator, seed: int, actions: NDArray[np.float64], steps: set[int]
) -> Iterator[tuple[int, dict[str, NDArray[np.uint8]]]]:
    """Replays an episode; yields the pictures before the steps in `steps`, where T is after the last step.

    Raises StageError when the replay does not end in success.
    """
    scene = world.reset(seed)
    evaluator = SuccessEvaluator(world.task, scene)
    success = evaluator(scene).success
    for step, action in enumerate(actions):
        if step in steps:
            yield step, world.images()
        success = evaluator(world.step(action)).success
    if not success:
        raise StageError(f"task {world.task.name!r}, seed {seed}: played again, the episode does not succeed")
    if len(actions) in steps:
        yield len(actions), world.images()
