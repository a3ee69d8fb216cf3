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
trail their commands by up to `TRAILS_STEPS`, one perhaps more than the other: the space of an arm is kept
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
from rf_exp.policy.inputs.rows import GRIPPER, wide
from rf_exp.tasks import Task
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS, CONTROL_DT_S, GRIPPER_OPEN, Scene

SHIELD_VERSION = "3"  # of its decisions
WAIT_LIMIT_STEPS = 20  # of waiting before something else is tried
BACK_STEPS = 20  # that an arm retracts along its path at most
STRIDE_RAD = 0.04  # per control step, of an arm that draws aside
ASIDE_STEPS = 6  # that an arm draws aside
STANDS_RAD = 0.01  # an arm whose pending commands stay within this goes nowhere
SLOWING_RAD_S2 = 7.5  # deceleration that manufacturers allow for the slowest joint
TRAILS_STEPS = 2  # a measured arm trails its commands by 0.1 s: damping over stiffness of its drives
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
    anew: frozenset[int] = frozenset()  # agents that are to predict anew at the next step


class Lookahead:
    """Paths of all agents, from their last commands to the end of their pending ones.

    The path of an agent: its last command (twice, so that the first position means standing still), its
    pending commands, and the last of these once more. Its load moves with the gripper to the end, also after
    a command that opens it.
    """

    def __init__(self, task: Task, scene: Scene, given: Floats, ahead: Mapping[int, Commands]) -> None:
        self.ahead = ahead
        self._task, self._scene, self._given = task, scene, given
        self._planning_scene = PlanningScene(task, scene)
        self._swept: dict[int, Swept] = {}
        self._diagrams: dict[Pair, NDArray[np.bool_]] = {}

    def held(self, agent: int) -> str | None:
        return self._scene.held[agent - 1]

    def holding_with(self, agent: int) -> list[int]:
        """The agents that hold the same object as an agent, itself included."""
        load = self.held(agent)
        with_it = [each for each in self._task.agents if load is not None and load == self.held(each)]
        return with_it or [agent]

    def meet(self, pair: Pair, waits: Collection[int] = ()) -> float:
        """The first control step after which a pair is too close, with `waits` standing still, or inf."""
        diagram = self.diagram(pair)
        steps = np.arange(1, max(len(self.ahead[agent]) for agent in pair) + TRAILS_STEPS + 1)
        hit = np.zeros(len(steps), dtype=bool)
        for late in range(TRAILS_STEPS + 1):
            for behind in ((late, 0), (0, late)):
                at = (self._at(agent, steps - by, waits) for agent, by in zip(pair, behind, strict=True))
                hit |= diagram[*at]
        return float(steps[hit.argmax()]) if hit.any() else inf

    def enters(self, pair: Pair) -> dict[int, int]:
        """Agent -> the first position on its path that is too close to the path of the other one."""
        diagram = self.diagram(pair)
        return {agent: int(diagram.any(axis=axis).argmax()) for agent, axis in zip(pair, (1, 0), strict=True)}

    def room_to_slow_down(self, agent: int, waits: Collection[int]) -> bool:
        """Whether the whole next step of an agent is clear of all others, whatever they do soon."""
        for other in {*self._task.agents} - {agent}:
            diagram = self.diagram((agent, other)) if agent < other else self.diagram((other, agent)).T
            if diagram[1:3, : 3 if other in waits else LOOKAHEAD_STEPS + 2].any():
                return False
        return True

    def diagram(self, pair: Pair) -> NDArray[np.bool_]:
        """Coordination diagram (P, Q): whether positions on the paths of a pair violate the margin."""
        if pair not in self._diagrams:
            a, b = map(self._body, pair)
            now_m = _apart_m(a, b, 0, 0)
            if now_m >= AGENT_MARGIN_M:
                found = closer_than(a, b, AGENT_MARGIN_M)
            else:  # a pair already within the margin may move apart
                found = np.zeros((len(a), len(b)), dtype=bool)
                parts = {0: slice(0, 2), 2: slice(2, None)}  # standing still, going on
                for row, column in ((0, 2), (2, 0), (2, 2)):
                    closer = _apart_m(a, b, row, column) < now_m - CLOSER_M
                    found[parts[row], parts[column]] = closer
            self._diagrams[pair] = found
        return self._diagrams[pair]

    def _at(self, agent: int, steps: NDArray[np.int64], waits: Collection[int]) -> NDArray[np.int64]:
        """Positions on the path of an agent after control steps."""
        return np.zeros_like(steps) if agent in waits else np.clip(steps, 0, len(self.ahead[agent]) + 1) + 1

    def _body(self, agent: int) -> Swept:
        if agent not in self._swept:
            row = agent - 1
            given, ahead = self._given[row], self.ahead[agent]
            path = np.concatenate([[given, given], ahead, ahead[-1:]])
            measured = self._scene.qpos[row]
            # never narrower than measured now: fingers may need longer than this to close
            open_m = self._planning_scene.arms[row].robot.hand.open_m
            wide = (path[:, ARM_JOINTS:] + 1.0) / 2.0 * open_m
            fingers = np.maximum.accumulate(np.maximum(wide, measured[ARM_JOINTS:].max()), axis=0)
            qpos = np.hstack([path[:, :ARM_JOINTS], fingers, fingers])
            load = self.held(agent)
            grip = None
            if load is not None:
                grip = inverse(self._planning_scene.arms[row].tcp(measured)) @ self._scene.poses[load]
            self._swept[agent] = self._planning_scene.arm(
                agent, qpos, attached=load, tcp_from_object=grip, touches=self._task.objects
            )
        return self._swept[agent]


