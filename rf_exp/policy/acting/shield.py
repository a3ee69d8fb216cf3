"""Shield: RoboChecker between policies and arms, which checks predicted chunks before they are executed.

Policies predict chunks of joint targets, each unaware of what the others are about to do. Before every
control step the shield takes the pending commands of all of them, each chunk to its end, where its arm stands
still, and looks for the first control step at which two arms (links, fingers and loads) would come closer
than a margin, both moving: the coordination diagram of the two paths, read along its diagonal. If there is
none within `LOOKAHEAD_STEPS`, every arm gets its own command, to the last bit.

Otherwise one of the two waits where it stands:
1. one whose waiting alone lets the other one go on for `LOOKAHEAD_STEPS`; if there is none, both wait;
2. if this holds for either, the one that has waited longer already;
3. then the one that would enter the conflict region later, of equally late ones the higher number.
Arms that hold the same object wait together.

An arm that waits keeps its pending targets, and resumes them when it may. It decelerates along its path, by
at most `SLOWING_RAD_S2`, where there is room for that, and stops at once where not. After `WAIT_LIMIT_STEPS`
its policy predicts anew from the current observation. After as many again one arm retracts along the path
that it came by, and predicts anew there: the one that is waited for, if it goes nowhere itself (its policy
waits for the other one to act) and was not the last to retract, or else the waiting one. An arm without such
a path, as it has not moved yet, draws aside a little, towards its retracted posture. So two arms never wait
for one another forever, unless their ways back are blocked.

The guarantee is about commands. A step is allowed only if two arms that stop after it keep the margin there,
so stopping at once is safe at any time, and no commands are closer than the margin, except where a gripper
has just picked up an object. Between two commands of one chunk the margin is kept as well; on the way to the
first one of a new chunk, arms may fall short of it by a quarter of what both move in that step. Measured arms
trail their commands by up to `LAG_STEPS`, one perhaps more than the other: the space of an arm is kept
free for as long. Further deviations of the arms (an arm held up by the table, a load that slips), objects
that no arm holds, and the table are out of scope.
"""

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from math import inf

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry import AGENT_MARGIN_M, PlanningScene, Swept, closer_than, nearest
from rf_exp.policy.inputs.rows import GRIPPER, with_padding
from rf_exp.tasks import Task
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS, CONTROL_DT_S, GRIPPER_OPEN, Scene

SHIELD_VERSION = "3"  # of its decisions
WAIT_LIMIT_STEPS = 20  # of waiting before something else is tried
RETREAT_STEPS = 20  # that an arm retracts along its path at most
ASIDE_STEP_RAD = 0.04  # per control step, of an arm that draws aside
ASIDE_STEPS = 6  # that an arm draws aside
STATIONARY_RAD = 0.01  # an arm whose pending commands stay within this goes nowhere
SLOWING_RAD_S2 = 7.5  # deceleration that manufacturers allow for the slowest joint
LAG_STEPS = 2  # a measured arm trails its commands by 0.1 s: damping over stiffness of its drives
LOOKAHEAD_STEPS = 10  # a violation further ahead is no reason to wait yet
CLOSER_M = 1e-4  # arms already within the margin may not come closer by more than this
Floats = NDArray[np.float64]
Commands = Floats  # (T, 8) rad, gripper command
Pair = tuple[int, int]  # agents i < j


@dataclass(frozen=True)
class Decision:
    """Decision of a shield on one control step."""

    commands: Floats  # (N, 8)
    withheld: Mapping[int, str] = field(default_factory=dict)  # agent -> why its command was withheld
    replan: frozenset[int] = frozenset()  # agents that are to predict anew at the next step


