"""The rollout loop in a small world whose arms reach their targets at once."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from rf_exp.constraints import PolicyMonitor
from rf_exp.errors import ArgumentError, StageError
from rf_exp.findings import Account, Closest, Violation
from rf_exp.policy import (
    Decision,
    DiffusionRunner,
    Policy,
    PolicyConfig,
    View,
    load_runners,
    rollout,
    views,
)
from rf_exp.policy.inputs.observation_spec import proprioception
from rf_exp.policy.networks.heads import DiffusionHead
from rf_exp.types import Rollout, RolloutStep, Scene, Verdict
from tests.conftest import read_task
from tests.policy.conftest import ARCHS, HEIGHT, REST, WIDTH, block_position, picture, shown, varied

FASTEST_RAD = 0.02  # per control step, of the policies here


class Table:
    """A World without physics: targets are reached at once."""

    def __init__(self, agents: int, size: tuple[int, int] = (HEIGHT, WIDTH)) -> None:
        self.cameras = ("global", *(f"agent{k}" for k in range(1, agents + 1)))
        self.agents, self.size = agents, size
        self.actions: list[NDArray[np.float64]] = []
        self.pictures_taken: list[int] = []  # steps

    def reset(self, seed: int) -> Scene:
        self.blocks = block_position(seed, self.agents)
        self.qpos = np.tile(np.append(REST, [0.04, 0.04]), (self.agents, 1))
        self.actions, self.pictures_taken = [], []
        return self.scene()

    def scene(self) -> Scene:
        nothing: Mapping = {}
        held = (None,) * self.agents
        return Scene(len(self.actions), self.qpos.copy(), np.zeros_like(self.qpos), nothing, nothing, held)

    def step(self, action: NDArray[np.float64]) -> Scene:
        self.actions.append(action)
        self.qpos[:, :7] = action[:, :7]
        return self.scene()

    def images(self, cameras: Iterable[str] | None = None) -> dict[str, NDArray[np.uint8]]:
        self.pictures_taken.append(len(self.actions))
        height, width = self.size
        seen = [picture(self.blocks[0]), *map(picture, self.blocks)]
        wanted = {*self.cameras} if cameras is None else {*cameras}
        named = zip(self.cameras, seen, strict=True)
        return {name: frame[:height, :width] for name, frame in named if name in wanted}


def judge(scene: Scene) -> Verdict:
    return Verdict(False, False, {})


@pytest.fixture
def make_runner(policy_config: PolicyConfig):
    """view -> a runner with random weights, for demonstrations of at most FASTEST_RAD per step."""

    def make(view: View, seed: int = 0, **changes) -> DiffusionRunner:
        config = varied(policy_config, changes)
        return DiffusionRunner(random_policy(config, view, seed), view)

    return make


@cache
def random_policy(config: PolicyConfig, view: View, seed: int) -> Policy:
    """Policy with random weights, shared by the runners of several tests, as acting changes no weight."""
    torch.manual_seed(seed)
    policy = Policy(config, view)
    policy.normaliser.fastest.fill_(FASTEST_RAD)
    # Tracing takes a while for each policy and gives the same to the last bit: test_networks.py.
    assert isinstance(policy.head, DiffusionHead)
    policy.head.unet.traced = lambda *_: None  # pyright: ignore[reportAttributeAccessIssue]
    return policy


@pytest.mark.slow
@pytest.mark.parametrize("agents", range(1, 5))
@pytest.mark.parametrize("arch", ARCHS, ids=lambda arch: arch.name)
def test_every_architecture_commands_every_agent(arch, agents: int, make_runner) -> None:
    world = Table(agents)
    runners = [make_runner(view) for view in views(arch, agents)]
    assert rollout(world, judge, runners, 3, 8) == Rollout(
        3, False, False, 8, 0, 0, Account(closest=Closest(0, 0, 0.0, 8))
    )
    actions = np.stack(world.actions)  # (T, N, 8)
    assert actions.shape == (8, agents, 8)
    assert (np.ptp(actions[..., :7], axis=0).max(axis=1) > 0).all()  # every arm moved


@pytest.mark.slow
def test_the_same_seed_gives_the_same_actions_whatever_ran_before(make_runner) -> None:
    world, runners = Table(2), [make_runner(view) for view in views(ARCHS[3], 2)]
    runs = []
    for seed in (5, 6, 5):
        rollout(world, judge, runners, seed, 7)
        runs.append(np.stack(world.actions))
    assert np.array_equal(runs[0], runs[2])
    assert not np.array_equal(runs[0], runs[1])


@pytest.mark.slow
def test_an_agent_acts_the_same_in_a_batch_and_alone(make_runner) -> None:
    """Agents with shared weights are rows of one batch; a row must not depend on its neighbours."""
    world, (shared,) = Table(2), views(ARCHS[1], 2)
    rollout(world, judge, [make_runner(shared)], 1, 7)
    batched = np.stack(world.actions)
    rollout(world, judge, [make_runner(View("alone", (stream,))) for stream in shared.streams], 1, 7)
    assert np.allclose(np.stack(world.actions), batched, atol=1e-5)


@pytest.mark.slow
def test_jumps_become_motions_at_the_speed_of_the_demonstrations(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    rollout(world, judge, runners, 0, 20)
    path = np.stack([REST, *(action[0, :7] for action in world.actions)])
    assert np.abs(np.diff(path, axis=0)).max() == pytest.approx(FASTEST_RAD, abs=1e-6)


def test_targets_within_reach_are_commanded_exactly(make_runner) -> None:
    runner = make_runner(views(ARCHS[3], 1)[0])
    world = Table(1)
    scene = world.reset(0)
    target = np.append(scene.qpos[0, :7] + 0.5 * FASTEST_RAD, 0.3)
    runner.state.targets.put(target[None, None])
    runner._episode.frames.append((torch.zeros(1, 1),) * 3)  # has observed already: no prediction is due
    runner._config = varied(runner._config, {"observation_steps": 1})
    assert np.allclose(runner(shown(runner, scene, {}))[0], target)


def test_pictures_are_taken_only_for_observations(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    rollout(world, judge, runners, 0, 14)
    assert world.pictures_taken == [0, 4, 5, 6, 10, 11, 12]  # three before each prediction at 0, 6, 12


def test_the_history_is_that_of_training(make_runner) -> None:
    """At step 6 the policy is given the frames of steps 4, 5 and 6, at step 0 three times the first."""
    world, runner = Table(1), make_runner(views(ARCHS[3], 1)[0])
    given, positions = [], []
    act = runner._policy.act

    def spy(features, proprio, context, generators, _beyond):
        given.append(proprio.clone())
        return act(features, proprio, context, generators)

    runner._policy.act = spy
    rollout(world, judge, [runner], 0, 8, on_step=lambda step: positions.append(step.scene.qpos))
    first = np.append(REST, [0.04, 0.04])[None]
    assert np.allclose(given[0][0], np.repeat(proprioception(first[None]), 3, axis=0))
    assert np.allclose(given[1][0], proprioception(np.stack(positions[3:6])))


def test_success_is_judged_after_every_step(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    seen: list[int] = []

    def at_eleven(scene: Scene) -> Verdict:
        seen.append(scene.step)
        return Verdict(scene.step == 11, scene.step == 4, {})

    assert rollout(world, at_eleven, runners, 0, 40) == Rollout(0, True, True, 11, 0, 0)
    assert seen == list(range(1, 12))


def touching(scene: Scene) -> Violation:
    """The violation that the monitor of evaluation finds if two arms press on one another."""
    pressed = replace(scene, arm_contacts=((1, 2, 12.0),))
    found = PolicyMonitor(read_task("lift_barrier"))(pressed)
    assert found is not None
    return found


def test_violations_are_counted_in_steps(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]

    def monitor(scene: Scene) -> Violation | None:
        return touching(scene) if scene.step in (2, 3, 7) else None

    result = rollout(world, judge, runners, 0, 9, monitor)
    assert result.violations == 3 and [each.time_s for each in result.account.violations] == [0.1]


def test_a_monitor_receives_joints_without_their_offset(make_runner, monkeypatch: pytest.MonkeyPatch) -> None:
    offset, seen = np.full((1, 7), 0.01), list[Scene]()
    monkeypatch.setattr(
        "rf_exp.constraints.checker.contact_evidence", lambda _, scene, *about: seen.append(scene)
    )

    class Off(Table):
        def scene(self) -> Scene:
            scene = super().scene()
            qpos = scene.qpos + np.append(offset, [[0.0, 0.0]], axis=1)
            return replace(scene, qpos=qpos, joint_offset_rad=offset)

    world, runners = Off(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    rollout(world, judge, runners, 0, 3, monitor=PolicyMonitor(read_task("lift_barrier")))
    commanded = [action[:, :7] for action in world.actions]
    np.testing.assert_allclose([scene.qpos[:, :7] for scene in seen], commanded, atol=1e-12)


@pytest.mark.parametrize(("force_n", "steps"), [(19.0, 9), (21.0, 4)])
def test_arms_that_press_on_one_another_stop_by_themselves(make_runner, force_n: float, steps: int) -> None:
    class Pressing(Table):
        def step(self, action: NDArray[np.float64]) -> Scene:
            scene = super().step(action)
            return replace(scene, arm_contacts=((1, 2, force_n),)) if scene.step == 4 else scene

    runners = [make_runner(view) for view in views(ARCHS[3], 2)]
    result = rollout(Pressing(2), judge, runners, 0, 9)
    assert (result.steps, result.success, result.contacts) == (steps, False, 1)
    assert "agents 1 and 2 touched (0.20 s, 1 steps)" in result.reason


@pytest.mark.parametrize("steps", [(), (2,), (4,)])
def test_contact_with_another_arm_excludes_strict_success(make_runner, steps: tuple[int, ...]) -> None:
    class Touching(Table):
        def step(self, action: NDArray[np.float64]) -> Scene:
            scene = super().step(action)
            return replace(scene, arm_contacts=((1, 2, 2.0),)) if scene.step in steps else scene

    def met(scene: Scene) -> Verdict:
        return Verdict(scene.step >= 4, scene.step >= 4, {"held": True})

    runners = [make_runner(view) for view in views(ARCHS[3], 2)]
    result = rollout(Touching(2), met, runners, 0, 9)
    assert (result.success, result.success_paper, result.contacts) == (not steps, True, len(steps))
    assert result.steps == (9 if steps else 4)
    assert (result.reason == "") is result.success
    if steps:
        assert result.reason.startswith(
            "failed: all conditions held, but arms had touched (9 steps); agents 1"
        )
        assert result.account.closest is not None and result.account.closest.score < 1


def test_a_failure_has_its_reason_and_a_success_has_none(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]

    def never(scene: Scene) -> Verdict:
        return Verdict(False, False, {"held": scene.step < 4, "lifted": False})

    reason = "failed: held (since 0.20 s), lifted (never); at best 1 of 2 (0.05 s)"
    assert rollout(world, never, runners, 0, 9).reason == reason
    assert rollout(world, lambda scene: Verdict(True, True, {"held": True}), runners, 0, 9).reason == ""


@pytest.mark.slow
def test_observers_receive_predictions_and_executed_actions(make_runner) -> None:
    world, runners = Table(2), [make_runner(view) for view in views(ARCHS[3], 2)]
    recorded: list[RolloutStep] = []
    rollout(
        world,
        judge,
        runners,
        3,
        8,
        lambda scene: touching(scene) if scene.step == 2 else None,
        recorded.append,
    )
    assert [step.scene.step for step in recorded] == list(range(1, 9))
    assert np.array_equal(np.stack([step.action for step in recorded]), np.stack(world.actions))
    assert [step.violation for step in recorded[:3]] == [None, touching(recorded[1].scene), None]
    assert [sorted(step.predicted) for step in recorded] == [[1, 2], *[[]] * 5, [1, 2], []]  # chunks of 6
    chunk = recorded[0].predicted[2]
    assert chunk.shape == (6, 8)
    executed = np.stack([step.action[1, :7] for step in recorded[:6]])
    assert (np.abs(executed - REST).max(axis=1) <= FASTEST_RAD * np.arange(1, 7) + 1e-9).all()
    assert np.abs(chunk[:, :7] - executed).max() > FASTEST_RAD  # as an untrained network predicts


def holding(agent: int, steps: range, anew: bool = False):
    """Shield that holds an agent for some steps; with `anew`, the agent predicts again after them."""
    given: list[NDArray[np.float64]] = []

    def shield(scene: Scene, ahead: Mapping[int, NDArray[np.float64]]) -> Decision:
        commands = np.array([ahead[k][0] for k in sorted(ahead)])
        withheld = {}
        if scene.step + 1 in steps:
            commands[agent - 1] = given[-1][agent - 1]
            withheld = {agent: "waits"}
        given.append(commands)
        ends = anew and scene.step + 1 == steps[-1]
        return Decision(commands, withheld, frozenset({agent} if ends else ()))

    return shield


@pytest.mark.slow
def test_a_shield_that_withholds_nothing_changes_no_bit(make_runner) -> None:
    for arch in ARCHS:
        world, runners = Table(2), [make_runner(view) for view in views(arch, 2)]
        runs = []
        for shield in (None, holding(1, range(0))):
            result = rollout(world, judge, runners, 3, 20, shield=shield)
            runs.append((np.stack(world.actions), world.pictures_taken, result))
        assert np.array_equal(runs[0][0], runs[1][0])
        assert runs[0][1:] == runs[1][1:]


@pytest.mark.slow
def test_an_agent_that_is_held_executes_the_rest_later(make_runner) -> None:
    """Separate policies have clocks of their own; agents of one policy get their next chunks together."""
    recorded: list[RolloutStep] = []
    for arch, together in ((ARCHS[3], False), (ARCHS[1], True), (ARCHS[0], True)):
        world, runners = Table(2), [make_runner(view) for view in views(arch, 2)]
        rollout(world, judge, runners, 3, 14)
        plain = np.stack(world.actions)
        recorded.clear()
        result = rollout(world, judge, runners, 3, 14, None, recorded.append, shield=holding(1, range(3, 6)))
        actions = np.stack(world.actions)
        assert result.interventions == 3
        assert np.array_equal(actions[:6, 1], plain[:6, 1])  # the other one goes on: six steps a chunk
        assert np.array_equal(actions[:2, 0], plain[:2, 0]) and (actions[2:5, 0] == actions[1, 0]).all()
        assert np.array_equal(actions[5, 0], plain[2, 0])
        second = [sorted(step.predicted) for step in recorded[1:] if step.predicted]
        assert second == ([[1, 2], [1, 2]] if together else [[2], [1], [2]])


def test_a_new_prediction_after_waiting_uses_new_observations(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    recorded: list[RolloutStep] = []
    rollout(world, judge, runners, 0, 9, None, recorded.append, shield=holding(1, range(2, 6), anew=True))
    assert [step.scene.step for step in recorded if step.predicted] == [1, 6]
    assert world.pictures_taken == [0, 2, 3, 4, 5]  # since its first step of waiting
    assert [step.withheld for step in recorded[:3]] == [{}, {1: "waits"}, {1: "waits"}]


def test_a_given_start_is_not_reset_again(make_runner) -> None:
    world, runners = Table(1), [make_runner(view) for view in views(ARCHS[3], 1)]
    start = world.reset(4)
    rollout(world, judge, runners, 4, 3)
    expected = np.stack(world.actions)
    start = world.reset(4)
    world.reset = lambda seed: pytest.fail("reset again")
    rollout(world, judge, runners, 4, 3, start=start)
    assert np.array_equal(np.stack(world.actions), expected)


def test_agents_without_a_policy(make_runner) -> None:
    with pytest.raises(ArgumentError, match=r"policies command agents \[2\]; expected each of \[1, 2\] once"):
        rollout(Table(2), judge, [make_runner(views(ARCHS[3], 2)[1])], 0, 3)


def test_a_step_limit_of_zero(make_runner) -> None:
    with pytest.raises(ArgumentError, match="step_limit is 0; expected at least 1"):
        rollout(Table(1), judge, [], 0, 0)


def test_a_camera_the_world_lacks(make_runner) -> None:
    world = Table(2)
    world.cameras = ("global", "left", "agent2")
    with pytest.raises(
        StageError, match="policy 'agent1' needs camera 'agent1'; the world has agent2, global, left"
    ):
        rollout(world, judge, [make_runner(view) for view in views(ARCHS[3], 2)], 0, 3)


def test_pictures_of_another_size(make_runner) -> None:
    world = Table(1, size=(HEIGHT, 40))
    with pytest.raises(
        StageError, match=r"gives pictures \(32, 40, 3\); policy 'agent1' was trained on \(32, 48, 3\)"
    ):
        rollout(world, judge, [make_runner(view) for view in views(ARCHS[3], 1)], 0, 3)


def test_a_folder_without_policies(tmp_path) -> None:
    with pytest.raises(StageError, match=r"no trained policies in .*; train them first"):
        load_runners(tmp_path)
