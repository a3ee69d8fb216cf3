"""Shield: arms that would come too close wait, whatever their policies; it never affects free arms."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rf_exp.constraints import PolicyMonitor
from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, nearest
from rf_exp.observations import Observation
from rf_exp.policy import Decision, Shield, rollout
from rf_exp.policy.acting.shield import RETREAT_STEPS, SLOWING_RAD_S2, WAIT_LIMIT_STEPS
from rf_exp.tasks import SuccessEvaluator, Task
from rf_exp.transforms import inverse, transform
from rf_exp.types import NO_PICTURES, ConstraintSet, Rollout, RolloutStep, Scene, Verdict
from tests.conftest import TASKS, read_task
from tests.constraints.robots import REACHING, REST, scene_of
from tests.policy.scripted import FASTEST_RAD, Predict, Puppets, Scripted

PAIR, ALONE = read_task("lift_barrier"), read_task("stack_cube")
TOGETHER = tuple(name for name in TASKS if len(read_task(name).agents) > 1)
ASIDE = REST + np.array([1.2, 0, 0, 0, 0, 0, 0])  # turned away from the other arm
LEFT, RIGHT = (REACHING + np.array([turn, 0, 0, 0, 0, 0, 0]) for turn in (0.4, -0.8))  # of the middle
CHUNK = 8  # targets
# Range of fractions of the way to another gripper, for arms so far apart that they meet only half-way.
MEETING = {"three_robots_place_shoes": (0.4, 0.6)}


def never(scene: Scene) -> Verdict:
    return Verdict(False, False, {})


def to(*goals: NDArray[np.float64], gripper: float = 1.0) -> Predict:
    """Chunks that hold one goal: goal after goal, then the last one again and again."""

    def predict(number: int, seen: Observation) -> NDArray[np.float64]:
        goal = goals[min(number, len(goals) - 1)]
        return np.tile(np.append(goal, gripper), (CHUNK, 1))

    return predict


def run(
    task: Task, predictions: Sequence[Predict], steps: int, shielded: bool = True, **changes
) -> tuple[Puppets, list[RolloutStep], Rollout]:
    """Rollout of scripted policies in a world of arms alone: world, recorded steps, result."""
    world, recorded = Puppets(task, **changes), []
    runners = [Scripted(agent, predict) for agent, predict in zip(task.agents, predictions, strict=True)]
    shield = Shield(task) if shielded else None
    return world, recorded, rollout(world, never, runners, 0, steps, None, recorded.append, shield=shield)


def apart_m(task: Task, path: NDArray[np.float64], scene: Scene | None = None) -> float:
    """The least distance of any two arms at commands (T, N, 8) and half-way between successive ones."""
    finer = np.stack([path[:-1], (path[:-1] + path[1:]) / 2], axis=1).reshape(-1, *path.shape[1:])
    planning_scene = PlanningScene(task, scene or scene_of(task))
    swept = [
        planning_scene.arm(agent, finer[:, agent - 1, :7], touches=task.objects) for agent in task.agents
    ]
    at = np.arange(len(finer))[:, None].repeat(2, axis=1)
    found = [nearest(a, b, at) for a, b in combinations(swept, 2)]
    return min(each.distance_m for each in found if each is not None)


def withheld(recorded: Sequence[RolloutStep], agent: int) -> list[int]:
    """The steps at which a shield withheld an agent's command."""
    return [step.scene.step for step in recorded if step.withheld and agent in step.withheld]


def arrived(world: Puppets, agent: int, goal: NDArray[np.float64]) -> list[int]:
    """The steps at which an agent was commanded to a goal."""
    return [k for k, each in enumerate(world.commands) if np.allclose(each[agent - 1, :7], goal, atol=1e-3)]


# free arms


def test_free_arms_are_given_their_commands_to_the_last_bit() -> None:
    for goals in ((ASIDE, ASIDE), (REACHING, ASIDE), (ASIDE, REST)):
        plain, _, _ = run(PAIR, [to(goal) for goal in goals], 40, shielded=False)
        world, recorded, result = run(PAIR, [to(goal) for goal in goals], 40)
        assert np.array_equal(np.stack(world.commands), np.stack(plain.commands))
        assert result.interventions == 0 and all(step.withheld == {} for step in recorded)


def test_without_a_shield_nothing_is_withheld() -> None:
    _, recorded, result = run(PAIR, [to(REACHING)] * 2, 30, shielded=False)
    assert result.interventions == 0 and all(step.withheld is None for step in recorded)


def test_a_single_arm_is_never_held() -> None:
    world, _, result = run(ALONE, [to(REACHING)], 40)
    assert result.interventions == 0 and arrived(world, 1, REACHING)


# arms that would meet


