"""Observations that policies receive of a scene: what they declare, and nothing else."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from rf_exp.errors import StageError
from rf_exp.observations import Coordination, Declaration, Observation, Observations, observe
from rf_exp.policy import DiffusionRunner, Foreign, PolicyRunner, Stream, View, rollout, views
from rf_exp.policy import Policy as Networks
from rf_exp.policy.foreign.runner import ForeignRunner
from rf_exp.policy.inputs.observation_spec import spec_of
from rf_exp.tasks import read_variation
from rf_exp.types import Arch, CameraModel, Episode, Scene, Verdict
from tests.conftest import experiment, read_task
from tests.policy.conftest import ARCHS, HEIGHT, STEPS, WIDTH, StillWorld, make_episode, scene_at
from tests.policy.golden import RECIPES
from tests.policy.others import Policy, stay

AGENTS, COMMANDS = 2, 20
BLOCKS = ("block1", "block2")
VIEWS = (
    *ARCHS,
    Arch("separate_both", False, False, both_views=True),
    Arch("separate_coordinated", False, False, True),
)
LEARNED = [
    pytest.param(arch, recipe, id=f"{arch.name}-{recipe}")
    for arch in VIEWS
    for recipe in ("fast", "state", "paper")
    if not (arch.coordinated and recipe == "paper")  # it has no subgoals
]
QUICK = ("policy.head.diffusion.train_timesteps=4", "policy.head.diffusion.inference_steps=4")
Make = Callable[[Arch, str], list[DiffusionRunner]]


@pytest.fixture
def make_runners(make_store) -> Make:
    """(architecture, recipe) -> its runners, with untrained weights."""

    def make(arch: Arch, recipe: str) -> list[DiffusionRunner]:
        configured = experiment(
            f"policy={recipe}", f"picture={{width: {WIDTH}, height: {HEIGHT}}}", *RECIPES[recipe], *QUICK
        )
        found = []
        for view in views(arch, AGENTS):
            spec = spec_of(configured.policy, make_store(AGENTS, 3), view)
            torch.manual_seed(1)
            policy = Networks(configured.policy, view, spec)
            policy.normaliser.fastest.fill_(0.02)
            found.append(DiffusionRunner(policy, view, spec))
        return found

    return make


@dataclass(frozen=True)
class Observable:
    """What a policy of a view may observe, by the paper and by its recipe."""

    agents: tuple[int, ...]
    objects: tuple[str, ...]
    cameras: frozenset[str]
    coordinated: tuple[int, ...]


def observable(view: View, recipe: str) -> Observable:
    coordinated = view.agents if view.coordinated else ()
    if recipe == "state":
        return Observable(tuple(range(1, AGENTS + 1)), BLOCKS, frozenset(), coordinated)
    cameras = frozenset(camera for stream in view.streams for camera in stream.cameras)
    return Observable(view.agents, (), cameras, coordinated)


def redacted(scene: Scene, may: Observable) -> Scene:
    """The scene with everything that a policy may not observe replaced by nonsense."""
    others = [agent - 1 for agent in range(1, AGENTS + 1) if agent not in may.agents]
    qpos = scene.qpos.copy()
    qpos[others] = np.nan
    nonsense = np.full((4, 4), np.nan)
    return Scene(
        scene.step,
        qpos,
        np.full_like(scene.qvel, np.nan),
        {name: pose if name in may.objects else nonsense for name, pose in scene.poses.items()},
        dict.fromkeys(scene.poses, np.nan),
        ("nonsense",) * AGENTS,
        {(1, "block1"): np.full(3, np.nan)},
        ((1, 2, np.nan),),
        np.full((3, 3), 10**6),
        {"clutter1": nonsense},
        (("agent1", "clutter1", np.nan),),
    )


def at_once(step: int) -> Coordination:
    """Every agent is at its first subgoal and may go on."""
    return np.zeros(AGENTS, int), np.ones(AGENTS, bool)


def waiting(step: int) -> Coordination:
    """No agent may go on."""
    return np.zeros(AGENTS, int), np.zeros(AGENTS, bool)


def commands(
    runner: PolicyRunner,
    episode: Episode,
    may: Observable | None = None,
    coordination: Callable[[int], Coordination] = at_once,
) -> Iterator[NDArray[np.float64]]:
    """The commands (agents of the view, 8) of a runner at each step of a recorded episode.

    With `may`, everything that the policy may not observe is nonsense.
    """
    runner.reset(7)
    rng = np.random.default_rng(0)
    for step in range(COMMANDS):
        scene, (numbers, may_go) = scene_at(episode, step), coordination(step)
        pictures = {camera: frames[step] for camera, frames in episode.images.items()}
        if may is not None:
            scene = redacted(scene, may)
            for camera in {*pictures} - may.cameras:
                pictures[camera] = rng.integers(0, 256, pictures[camera].shape, np.uint8)
            hidden = [agent - 1 for agent in range(1, AGENTS + 1) if agent not in may.coordinated]
            numbers[hidden], may_go[hidden] = 10**6, False
        (seen,) = observe(scene, StillWorld(pictures), [runner.declaration], (numbers, may_go))
        yield runner(seen)


def differ(given: Iterable[NDArray[np.float64]], expected: NDArray[np.float64]) -> bool:
    """Whether any command differs from the expected one; stops at the first that does."""
    return any(not np.array_equal(*pair) for pair in zip(given, expected, strict=False))


@pytest.mark.slow
@pytest.mark.parametrize(("arch", "recipe"), LEARNED)
def test_what_a_policy_may_not_observe_does_not_change_its_commands(
    make_runners: Make, arch: Arch, recipe: str
) -> None:
    for runner in make_runners(arch, recipe):
        episode, may = make_episode(100, AGENTS), observable(runner.view, recipe)
        expected = np.stack([*commands(runner, episode)])
        assert np.isfinite(expected).all() and np.ptp(expected[..., :7], axis=0).max() > 0
        assert np.array_equal([*commands(runner, episode, may)], expected)
        # Everything that it may observe changes its commands, so the comparison above is not vacuous.
        moved = replace(episode, qpos=episode.qpos + np.float32(0.01))
        assert differ(commands(runner, moved), expected)
        if may.cameras:
            shifted = {camera: np.roll(frames, 9, axis=2) for camera, frames in episode.images.items()}
            assert differ(commands(runner, replace(episode, images=shifted)), expected)
        if may.objects:
            poses = {name: pose + np.float32(0.02) for name, pose in episode.poses.items()}
            assert differ(commands(runner, replace(episode, poses=poses)), expected)
        if may.coordinated:
            assert differ(commands(runner, episode, may, waiting), expected)


def names(observation: Observation) -> dict[str, Any]:
    """Field -> the names in it; empty fields are left out."""
    found = {each.name: getattr(observation, each.name) for each in fields(observation)}
    return {
        name: set(value) if isinstance(value, Mapping) else value for name, value in found.items() if value
    }


@pytest.mark.slow
@pytest.mark.parametrize(("arch", "recipe"), LEARNED)
def test_an_observation_holds_what_the_view_declares(make_runners: Make, arch: Arch, recipe: str) -> None:
    episode = make_episode(100, AGENTS)
    coordination = np.zeros(AGENTS, int), np.ones(AGENTS, bool)
    pictures = {camera: frames[3] for camera, frames in episode.images.items()}
    for runner in make_runners(arch, recipe):
        may = observable(runner.view, recipe)
        (seen,) = observe(scene_at(episode, 3), StillWorld(pictures), [runner.declaration], coordination)
        expected = {
            "step": 3,
            "qpos": {*may.agents},
            "poses": {*may.objects},
            "pictures": {*may.cameras},
            "subgoals": {*may.coordinated},
        }
        assert names(seen) == {name: value for name, value in expected.items() if value}


def test_an_observation_has_no_other_fields_of_a_scene() -> None:
    """It has the step, joints and poses of a scene, but not held objects, forces, contacts and speeds."""
    observed, whole = ({each.name for each in fields(kind)} for kind in (Observation, Scene))
    assert observed & whole == {"step", "qpos", "qvel", "poses"}


def test_observations_are_read_only_copies() -> None:
    episode = make_episode(0, AGENTS)
    scene, pictures = scene_at(episode, 0), {camera: f[0] for camera, f in episode.images.items()}
    declared = Declaration((2,), velocities=True, objects=("block1",), cameras=("agent2",))
    (seen,) = observe(scene, StillWorld(pictures), [declared])
    for array in (seen.qpos[2], seen.qvel[2], seen.poses["block1"], seen.pictures["agent2"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert not np.shares_memory(seen.qpos[2], scene.qpos) and seen.qpos[2].base is not scene.qpos
    with pytest.raises(TypeError):
        seen.qpos[1] = np.zeros(9)  # pyright: ignore[reportIndexIssue]
    with pytest.raises(AttributeError):
        seen.step = 4  # pyright: ignore[reportAttributeAccessIssue]


class Recorded(StillWorld):
    """World that replays a recorded episode."""

    def __init__(self, episode: Episode) -> None:
        super().__init__({})
        self._episode, self._now = episode, 0
        self.cameras = tuple(episode.images)
        self.requested: list[list[str]] = []  # the cameras of each call of `images`

    def reset(self, seed: int) -> Scene:
        self._now = 0
        return scene_at(self._episode, 0)

    def step(self, action: NDArray[np.float64]) -> Scene:
        self._now += 1
        return scene_at(self._episode, self._now)

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        assert cameras is not None
        self.requested.append([*cameras])
        return {name: self._episode.images[name][self._now] for name in self.requested[-1]}


class Spy(PolicyRunner):
    """Runner that holds still, needs pictures at every second step, and records the names it observes."""

    def __init__(self, agent: int, declared: Declaration | None) -> None:
        self.observed: list[dict[str, Any]] = []
        super().__init__(View(f"spy{agent}", (Stream("global", (agent,)),)), np.array([0.1]), declared)

    @property
    def needs_pictures(self) -> bool:
        return len(self.observed) % 2 == 0

    def observe(self, observation: Observation) -> None:
        self.observed.append(names(observation))

    def predict(self, observation: Observation) -> NDArray[np.float64]:
        return np.append(observation.qpos[self.view.agents[0]][:7], 1.0)[None, None]


def test_runners_of_a_rollout_observe_what_each_declares_and_no_more() -> None:
    one = Spy(1, Declaration((1,), objects=("block2",), cameras=("agent1",), coordinated=(1,)))
    other, world = Spy(2, None), Recorded(make_episode(0, AGENTS))

    def coordinate(scene: Scene, grippers: Mapping[int, float]) -> Coordination:
        return np.zeros(AGENTS, int), np.ones(AGENTS, bool)

    rollout(world, lambda scene: Verdict(False, False, {}), [one, other], 0, 4, coordinate=coordinate)
    always = {"qpos": {1}, "poses": {"block2"}, "subgoals": {1}}
    assert one.observed == [
        {**always, "pictures": {"agent1"}},
        {**always, "step": 1},
        {**always, "step": 2, "pictures": {"agent1"}},
        {**always, "step": 3},
    ]
    assert other.observed == [{"qpos": {2}}, *({"qpos": {2}, "step": step} for step in (1, 2, 3))]
    assert world.requested == [["agent1"], ["agent1"]]


@pytest.mark.parametrize("state", ["none", "joints", "full"])
def test_a_foreign_policy_observes_what_it_declares_and_no_more(state: Any) -> None:
    task = read_task("lift_barrier")
    spec = Foreign(
        "theirs", "a.b:c", None, None, 5.0, 5.0, None, None, 0, Observations(state=state, pictures=True)
    )
    policy = Policy(lambda seen: stay({"qpos": seen.get("qpos", np.zeros((2, 9)))}))
    runner = ForeignRunner(spec, policy, task, 0.1)
    episode = make_episode(0, AGENTS)
    scene = replace(scene_at(episode, 0), poses=dict.fromkeys(task.objects, np.eye(4)))
    pictures = {camera: frames[0] for camera, frames in episode.images.items()}
    for _ in range(2):  # no prediction is due in the second
        (seen,) = observe(scene, StillWorld(pictures), [runner.declaration])
        runner(seen)
    assert len(policy.observations) == 1 and not seen.pictures
    expected = {"rgb_global", "rgb_agent1", "rgb_agent2"}
    expected |= {"qpos", "qvel"} if state != "none" else set()
    expected |= {f"pose_{name}" for name in task.objects} if state == "full" else set()
    assert {*policy.observations[0]} == expected
    for array in policy.observations[0].values():
        array[:] = 0  # the policy may change its copies
    assert all(frames[0].any() for frames in episode.images.values())


def test_depth_in_a_world_without_it_is_an_error() -> None:
    pictures = {"global": np.zeros((HEIGHT, WIDTH, 3), np.uint8)}
    declared = Declaration(cameras=("global",), depth=True)
    with pytest.raises(StageError, match="a policy needs depth; the world has pictures alone"):
        observe(scene_at(make_episode(0, 1), STEPS - 1), StillWorld(pictures), [declared])


class CalibratedWorld(StillWorld):
    """World with calibrated cameras."""

    def __init__(self, variation: str) -> None:
        self.task = replace(read_task("lift_barrier"), variation=read_variation(variation)).in_scene(3)
        super().__init__({name: np.zeros((4, 4, 3), np.uint8) for name in self.task.cameras})

    def depth(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.float32]]:
        raise NotImplementedError

    def segmentation(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.int32]]:
        raise NotImplementedError

    def camera_models(self) -> dict[str, CameraModel]:
        return {
            name: CameraModel(4, 4, float(np.deg2rad(spec.fov_deg)), spec.world_from_camera)
            for name, spec in self.task.cameras.items()
        }

    def bodies(self) -> dict[str, tuple[int, ...]]:
        raise NotImplementedError


def test_calibration_is_that_of_the_scene_unless_it_is_unknown() -> None:
    declared = [Declaration((1,), cameras=("agent1",), calibrated=calibrated) for calibrated in (True, False)]
    world = CalibratedWorld("cameras")
    scene = world.task.start(3).scene
    calibrated, uncalibrated = observe(scene, world, declared)
    assert uncalibrated.calibration is None and calibrated.calibration is not None
    assert [*calibrated.calibration.cameras] == ["agent1"]
    pose = calibrated.calibration.cameras["agent1"].world_from_camera
    np.testing.assert_array_equal(pose, world.task.cameras["agent1"].world_from_camera)
    assert not np.allclose(pose, read_task("lift_barrier").cameras["agent1"].world_from_camera)
    for array in (pose, calibrated.calibration.world_from_base[1]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    (unknown,) = observe(scene, CalibratedWorld("cameras_unknown"), declared[:1])
    assert unknown.calibration is None
    (without,) = observe(scene, StillWorld(world.pictures), declared[:1])
    assert without.calibration is None
