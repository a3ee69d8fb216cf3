"""Expert episodes for the gallery: generated without pictures, then replayed with rendering.

The same actions from the same seed give the same episode, so that only the shown steps are rendered.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rf_exp.datagen import EpisodeMaker, NullObserver, Planned, Settings
from rf_exp.errors import StageError
from rf_exp.sim import Limited, Simulator
from rf_exp.tasks import SuccessEvaluator
from rf_exp.types import CONTROL_DT_S, CameraModel, Scene, activity

HAND_M = 0.12  # height of a gripper above its fingertips, to be in view
ROOM = 1.3  # size of the shown part relative to its content
CLOSEST = 0.55  # least fraction of a picture that is shown
Pictures = Mapping[str, NDArray[np.uint8]]  # camera -> (H, W, 3)
Part = tuple[float, float, float, float]  # left, top, right, bottom in pixels


@dataclass(frozen=True)
class Line:
    """Activity of an agent at one control step."""

    text: str  # its subgoal; empty when none is left
    moving: bool


@dataclass(frozen=True)
class Still:
    """Pictures of one moment of an episode from all cameras."""

    title: str  # start | middle | end
    time_s: float
    pictures: Pictures
    lines: tuple[Line, ...]  # one per agent


@dataclass(frozen=True)
class Performance:
    """A successful episode and its three stills."""

    seed: int
    part: Part  # part of the global view that contains the action
    actions: NDArray[np.float64]  # (T, N, A)
    lines: tuple[tuple[Line, ...], ...]  # (T, N)
    stills: tuple[Still, ...]

    @property
    def seconds(self) -> float:
        return len(self.actions) * CONTROL_DT_S

    def line(self, step: int) -> tuple[Line, ...]:
        """Activities of the agents at a step; after the last step, the last ones without motion."""
        if step < len(self.lines):
            return self.lines[step]
        return tuple(Line(line.text, False) for line in self.lines[-1])


class Prompter(NullObserver):
    """Observer that records at every step each agent's subgoal, and how many agents touch an object."""

    def __init__(self) -> None:
        self.actions: list[NDArray[np.float64]] = []
        self.scenes: list[Scene] = []
        self.lines: list[tuple[Line, ...]] = []
        self.touching: list[int] = []  # number of agents that hold or push an object
        self._plan: Planned | None = None
        self._since = 0

    def planned(self, plan: Planned) -> None:
        self._plan, self._since = plan, len(self.lines)

    def stepped(self, scene: Scene, action: NDArray[np.float64], pictures: Pictures) -> None:
        assert self._plan is not None  # nothing moves without a plan
        step = len(self.lines) - self._since + 1
        self.actions.append(action)
        self.scenes.append(scene)
        held = dict(enumerate(scene.held, start=1))
        self.lines.append(tuple(_line(self._plan, agent, step, name) for agent, name in held.items()))
        touching = {agent for agent, name in held.items() if name}
        self.touching.append(len(touching | {agent for agent, _ in scene.finger_forces}))


def _line(plan: Planned, agent: int, step: int, held: str | None) -> Line:
    """Activity of an agent at a step of a plan, which may be holding an object only."""
    now = activity(plan.trajectories[agent - 1], plan.schedule, step)
    if now.segment is None:
        return Line(f"hold {held}" if held else "", False)
    return Line(now.segment.subgoal.text, now.moves)


def perform(settings: Settings, world: Simulator, seed: int) -> tuple[Performance | None, str]:
    """(the expert's episode of a seed with its stills, ""), or (None, reason) where it fails."""
    prompter = Prompter()
    outcome = EpisodeMaker(settings, Limited(world), settings.make_brain(seed), prompter).make(seed)
    if not outcome.success:
        return None, outcome.reason
    actions, lines = np.stack(prompter.actions), tuple(prompter.lines)
    moments = {"start": 0, "middle": _middle(prompter.touching), "end": len(actions)}
    shown = dict(play(world, seed, actions, set(moments.values())))
    scenes = [prompter.scenes[max(0, step - 1)] for step in moments.values()]
    places_m = np.concatenate([_places_m(world, each) for each in scenes])
    made = Performance(seed, _around(world.camera_models()["global"], places_m), actions, lines, ())
    stills = [Still(title, at * CONTROL_DT_S, shown[at], made.line(at)) for title, at in moments.items()]
    return replace(made, stills=tuple(stills)), ""


def _middle(touching: list[int]) -> int:
    """The step within the middle half with the most agents at work, of these the nearest to half-way.

    The half-way step itself often falls between two subgoals; without the limit to the middle half, tasks
    that end with all grippers on one object would show their end twice.
    """
    steps = np.arange(len(touching) // 4, 3 * len(touching) // 4 + 1)
    at_work = np.array(touching)[steps]
    busy = steps[at_work == at_work.max()]
    return int(busy[np.abs(busy - len(touching) / 2).argmin()])


def _places_m(world: Simulator, scene: Scene) -> NDArray[np.float64]:
    """Positions (K, 3) of objects, of TCPs and of points HAND_M above these."""
    arms = zip(world.task.arms.values(), scene.qpos, strict=True)
    hands = np.array([arm.tcp(qpos)[:3, 3] for arm, qpos in arms])
    things = np.array([pose[:3, 3] for pose in scene.poses.values()])
    return np.concatenate([things, hands, hands + np.array([0, 0, HAND_M])])


def _around(camera: CameraModel, places_m: NDArray[np.float64]) -> Part:
    """The part of a camera's picture, at its aspect ratio, that holds all positions (K, 3) with a margin."""
    camera_from_world = np.linalg.inv(camera.world_from_camera)
    seen = (places_m @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]) @ camera.intrinsics.T
    pixels, size = seen[:, :2] / seen[:, 2:], np.array([camera.width_px, camera.height_px])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    share = np.clip(ROOM * ((high - low) / size).max(), CLOSEST, 1.0)
    left, top = np.clip((low + high) / 2 - share * size / 2, 0, (1 - share) * size).tolist()
    return left, top, left + share * camera.width_px, top + share * camera.height_px


def play(
    world: Simulator, seed: int, actions: NDArray[np.float64], shown: set[int]
) -> Iterator[tuple[int, dict[str, NDArray[np.uint8]]]]:
    """Replays an episode; yields the pictures before the steps in `shown`, where T is after the last step.

    Raises StageError when the replay does not end in success.
    """
    scene = world.reset(seed)
    judge = SuccessEvaluator(world.task, scene)
    success = judge(scene).success
    for step, action in enumerate(actions):
        if step in shown:
            yield step, world.images()
        success = judge(world.step(action)).success
    if not success:
        raise StageError(f"task {world.task.name!r}, seed {seed}: played again, the episode does not succeed")
    if len(actions) in shown:
        yield len(actions), world.images()