def test_arms_that_would_meet_keep_the_margin_and_one_waits() -> None:
    """Both reach into the middle, the second one a little later."""
    late = to(REST, REACHING)
    plain, _, _ = run(PAIR, [to(REACHING), late], 60, shielded=False)
    assert apart_m(PAIR, np.stack(plain.commands)) < 0
    world, recorded, result = run(PAIR, [to(REACHING), late], 60)
    assert apart_m(PAIR, np.stack(world.commands)) >= AGENT_MARGIN_M
    assert arrived(world, 1, REACHING) and not withheld(recorded, 1)  # it was there first
    assert len(withheld(recorded, 2)) == result.interventions > 0
    assert {step.withheld[2] for step in recorded if step.withheld} <= {"waits for agent 1", "retracts"}


def test_a_waiting_arm_goes_on_once_the_way_is_free() -> None:
    world, recorded, _ = run(PAIR, [to(*[REACHING] * 6, REST), to(REST, REACHING)], 100)
    assert apart_m(PAIR, np.stack(world.commands)) >= AGENT_MARGIN_M
    assert arrived(world, 1, REST)[-1] > 60 and arrived(world, 2, REACHING)
    assert 0 < len(withheld(recorded, 2)) < 3 * WAIT_LIMIT_STEPS and not withheld(recorded, 1)


def test_withheld_targets_are_executed_later() -> None:
    """An arm that is held at three steps executes its whole prediction, three steps later."""
    held = {3, 4, 9}

    def hold(scene: Scene, ahead) -> Decision:
        commands = np.array([ahead[agent][0] for agent in sorted(ahead)])
        if scene.step not in held:
            last.append(commands)
            return Decision(commands)
        return Decision(last[-1], {1: "waits"})

    last: list[NDArray[np.float64]] = []
    path = np.column_stack([REST + 0.02 * np.arange(1, 17)[:, None], np.linspace(1, -1, 16)])

    def chunks(number: int, seen: Observation) -> NDArray[np.float64]:
        return path.astype(float)[CHUNK * number :][:CHUNK]

    world = Puppets(ALONE)
    start = replace(world.reset(0), qpos=np.append(REST, [0.04, 0.04])[None])
    result = rollout(world, never, [Scripted(1, chunks)], 0, 19, start=start, shield=hold)
    assert result.interventions == 3
    done = [command[0] for k, command in enumerate(world.commands) if k not in held]
    assert np.allclose(done, path)


def test_after_its_chunk_an_arm_counts_as_standing_at_its_end() -> None:
    """The first arm predicts one step at a time; the second one, with chunks of 40 steps, is held off."""

    def short(number: int, seen: Observation) -> NDArray[np.float64]:
        return np.append(REACHING, 1.0)[None]

    def long(number: int, seen: Observation) -> NDArray[np.float64]:
        return np.tile(np.append(REACHING if number else REST, 1.0), (40, 1))

    world, recorded, _ = run(PAIR, [short, long], 80)
    assert apart_m(PAIR, np.stack(world.commands)) >= AGENT_MARGIN_M
    assert arrived(world, 1, REACHING) and not withheld(recorded, 1)
    assert withheld(recorded, 2) and not arrived(world, 2, REACHING)


@pytest.mark.slow
def test_no_arm_waits_forever() -> None:
    """Each has to pass the place of the other one: in the end one retracts, and both arrive."""
    for near, far in ((LEFT, RIGHT), (RIGHT, LEFT)):
        plans = [to(*[near] * 6, far)] * 2
        plain, _, _ = run(PAIR, plans, 100, shielded=False)
        assert apart_m(PAIR, np.stack(plain.commands)) < 0
        world, recorded, _ = run(PAIR, plans, 200)
        assert apart_m(PAIR, np.stack(world.commands)) >= AGENT_MARGIN_M
        assert arrived(world, 1, far) and arrived(world, 2, far)
        back = [step.scene.step for step in recorded if "retracts" in (step.withheld or {}).values()]
        assert 0 < len(back) <= RETREAT_STEPS


@pytest.mark.slow
@pytest.mark.parametrize("came", [True, False])
def test_an_arm_in_the_way_retracts(came: bool) -> None:
    """Its policy waits for the other one, at a place that it reached (`came`) or started at."""

    class Standing(Puppets):
        def reset(self, seed: int) -> Scene:
            super().reset(seed)
            if not came:
                self._qpos[0, :7] = REACHING
            return self._scene()

    def stays(number: int, seen: Observation) -> NDArray[np.float64]:
        goal = REACHING if came and number < 6 else seen.qpos[1][:7]
        return np.tile(np.append(goal, 1.0), (CHUNK, 1))

    runners = [Scripted(1, stays), Scripted(2, to(*[REST] * (6 * came), REACHING))]
    world, recorded = Standing(PAIR), list[RolloutStep]()
    rollout(world, never, runners, 0, 400, None, recorded.append, shield=Shield(PAIR))
    assert apart_m(PAIR, np.stack(world.commands)) >= AGENT_MARGIN_M
    assert arrived(world, 2, REACHING)
    assert next(step.withheld for step in recorded if "retracts" in (step.withheld or {}).values()) == {
        1: "retracts",
        2: "waits for agent 1",
    }