class Lookahead:
    """Paths of all agents, from their last commands to the end of their pending ones.

    The path of an agent: its last command (twice, so that the first position means standing still), its
    pending commands, and the last of these once more. Its load moves with the gripper to the end, also after
    a command that opens it.
    """

    def __init__(
        self, task: Task, scene: Scene, last_commands: Floats, pending: Mapping[int, Commands]
    ) -> None:
        self.pending = pending
        self._task, self._scene, self._last_commands = task, scene, last_commands
        self._planning_scene = PlanningScene(task, scene)
        self._swept: dict[int, Swept] = {}
        self._diagrams: dict[Pair, NDArray[np.bool_]] = {}

    def held(self, agent: int) -> str | None:
        return self._scene.held[agent - 1]

    def holding_with(self, agent: int) -> list[int]:
        """The agents that hold the same object as an agent, itself included."""
        load = self.held(agent)
        agents = [each for each in self._task.agents if load is not None and load == self.held(each)]
        return agents or [agent]

    def steps_to_conflict(self, pair: Pair, waiting: Collection[int] = ()) -> float:
        """The first control step after which a pair is too close, with `waiting` standing still, or inf."""
        diagram = self.diagram(pair)
        steps = np.arange(1, max(len(self.pending[agent]) for agent in pair) + LAG_STEPS + 1)
        conflicts = np.zeros(len(steps), dtype=bool)
        for lag in range(LAG_STEPS + 1):
            for lags in ((lag, 0), (0, lag)):
                positions = (
                    self._positions(agent, steps - agent_lag, waiting)
                    for agent, agent_lag in zip(pair, lags, strict=True)
                )
                conflicts |= diagram[*positions]
        return float(steps[conflicts.argmax()]) if conflicts.any() else inf

    def conflict_entry(self, pair: Pair) -> dict[int, int]:
        """Agent -> the first position on its path that is too close to the path of the other one."""
        diagram = self.diagram(pair)
        return {agent: int(diagram.any(axis=axis).argmax()) for agent, axis in zip(pair, (1, 0), strict=True)}

    def room_to_slow_down(self, agent: int, waiting: Collection[int]) -> bool:
        """Whether the whole next step of an agent is clear of all others, whatever they do soon."""
        for other in {*self._task.agents} - {agent}:
            diagram = self.diagram((agent, other)) if agent < other else self.diagram((other, agent)).T
            if diagram[1:3, : 3 if other in waiting else LOOKAHEAD_STEPS + 2].any():
                return False
        return True

    def diagram(self, pair: Pair) -> NDArray[np.bool_]:
        """Coordination diagram (P, Q): whether positions on the paths of a pair violate the margin."""
        if pair not in self._diagrams:
            a, b = map(self._swept_path, pair)
            distance_m = _distance_m(a, b, 0, 0)
            if distance_m >= AGENT_MARGIN_M:
                result = closer_than(a, b, AGENT_MARGIN_M)
            else:  # a pair already within the margin may move apart
                result = np.zeros((len(a), len(b)), dtype=bool)
                spans = {0: slice(0, 2), 2: slice(2, None)}  # standing still, going on
                for row, column in ((0, 2), (2, 0), (2, 2)):
                    closer = _distance_m(a, b, row, column) < distance_m - CLOSER_M
                    result[spans[row], spans[column]] = closer
            self._diagrams[pair] = result
        return self._diagrams[pair]

    def _positions(self, agent: int, steps: NDArray[np.int64], waiting: Collection[int]) -> NDArray[np.int64]:
        """Positions on the path of an agent after control steps."""
        return (
            np.zeros_like(steps) if agent in waiting else np.clip(steps, 0, len(self.pending[agent]) + 1) + 1
        )

    def _swept_path(self, agent: int) -> Swept:
        if agent not in self._swept:
            row = agent - 1
            last_command, pending = self._last_commands[row], self.pending[agent]
            path = np.concatenate([[last_command, last_command], pending, pending[-1:]])
            measured = self._scene.qpos[row]
            # never narrower than measured now: fingers may need longer than this to close
            open_m = self._planning_scene.arms[row].robot.hand.open_m
            widths_m = (path[:, ARM_JOINTS:] + 1.0) / 2.0 * open_m
            fingers = np.maximum.accumulate(np.maximum(widths_m, measured[ARM_JOINTS:].max()), axis=0)
            qpos = np.hstack([path[:, :ARM_JOINTS], fingers, fingers])
            load = self.held(agent)
            tcp_from_object = None
            if load is not None:
                tcp_from_object = (
                    inverse(self._planning_scene.arms[row].tcp(measured)) @ self._scene.poses[load]
                )
            self._swept[agent] = self._planning_scene.arm(
                agent, qpos, attached=load, tcp_from_object=tcp_from_object, touches=self._task.objects
            )
        return self._swept[agent]


