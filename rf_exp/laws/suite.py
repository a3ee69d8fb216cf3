"""The laws of the suite: invariants of every task in simulation, each with a check that yields violations."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rf_exp.constraints import RoboChecker
from rf_exp.datagen import EpisodeGenerator, NullObserver, Planned, Settings, Unreachable, allocate_jobs
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.errors import ArgumentError
from rf_exp.gallery import replay
from rf_exp.geometry import AGENT_MARGIN_M, OBJECT_MARGIN_M, PlanningScene, nearest
from rf_exp.sim import CameraSubset, Simulator
from rf_exp.tasks import SuccessEvaluator, Task
from rf_exp.transforms import from_axes
from rf_exp.types import ANY_AGENT, ConstraintSet, Scene

WIDTH_PX, HEIGHT_PX = 320, 240  # of the checked pictures
MAX_RESTING_OVERLAP_M = 5e-4  # largest overlap of objects in contact at the start
REST_STEPS, MAX_REST_SPEED_M_S, MAX_REST_DRIFT_M = 40, 2e-3, 5e-4
RANDOM_EPISODES, RANDOM_STEPS = 10, 40
APPROACHES = 5  # per episode: building a scene costs as much as all its steps
MIN_TOUCHES = 20  # least number of approaches that move an object; with fewer they prove nothing
TARGET_STD_M = 0.03  # standard deviation of random targets about an object
FLIGHT_STEPS, MIN_FLIGHT_M = 30, 0.04
THROWS_M_S = ((0.0, 0.0, 2.5), (0.6, 0.6, 1.5), (-0.6, 0.4, 1.5), (0.3, -0.8, 2.0))
MIN_OBJECT_PX, MIN_ARM_PX, MIN_TABLE_PX = 30, 800, 10_000  # least visible pixels at the start, of 320 x 240
MIN_DIFFERENCE = 5  # mean difference of two views, of 255; or else
# fraction of different bodies, of the pixels in which one view shows more than the table
MIN_OTHER_BODIES = 0.5
MIN_WORKING_GRIPPER_PX, MIN_WORKED_OBJECT_PX = 150, 40  # least visible pixels in the view of an agent at work

Violations = Iterator[str]


@dataclass(frozen=True)
class Law:
    """Invariant of a task in simulation: its sentence, and a check that yields violations."""

    sentence: str
    violations: Callable[[Simulator], Violations]
    pictures: bool = False

    def __str__(self) -> str:
        return self.violations.__name__


def starts_differ(world: Simulator) -> Violations:
    task = world.task
    starts = [task.start(seed) for seed in range(100)]
    drawn: dict[str, list[NDArray[np.float64] | float]] = {
        "places of objects": [np.stack(list(start.poses.values())) for start in starts],
        "light": [start.light for start in starts],
    }
    for agent in task.agents:
        drawn[f"posture of agent {agent}"] = [start.qpos[agent - 1, :-2] for start in starts]
    for name in task.objects:
        drawn[f"colour of {name}"] = [start.tints[name] for start in starts]
    for factor, values in drawn.items():
        if (count := len({np.asarray(value).round(9).tobytes() for value in values})) < len(starts):
            yield f"{factor}: {count} of {len(starts)}"


def nothing_stands_in_anything(world: Simulator) -> Violations:
    task = world.task
    for seed in range(50):
        scene = task.start(seed).scene
        planning_scene = PlanningScene(task, scene)
        solid = [name for name in task.objects if task.asset(name).hulls]
        resting = {name: planning_scene.static_objects([name]) for name in solid}
        # Without allowed contacts, which objects that lie on others have.
        bodies = {name: replace(body, objects=frozenset()) for name, body in resting.items()}
        for (name_a, a), (name_b, b) in combinations(bodies.items(), 2):
            if (gap_m := nearest(a, b).distance_m) <= -MAX_RESTING_OVERLAP_M:
                yield f"seed {seed}: {name_a} and {name_b} overlap by {-1000 * gap_m:.1f} mm"
        for name in bodies:
            low_m = float(task.asset(name).vertices(scene.poses[name])[:, 2].min())
            if low_m <= -MAX_RESTING_OVERLAP_M:
                yield f"seed {seed}: {name} is {-1000 * low_m:.1f} mm in the table"
        for agent in task.agents:
            arm = planning_scene.arm(agent, scene.qpos[agent - 1])
            for name, body in bodies.items():
                if (gap_m := nearest(arm, body).distance_m) <= OBJECT_MARGIN_M:
                    yield f"seed {seed}: agent {agent} is {1000 * gap_m:.1f} mm from {name}"
        for a, b in combinations(task.agents, 2):
            if (gap_m := planning_scene.between(a, b).distance_m) <= AGENT_MARGIN_M:
                yield f"seed {seed}: agents {a} and {b} are {1000 * gap_m:.1f} mm apart"


def nothing_moves_by_itself(world: Simulator) -> Violations:
    for seed in range(3):
        start, hold = world.reset(seed), world.command
        for _ in range(REST_STEPS):
            scene = world.step(hold)
            for name, speed_m_s in scene.speeds.items():
                if speed_m_s >= MAX_REST_SPEED_M_S:
                    yield f"seed {seed}, step {scene.step}: {name} moves at {1000 * speed_m_s:.1f} mm/s"
                    return
            if any(scene.held) or scene.arm_contacts:
                yield f"seed {seed}, step {scene.step}: an arm holds or touches something"
                return
        for name, pose in start.poses.items():
            if (off_m := float(np.abs(scene.poses[name] - pose).max())) > MAX_REST_DRIFT_M:
                yield f"seed {seed}: {name} is {1000 * off_m:.1f} mm off after {REST_STEPS} steps"


def plans_name_what_exists(world: Simulator) -> Violations:
    task = world.task
    scene = task.start(3).scene
    proposal, places = task.module.plan(scene, task), task.places(scene)
    for subgoal in proposal.subgoals:
        if subgoal.agent not in (*task.agents, ANY_AGENT):
            yield f"{subgoal.text}: there is no agent {subgoal.agent}"
        elif subgoal.object is not None and subgoal.object not in task.objects:
            yield f"{subgoal.text}: there is no object {subgoal.object}"
        elif subgoal.point is not None and subgoal.point not in task.asset(subgoal.object or "").points:
            yield f"{subgoal.text}: there is no point {subgoal.point}"
        elif subgoal.target is not None and subgoal.target not in {*task.objects, *places}:
            yield f"{subgoal.text}: there is neither an object nor a place {subgoal.target}"
    try:
        limits = Settings.configured(task, ConstraintSet("full"), ScriptedSpec()).limits
        RoboChecker(task, allocate_jobs(proposal, task, scene, limits), ConstraintSet("full"))
    except (ArgumentError, Unreachable) as error:
        yield str(error)


def nothing_has_succeeded_at_the_start(world: Simulator) -> Violations:
    for seed in range(20):
        scene = world.reset(seed)
        verdict = SuccessEvaluator(world.task, scene)(scene)
        if verdict.success or verdict.success_paper or all(verdict.evidence.values()):
            yield f"seed {seed} is a success already"


def random_actions_never_succeed(world: Simulator) -> Violations:
    moved = 0
    for seed in range(RANDOM_EPISODES):
        rng = np.random.default_rng(seed)
        scene = world.reset(seed)
        evaluator, action = SuccessEvaluator(world.task, scene), world.command
        for _ in range(APPROACHES):
            before, reach = scene, _towards_objects(world.task, scene, rng) / RANDOM_STEPS
            for step in range(RANDOM_STEPS):
                action[:, :-1] += reach + rng.normal(0.0, 0.015, reach.shape)
                if step % 10 == 0:
                    action[:, -1] = rng.choice([-1.0, 1.0], len(action))
                scene = world.step(action)
                verdict = evaluator(scene)
                if verdict.success or verdict.success_paper:
                    yield f"seed {seed}, step {scene.step}: random actions succeed"
                    return
            moved += any(np.abs(scene.poses[name] - pose).max() > 2e-3 for name, pose in before.poses.items())
    if movable_objects(world.task) and moved < MIN_TOUCHES:
        yield f"random actions move something in {moved} of {RANDOM_EPISODES * APPROACHES} approaches alone"


def _towards_objects(task: Task, scene: Scene, rng: np.random.Generator) -> NDArray[np.float64]:
    """Joint changes (N, dof) rad: each arm to a pose above an object, or random where unreachable."""
    change = rng.normal(0.0, 0.3, (len(task.robots), task.dof))
    for row, (agent, arm) in enumerate(task.arms.items()):
        names = movable_objects(task) or list(task.objects)
        place_m = scene.poses[rng.choice(names)][:3, 3] + rng.normal(0.0, TARGET_STD_M, 3)
        turn = rng.uniform(0.0, np.pi)
        pose = from_axes(place_m, z=(0, 0, -1), y=(np.cos(turn), np.sin(turn), 0))
        start = arm.joints(scene.qpos[agent - 1])
        qpos = arm.solve(pose, start)
        if qpos is not None:
            change[row, : len(start)] = qpos - start
    return change


def movable_objects(task: Task) -> list[str]:
    """Names of the objects that can move."""
    return [name for name in task.objects if not (task.asset(name).static or task.asset(name).visual_only)]


def flung_things_never_succeed(world: Simulator) -> Violations:
    movable = movable_objects(world.task)
    for throw_m_s in THROWS_M_S:
        for names in filter(None, dict.fromkeys([*((name,) for name in movable), tuple(movable)])):
            start = scene = world.reset(0)
            evaluator, hold = SuccessEvaluator(world.task, start), world.command
            for name in names:
                world.fling(name, throw_m_s)
            highest_m = 0.0
            for step in range(FLIGHT_STEPS):
                scene = world.step(hold)
                risen_m = max(scene.poses[name][2, 3] - start.poses[name][2, 3] for name in names)
                highest_m = max(highest_m, float(risen_m))
                if evaluator(scene).success:
                    yield f"{', '.join(names)} flung at {throw_m_s} m/s: a success at step {step}"
                    break
            hinged = all(world.task.asset(name).hinge is not None for name in names)
            if highest_m <= MIN_FLIGHT_M and not hinged:
                yield f"{', '.join(names)} flung at {throw_m_s} m/s: does not fly"


def every_view_is_its_own(world: Simulator) -> Violations:
    world.reset(0)
    pictures = world.images()
    for name, picture in pictures.items():
        if picture.std() <= 20:
            yield f"{name} sees next to nothing"
    segmentation, table = world.segmentation(), world.bodies()["table"]
    for (name_a, a), (name_b, b) in combinations(pictures.items(), 2):
        things = ~(np.isin(segmentation[name_a], table) & np.isin(segmentation[name_b], table))
        others = (segmentation[name_a] != segmentation[name_b])[things]
        # Views of arms in a circle look alike, but show different bodies.
        if np.abs(a.astype(int) - b).mean() <= MIN_DIFFERENCE and others.mean() <= MIN_OTHER_BODIES:
            yield f"{name_a} and {name_b} see the same"


def everything_is_seen_at_the_start(world: Simulator) -> Violations:
    for seed in range(4):
        world.reset(seed)
        bodies = world.bodies()
        pixels = {
            camera: {name: int(np.isin(image, numbers).sum()) for name, numbers in bodies.items()}
            for camera, image in world.segmentation().items()
        }
        least = {("global", name): MIN_OBJECT_PX for name in world.task.objects}
        for k in world.task.agents:
            least |= {("global", f"agent{k}"): MIN_ARM_PX, (f"agent{k}", f"agent{k}"): MIN_ARM_PX}
        least |= {(camera, "table"): MIN_TABLE_PX for camera in pixels}
        for (camera, name), bound in least.items():
            if pixels[camera][name] <= bound:
                seen = pixels[camera][name]
                yield f"seed {seed}: {camera} sees {seen} px of {name}; more than {bound} are asked"


class _Moments(NullObserver):
    """Observer of the steps at which an agent ends a close, press or strike, or begins a shut or open."""

    def __init__(self) -> None:
        self.actions: list[NDArray[np.float64]] = []
        self.works: dict[int, set[tuple[int, str]]] = {}  # step -> (agent at work, object)

    def planned(self, plan: Planned) -> None:
        for trajectory in plan.trajectories:
            positions = plan.schedule.positions[:, trajectory.agent - 1]
            for segment, begin, end in trajectory.intervals:
                work_positions = {"close": end, "press": end, "strike": end, "shut": begin, "open": begin}
                position = work_positions.get(segment.primitive)
                if position is not None and segment.subgoal.object is not None:
                    step = len(self.actions) + int(np.searchsorted(positions, position))
                    self.works.setdefault(step, set()).add((trajectory.agent, segment.subgoal.object))

    def stepped(
        self, scene: Scene, action: NDArray[np.float64], pictures: Mapping[str, NDArray[np.uint8]]
    ) -> None:
        self.actions.append(action)


def agents_see_their_work(world: Simulator) -> Violations:
    task = world.task
    settings = Settings.configured(task, ConstraintSet("full"), ScriptedSpec())
    for seed in range(5):
        moments = _Moments()
        maker = EpisodeGenerator(settings, CameraSubset(world), settings.make_brain(seed), moments)
        if maker.make(seed).success:
            break
    else:
        yield "the expert succeeds in none of five seeds"
        return
    actions = np.stack(moments.actions)
    reached = {step for step in moments.works if step <= len(actions)}
    if idle := set(task.agents) - {agent for step in reached for agent, _ in moments.works[step]}:
        yield f"the expert leaves agents {sorted(idle)} without work"
    for step, _ in replay(world, seed, actions, reached):
        images, bodies = world.segmentation(), world.bodies()
        for k, name in sorted(moments.works[step]):
            image, fingers = images[f"agent{k}"], world.gripper(k)
            gripper_px, object_px = (int(np.isin(image, ids).sum()) for ids in (fingers, bodies[name]))
            if gripper_px < MIN_WORKING_GRIPPER_PX or object_px < MIN_WORKED_OBJECT_PX:
                seen = f"{gripper_px} px of its gripper and {object_px} px of {name}"
                yield f"step {step}: agent {k} sees {seen}"


LAWS = (
    Law("a hundred seeds give a hundred different starts", starts_differ),
    Law("nothing stands in anything else at the start, and arms keep apart", nothing_stands_in_anything),
    Law("nothing moves by itself", nothing_moves_by_itself),
    Law("the plan names only what exists, and every constraint is understood", plans_name_what_exists),
    Law("no start is a success already", nothing_has_succeeded_at_the_start),
    Law("random actions never succeed", random_actions_never_succeed),
    Law("things that are flung never succeed", flung_things_never_succeed),
    Law("every camera has a view of its own", every_view_is_its_own, pictures=True),
    Law(
        "the global camera sees everything, each agent's its arm",
        everything_is_seen_at_the_start,
        pictures=True,
    ),
    Law(
        "each agent sees its gripper and its object whenever it matters", agents_see_their_work, pictures=True
    ),
)


def check_task(task: Task, *, pictures: bool = True) -> Iterator[tuple[Law, list[str]]]:
    """Each law with its violations by a task; without `pictures`, only laws that need none."""
    for law in LAWS:
        if pictures or not law.pictures:
            with Simulator(task, width_px=WIDTH_PX, height_px=HEIGHT_PX, render=law.pictures) as world:
                yield law, list(law.violations(world))