def test_an_arm_predicts_again_after_the_longest_wait() -> None:
    runners = [Scripted(1, to(REACHING)), Scripted(2, to(REST, REACHING))]
    recorded: list[RolloutStep] = []
    rollout(Puppets(PAIR), never, runners, 0, 70, None, recorded.append, shield=Shield(PAIR))
    first = withheld(recorded, 2)[0]
    anew = [step.scene.step for step in recorded if 2 in step.predicted and step.scene.step > first]
    assert anew[0] == first + WAIT_LIMIT_STEPS


def test_a_waiting_arm_slows_down_where_there_is_space() -> None:
    world, recorded, _ = run(PAIR, [to(REACHING), to(REST, REACHING)], 60)
    first = withheld(recorded, 2)[0]
    pace = np.abs(np.diff(np.stack(world.commands)[:, 1, :7], axis=0)).max(axis=1)[first - 4 : first + 1]
    slower = SLOWING_RAD_S2 * 0.05**2
    assert pace == pytest.approx([FASTEST_RAD, FASTEST_RAD, FASTEST_RAD - slower, 0, 0], abs=1e-6)


def test_a_waiting_gripper_keeps_its_opening() -> None:
    world, recorded, _ = run(PAIR, [to(REACHING), to(REST, REACHING, gripper=-1.0)], 60)
    assert withheld(recorded, 2)
    assert {command[1, 7] for command in world.commands[1:]} == {-1.0}


# loads


def test_a_held_object_is_part_of_its_arm() -> None:
    """An arm turns towards the other one: the way is free for its gripper, but not for a long bar in it."""
    scene = scene_of(PAIR)
    here = [np.append(scene.qpos[row, :7], -1.0) for row in (0, 1)]
    here[0][0] += 1.0
    scene.qpos[0, 0] += 1.0
    way = here[0] - np.arange(1.0, 21.0)[:, None] * np.append(0.05, np.zeros(7))
    ahead = {1: way, 2: np.tile(here[1], (20, 1))}
    gripper = PlanningScene(PAIR, scene).arms[0].tcp(scene.qpos[0])[:3, 3]
    outwards = gripper - PAIR.robots[0].world_from_base[:3, 3]
    outwards[2] = 0.0
    turned = Rotation.from_euler("z", float(np.arctan2(outwards[1], outwards[0])))
    pose = transform(gripper + 0.3 * outwards / np.linalg.norm(outwards), turned)
    decided = {}
    for load in (None, "barrier"):
        held = replace(scene, held=(load, None), poses={**scene.poses, "barrier": pose})
        decided[load] = [each.withheld for each in play(Shield(PAIR), held, ahead)]
    assert decided[None] == [{}] * 20
    assert decided["barrier"][-1] == {1: "waits for agent 2"}


def play(shield: Shield, scene: Scene, ahead, steps: int = 20) -> list[Decision]:
    """The decisions of a shield along the paths `ahead`, up to the first that withholds a command.

    Held objects stay in their grippers.
    """
    found, arms = [], PlanningScene(PAIR, scene).arms
    for step in range(steps):
        qpos, poses = scene.qpos.copy(), dict(scene.poses)
        if step:
            qpos[:, :7] = np.array([rows[step - 1, :7] for _, rows in sorted(ahead.items())])
        for arm, before, now, load in zip(arms, scene.qpos, qpos, scene.held, strict=True):
            if load is not None:
                poses[load] = arm.tcp(now) @ inverse(arm.tcp(before)) @ scene.poses[load]
        seen = replace(scene, step=step, qpos=qpos, poses=poses)
        found.append(shield(seen, {agent: rows[step:] for agent, rows in ahead.items()}))
        if found[-1].withheld:
            break
    return found


def test_arms_that_hold_one_object_wait_together() -> None:
    """Neither retracts alone."""
    plans = [to(REACHING), to(REST, REACHING)]
    for held, waiting in ((("barrier", None), {2}), (("barrier", "barrier"), {1, 2})):
        _, recorded, _ = run(PAIR, plans, 120, held=held, poses=far_away(PAIR))
        assert next(step.withheld.keys() for step in recorded if step.withheld) == waiting
        if len(waiting) == 2:
            assert all({*(step.withheld or ())} in (set(), waiting) for step in recorded)


def far_away(task: Task) -> dict[str, NDArray[np.float64]]:
    """Poses of all objects out of reach of the arms."""
    return dict.fromkeys(task.objects, transform((0, 0, 5)))


# too close already