def _distance_m(a: Swept, b: Swept, row: int, column: int) -> float:
    return nearest(a, b, np.array([[row, column]])).distance_m


class Shield:
    """The shield of one rollout."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs: tuple[Pair, ...] = tuple(combinations(task.agents, 2))
        self._last_commands = np.empty(0)  # (N, 8) the last commands
        self._last_steps_rad = np.zeros(len(task.robots))  # largest change of a joint in them
        self._remaining: dict[int, tuple[Commands, str | None]] = {}  # agent -> remaining commands, and load
        self._conflicts: dict[Pair, float] = {}  # control steps until a pair meets if both go on with them
        self._waited = dict.fromkeys(task.agents, 0)  # control steps; going on reduces them
        self._trails = {agent: deque[Floats](maxlen=RETREAT_STEPS) for agent in task.agents}
        self._retreats: dict[int, Commands] = {}  # agent -> remaining commands of its way back
        self._last_retreated: int | None = None  # agent that retracted last: two take turns

    def __call__(self, scene: Scene, pending: Mapping[int, Commands]) -> Decision:
        """Decides on one control step. `pending` is agent -> (T, 8) pending commands."""
        if not self._last_commands.size:
            opened = np.full((len(scene.qpos), 1), GRIPPER_OPEN)
            self._last_commands = np.hstack([scene.qpos[:, :ARM_JOINTS], opened])
        lookahead = Lookahead(self._task, scene, self._last_commands, {**pending, **self._retreats})
        waiting = self._waiting(lookahead)
        commands, withheld = self._last_commands.copy(), dict[int, str]()
        for agent in self._task.agents:
            row = agent - 1
            if agent in waiting:
                fraction = self._slowing_fraction(lookahead, agent, waiting)
                step = lookahead.pending[agent][0] - self._last_commands[row]
                commands[row, :ARM_JOINTS] += fraction * step[:ARM_JOINTS]
                withheld[agent] = f"waits for agent {waiting[agent]}"
            else:
                commands[row] = lookahead.pending[agent][0]
                if agent in self._retreats:
                    withheld[agent] = "retracts"
        self._record(scene, lookahead, commands, waiting)
        reversed_agents = reversed(self._task.agents)
        replan = frozenset(
            each for each in reversed_agents if self._replans(each, waiting.get(each), lookahead)
        )
        return Decision(commands, withheld, replan)

    # which agents wait

    def _waiting(self, lookahead: Lookahead) -> dict[int, int]:
        """Waiting agent -> the agent that it waits for."""
        conflicts = self._conflicts = {pair: self._conflict_in(lookahead, pair) for pair in self._pairs}
        waiting: dict[int, int] = {}
        while soon := {pair: steps for pair, steps in conflicts.items() if steps <= LOOKAHEAD_STEPS}:
            i, j = min(soon, key=lambda pair: (soon[pair], pair))
            for agent, other in self._waiting_pairs(lookahead, (i, j), waiting):
                for each in lookahead.holding_with(agent):
                    waiting.setdefault(each, other if each != other else agent)
            conflicts = {
                pair: steps if waiting.keys().isdisjoint(pair) else lookahead.steps_to_conflict(pair, waiting)
                for pair, steps in conflicts.items()
                if not waiting.keys() >= {*pair}
            }
        return waiting

    def _conflict_in(self, lookahead: Lookahead, pair: Pair) -> float:
        """Control steps until a pair meets if both go on; cached while they do without a new prediction."""
        cached = self._conflicts.get(pair, 0.0)
        for agent in pair:
            remaining, load = self._remaining.get(agent, (np.empty(0), None))
            if not np.array_equal(remaining, lookahead.pending[agent]) or load != lookahead.held(agent):
                return lookahead.steps_to_conflict(pair)
        return cached - 1 if cached > LOOKAHEAD_STEPS else lookahead.steps_to_conflict(pair)

    def _waiting_pairs(self, lookahead: Lookahead, pair: Pair, waiting_agents: Collection[int]) -> list[Pair]:
        """Pairs (waiting agent, agent that it waits for) of two that would meet."""
        i, j = pair
        both = [(i, j), (j, i)]
        if waiting := [each for each in both if each[0] in waiting_agents]:
            return [(b, a) for a, b in waiting]
        alone = [each for each in both if lookahead.steps_to_conflict(pair, {each[0]}) > LOOKAHEAD_STEPS]
        if len(alone) < 2:
            return alone or both
        entry = lookahead.conflict_entry(pair)
        return [max(both, key=lambda each: (self._waited[each[0]], entry[each[0]], each[0]))]

    # how they wait

    def _slowing_fraction(self, lookahead: Lookahead, agent: int, waiting: Collection[int]) -> float:
        """Fraction of its next step that a decelerating arm still makes; 0 where it stops at once."""
        step_rad = float(
            np.abs((lookahead.pending[agent][0] - self._last_commands[agent - 1])[:ARM_JOINTS]).max()
        )
        slowed_rad = float(self._last_steps_rad[agent - 1]) - SLOWING_RAD_S2 * CONTROL_DT_S**2
        if slowed_rad <= 0 or step_rad == 0 or not lookahead.room_to_slow_down(agent, waiting):
            return 0.0
        return min(slowed_rad / step_rad, 1.0)

    def _record(self, scene: Scene, lookahead: Lookahead, commands: Floats, waiting: Collection[int]) -> None:
        moved_rad = np.abs(commands - self._last_commands)[:, :ARM_JOINTS].max(axis=1)
        for agent in self._task.agents:
            trail = self._trails[agent]
            if agent in self._retreats:
                if agent not in waiting:
                    self._retreats[agent] = self._retreats[agent][1:]
                    if trail:
                        trail.pop()
            elif moved_rad[agent - 1] > 0:
                trail.append(self._last_commands[agent - 1].copy())
        going_on = lookahead.pending.keys() - waiting
        self._remaining = {each: (lookahead.pending[each][1:], scene.held[each - 1]) for each in going_on}
        self._last_commands, self._last_steps_rad = commands, moved_rad

    def _replans(self, agent: int, other: int | None, lookahead: Lookahead) -> bool:
        """Whether an agent, which waits for `other` if any, is to predict anew. Ends and starts retreats."""
        waits = other is not None
        if agent in self._retreats:
            self._waited[agent] += waits
            if len(self._retreats[agent]) and self._waited[agent] < WAIT_LIMIT_STEPS:
                return False
            del self._retreats[agent]
            self._waited[agent] = 0
            return True
        self._waited[agent] = self._waited[agent] + 1 if waits else max(0, self._waited[agent] - 1)
        if not waits or self._waited[agent] % WAIT_LIMIT_STEPS:
            return False
        pending_rad = np.abs(
            lookahead.pending[other][:, :ARM_JOINTS] - self._last_commands[other - 1, :ARM_JOINTS]
        )
        retreating = other if pending_rad.max() < STATIONARY_RAD and self._last_retreated != other else agent
        # An arm that shares its load would retract with others that stay.
        path, shares_load = self._retreat_path(retreating), len(lookahead.holding_with(retreating)) > 1
        if self._waited[agent] % (2 * WAIT_LIMIT_STEPS) or self._retreats or shares_load or not len(path):
            return True
        self._retreats[retreating], self._last_retreated = path, retreating
        self._waited[agent] = 0
        return False

    def _retreat_path(self, agent: int) -> Commands:
        """Commands back along the past path of an agent; towards its retracted posture if there is none."""
        last_command = self._last_commands[agent - 1]
        if self._trails[agent]:
            path = np.array(self._trails[agent])[::-1]
            path[:, ARM_JOINTS] = last_command[ARM_JOINTS]  # the gripper stays as it is
            return path
        aside = self._task.robots[agent - 1].model.aside_rad
        motion = with_padding(np.append(aside, last_command[ARM_JOINTS]), GRIPPER) - last_command
        count = int(np.ceil(np.abs(motion).max() / ASIDE_STEP_RAD))
        return last_command + motion * np.arange(1, count + 1)[:ASIDE_STEPS, None] / max(1, count)