def _apart_m(a: Swept, b: Swept, row: int, column: int) -> float:
    return nearest(a, b, np.array([[row, column]])).distance_m


class Shield:
    """The shield of one rollout."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs: tuple[Pair, ...] = tuple(combinations(task.agents, 2))
        self._given = np.empty(0)  # (N, 8) the last commands
        self._strides_rad = np.zeros(len(task.robots))  # largest change of a joint in them
        self._known: dict[int, tuple[Commands, str | None]] = {}  # agent -> remaining commands, and load
        self._meet: dict[Pair, float] = {}  # control steps until a pair meets if both go on with them
        self._waited = dict.fromkeys(task.agents, 0)  # control steps; going on reduces them
        self._trails = {agent: deque[Floats](maxlen=BACK_STEPS) for agent in task.agents}
        self._back: dict[int, Commands] = {}  # agent -> remaining commands of its way back
        self._last_back: int | None = None  # agent that retracted last: two take turns

    def __call__(self, scene: Scene, ahead: Mapping[int, Commands]) -> Decision:
        """Decides on one control step. `ahead` is agent -> (T, 8) pending commands."""
        if not self._given.size:
            opened = np.full((len(scene.qpos), 1), GRIPPER_OPEN)
            self._given = np.hstack([scene.qpos[:, :ARM_JOINTS], opened])
        lookahead = Lookahead(self._task, scene, self._given, {**ahead, **self._back})
        waits = self._waits(lookahead)
        commands, withheld = self._given.copy(), dict[int, str]()
        for agent in self._task.agents:
            row = agent - 1
            if agent in waits:
                share = self._slowed(lookahead, agent, waits)
                step = lookahead.ahead[agent][0] - self._given[row]
                commands[row, :ARM_JOINTS] += share * step[:ARM_JOINTS]
                withheld[agent] = f"waits for agent {waits[agent]}"
            else:
                commands[row] = lookahead.ahead[agent][0]
                if agent in self._back:
                    withheld[agent] = "retracts"
        self._remember(scene, lookahead, commands, waits)
        last_first = reversed(self._task.agents)
        anew = frozenset(each for each in last_first if self._moves_on(each, waits.get(each), lookahead))
        return Decision(commands, withheld, anew)

    # which agents wait

    def _waits(self, lookahead: Lookahead) -> dict[int, int]:
        """Waiting agent -> the agent that it waits for."""
        meet = self._meet = {pair: self._until(lookahead, pair) for pair in self._pairs}
        waits: dict[int, int] = {}
        while soon := {pair: when for pair, when in meet.items() if when <= LOOKAHEAD_STEPS}:
            i, j = min(soon, key=lambda pair: (soon[pair], pair))
            for agent, other in self._yield(lookahead, (i, j), waits):
                for each in lookahead.holding_with(agent):
                    waits.setdefault(each, other if each != other else agent)
            meet = {
                pair: when if waits.keys().isdisjoint(pair) else lookahead.meet(pair, waits)
                for pair, when in meet.items()
                if not waits.keys() >= {*pair}
            }
        return waits

    def _until(self, lookahead: Lookahead, pair: Pair) -> float:
        """Control steps until a pair meets if both go on; cached while they do without a new prediction."""
        known = self._meet.get(pair, 0.0)
        for agent in pair:
            left, load = self._known.get(agent, (np.empty(0), None))
            if not np.array_equal(left, lookahead.ahead[agent]) or load != lookahead.held(agent):
                return lookahead.meet(pair)
        return known - 1 if known > LOOKAHEAD_STEPS else lookahead.meet(pair)

    def _yield(self, lookahead: Lookahead, pair: Pair, waits: Collection[int]) -> list[Pair]:
        """Pairs (waiting agent, agent that it waits for) of two that would meet."""
        i, j = pair
        both = [(i, j), (j, i)]
        if waiting := [each for each in both if each[0] in waits]:
            return [(b, a) for a, b in waiting]
        alone = [each for each in both if lookahead.meet(pair, {each[0]}) > LOOKAHEAD_STEPS]
        if len(alone) < 2:
            return alone or both
        late = lookahead.enters(pair)
        return [max(both, key=lambda each: (self._waited[each[0]], late[each[0]], each[0]))]

    # how they wait

    def _slowed(self, lookahead: Lookahead, agent: int, waits: Collection[int]) -> float:
        """Fraction of its next step that a decelerating arm still makes; 0 where it stops at once."""
        step_rad = float(np.abs((lookahead.ahead[agent][0] - self._given[agent - 1])[:ARM_JOINTS]).max())
        left_rad = float(self._strides_rad[agent - 1]) - SLOWING_RAD_S2 * CONTROL_DT_S**2
        if left_rad <= 0 or step_rad == 0 or not lookahead.room_to_slow_down(agent, waits):
            return 0.0
        return min(left_rad / step_rad, 1.0)

    def _remember(self, scene: Scene, lookahead: Lookahead, commands: Floats, waits: Collection[int]) -> None:
        moved = np.abs(commands - self._given)[:, :ARM_JOINTS].max(axis=1)
        for agent in self._task.agents:
            trail = self._trails[agent]
            if agent in self._back:
                if agent not in waits:
                    self._back[agent] = self._back[agent][1:]
                    if trail:
                        trail.pop()
            elif moved[agent - 1] > 0:
                trail.append(self._given[agent - 1].copy())
        goes_on = lookahead.ahead.keys() - waits
        self._known = {each: (lookahead.ahead[each][1:], scene.held[each - 1]) for each in goes_on}
        self._given, self._strides_rad = commands, moved

    def _moves_on(self, agent: int, other: int | None, lookahead: Lookahead) -> bool:
        """Whether an agent, which waits for `other` if any, is to predict anew. Ends and starts retreats."""
        waits = other is not None
        if agent in self._back:
            self._waited[agent] += waits
            if len(self._back[agent]) and self._waited[agent] < WAIT_LIMIT_STEPS:
                return False
            del self._back[agent]
            self._waited[agent] = 0
            return True
        self._waited[agent] = self._waited[agent] + 1 if waits else max(0, self._waited[agent] - 1)
        if not waits or self._waited[agent] % WAIT_LIMIT_STEPS:
            return False
        left_rad = np.abs(lookahead.ahead[other][:, :ARM_JOINTS] - self._given[other - 1, :ARM_JOINTS])
        back = other if left_rad.max() < STANDS_RAD and self._last_back != other else agent
        way, carries = self._way_back(back), len(lookahead.holding_with(back)) > 1  # with others that stay
        if self._waited[agent] % (2 * WAIT_LIMIT_STEPS) or self._back or carries or not len(way):
            return True
        self._back[back], self._last_back = way, back
        self._waited[agent] = 0
        return False

    def _way_back(self, agent: int) -> Commands:
        """Commands back along the past path of an agent; towards its retracted posture if there is none."""
        here = self._given[agent - 1]
        if self._trails[agent]:
            way = np.array(self._trails[agent])[::-1]
            way[:, ARM_JOINTS] = here[ARM_JOINTS]  # the gripper stays as it is
            return way
        aside = self._task.robots[agent - 1].model.aside_rad
        off = wide(np.append(aside, here[ARM_JOINTS]), GRIPPER) - here
        count = int(np.ceil(np.abs(off).max() / STRIDE_RAD))
        return here + off * np.arange(1, count + 1)[:ASIDE_STEPS, None] / max(1, count)