def close_scene() -> tuple[Scene, NDArray[np.float64]]:
    """Two arms less than the margin apart, and a change (7,) rad of the first that brings them closer."""
    scene = scene_of(PAIR)
    scene.qpos[:, :7] = REST, REACHING
    change = (REACHING - REST) / 200
    while PlanningScene(PAIR, scene).between(1, 2).distance_m > 0.5 * AGENT_MARGIN_M:
        scene.qpos[0, :7] += change
    return scene, 2 * change


@pytest.mark.parametrize("closer", [True, False])
def test_arms_that_are_too_close_already_may_only_go_apart(closer: bool) -> None:
    scene, change = close_scene()
    here = [np.append(scene.qpos[agent, :7], 1.0) for agent in (0, 1)]
    way = here[0] + np.arange(1.0, 9.0)[:, None] * np.append(change if closer else -change, 0.0)
    decision = Shield(PAIR)(scene, {1: way, 2: np.tile(here[1], (8, 1))})
    assert (1 in decision.withheld) is closer
    assert np.array_equal(decision.commands[0], here[0] if closer else way[0])


# every task, in the simulator


def wild(task: Task, agent: int) -> Predict:
    """Chunks to random goals near the grippers of other arms."""
    scene = scene_of(task)
    grippers = [arm.tcp(q) for arm, q in zip(PlanningScene(task, scene).arms, scene.qpos, strict=True)]
    arm, rest = PlanningScene(task, scene).arms[agent - 1], scene.qpos[agent - 1, :7]
    others = [gripper[:3, 3] for other, gripper in enumerate(grippers, 1) if other != agent]
    rng = np.random.default_rng([agent, 5])

    def predict(number: int, seen: Observation) -> NDArray[np.float64]:
        goal = None
        while goal is None:
            tcp = grippers[agent - 1].copy()
            part = rng.uniform(*MEETING.get(task.name, (0.0, 0.9)))
            tcp[:2, 3] += part * (others[rng.integers(len(others))] - tcp[:3, 3])[:2]
            tcp[2, 3] = rng.uniform(0.2, 0.35)
            goal = arm.solve(tcp, rest)
        return np.tile(np.append(goal, 1.0), (2 * CHUNK, 1))

    return predict


@pytest.mark.slow
@pytest.mark.parametrize("name", TOGETHER)
def test_arms_driven_into_one_another_touch_only_without_a_shield(name: str) -> None:
    from rf_exp.sim import shared_simulator

    task = read_task(name)
    found: dict[bool, Rollout] = {}
    recorded: list[RolloutStep] = []
    for shielded in (False, True):
        recorded.clear()
        world = shared_simulator(task, NO_PICTURES)
        start = world.reset(3)
        runners = [Scripted(agent, wild(task, agent)) for agent in task.agents]
        shield: Callable | None = Shield(task) if shielded else None
        found[shielded] = rollout(
            world,
            SuccessEvaluator(task, start),
            runners,
            3,
            150,
            PolicyMonitor(task),
            recorded.append,
            start,
            shield,
        )
    assert found[False].violations > 0 and found[False].contacts > 0
    assert found[False].steps < found[True].steps == 150  # arms that press on one another have stopped
    assert (found[True].violations, found[True].contacts) == (0, 0)
    assert found[True].interventions > 0
    path = np.stack([step.action[:, :7] for step in recorded])  # with the shield
    assert (np.abs(np.diff(path, axis=0)).max(axis=2).sum(axis=0) > 0.3).all()  # rad: every arm moves


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pass_shoe", "three_robots_stack_cube", "take_photo"])
def test_the_shield_hardly_delays_an_expert(name: str) -> None:
    """Demonstrations, cut into chunks, succeed as before, delayed by a few control steps at most."""
    from rf_exp.datagen import Settings, make_episode
    from rf_exp.datagen.brain import read_brain
    from rf_exp.sim import shared_simulator

    task = read_task(name)
    settings = Settings.configured(task, ConstraintSet("full"), read_brain({"name": "scripted"}))
    episode = make_episode(settings, NO_PICTURES, 0).episode
    assert episode is not None

    def demonstrated(agent: int) -> Predict:
        commands = episode.action[:, agent - 1].astype(float)
        return lambda number, _: commands[min(CHUNK * number, len(commands) - 1) :][:CHUNK]

    world = shared_simulator(task, NO_PICTURES)
    start = world.reset(0)
    runners = [Scripted(agent, demonstrated(agent)) for agent in task.agents]
    result = rollout(
        world, SuccessEvaluator(task, start), runners, 0, len(episode.action) + 20, PolicyMonitor(task),
        start=start, shield=Shield(task),
    )  # fmt: skip
    assert result.success and (result.violations, result.contacts) == (0, 0)
    assert result.interventions <= 0.02 * len(episode.action)
