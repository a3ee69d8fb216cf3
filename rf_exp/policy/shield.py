"""RoboChecker between policies and arms: what was predicted is checked before it is executed.

Policies predict chunks of joint targets, each blind to what the others are about to do. Before every
control step the shield takes the commands that all of them are about to give, each chunk to its end, where
its arm stands still, and looks for the first control step at which two arms (links, fingers and loads)
would come closer than a margin, both moving: the coordination diagram of the two paths, read along its
diagonal. Where there is none within `LOOKAHEAD_STEPS`, everybody is given their own command, to the last bit.

Otherwise one of the two waits where it stands:
1. one whose waiting alone lets the other one go on for `LOOKAHEAD_STEPS`; if there is none, both wait;
2. if it is so for either, the one that has waited longer already;
3. then the one that would be later in the room that both want, of equally late ones the higher number.
Arms that hold one thing wait together.

An arm that waits keeps the targets it has not been given, and goes on with them when it may. It slows down
on its way, no faster than `SLOWING_RAD_S2`, where there is room for that, and stops at once where not. After
`PATIENCE_STEPS` its policy predicts anew from what it sees now; after as many again it draws back along the
way that it came, one arm at a time, and predicts anew there. So two arms never wait for one another for
ever, unless both ways back are closed by a third one.

What this guarantees is about commands. A step is allowed only if two arms that stop behind it keep the margin
there, so to stop at once is safe at any time, and no commands are closer than the margin, but where a hand
has just taken a thing up. Between two commands of one chunk the margin is kept as well; on the way to the
first one of a new chunk arms may lack a quarter of what both move in that step. Measured arms trail their
commands by up to `TRAILS_STEPS`, one perhaps more than the other: the room of an arm is kept free for as
long. What the arms do beyond that (an arm held up by the table, a load that slips), objects that nobody
holds, and the table are not the shield's concern.
"""

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import combinations
from math import inf

import numpy as np
from numpy.typing import NDArray

from rf_exp.geometry import AGENT_MARGIN_M, Bodies, Swept, closer_than, nearest
from rf_exp.tasks import Task
from rf_exp.tasks.base import FINGERS_OPEN_M
from rf_exp.transforms import inverse
from rf_exp.types import ARM_JOINTS, CONTROL_DT_S, GRIPPER_OPEN, Scene

VERSION = "1"  # of what it decides
LOOKAHEAD_STEPS = 10  # a violation that is farther off is no reason to wait yet
PATIENCE_STEPS = 20  # of waiting, until something else is tried
BACK_STEPS = 20  # of its own way that an arm draws back at most
TRAILS_STEPS = 2  # a measured arm trails its commands by 0.1 s: damping over stiffness of its drives
SLOWING_RAD_S2 = 7.5  # what the maker allows the slowest joint of a Panda
CLOSER_M = 1e-4  # arms that lack the margin already may not come closer than they are by more than this

Commands = NDArray[np.float64]  # (T, 8) rad, gripper command
Pair = tuple[int, int]  # agents i < j


@dataclass(frozen=True)
class Decision:
    """What a shield lets the arms do in a control step."""

    commands: NDArray[np.float64]  # (N, 8)
    withheld: Mapping[int, str] = field(default_factory=dict)  # agent -> why it was kept from its command
    anew: frozenset[int] = frozenset()  # agents that are to predict anew at the next step


class Shield:
    """The shield of one rollout."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pairs: tuple[Pair, ...] = tuple(combinations(task.agents, 2))
        self._given = np.empty(0)  # (N, 8) the last commands
        self._strides_rad = np.zeros(len(task.robots))  # the largest change of a joint in them
        self._known: dict[int, tuple[Commands, str | None]] = {}  # agent -> what is left to do, and its load
        self._meet: dict[Pair, float] = {}  # control steps until two meet that go on with that
        self._waited = dict.fromkeys(task.agents, 0)  # control steps; going on pays them back
        self._trails = {agent: deque[NDArray[np.float64]](maxlen=BACK_STEPS) for agent in task.agents}
        self._back: dict[int, Commands] = {}  # agent -> its way back that is left

    def __call__(self, scene: Scene, ahead: Mapping[int, Commands]) -> Decision:
        """Decides on one control step. `ahead` is agent -> (T, 8) the commands it is about to be given."""
        if not self._given.size:
            opened = np.full((len(scene.qpos), 1), GRIPPER_OPEN)
            self._given = np.hstack([scene.qpos[:, :ARM_JOINTS], opened])
        outlook = Outlook(self._task, scene, self._given, {**ahead, **self._back})
        waits = self._waits(outlook)
        commands, withheld, anew = self._given.copy(), dict[int, str](), set[int]()
        for agent in self._task.agents:
            row = agent - 1
            if agent in waits:
                share = self._slowed(outlook, agent, waits)
                step = outlook.ahead[agent][0] - self._given[row]
                commands[row, :ARM_JOINTS] += share * step[:ARM_JOINTS]
                withheld[agent] = f"waits for agent {waits[agent]}"
            else:
                commands[row] = outlook.ahead[agent][0]
                if agent in self._back:
                    withheld[agent] = "draws back"
        self._remember(scene, outlook, commands, waits)
        for agent in reversed(self._task.agents):
            if self._moves_on(agent, agent in waits):
                anew.add(agent)
        return Decision(commands, withheld, frozenset(anew))

    # who waits

    def _waits(self, outlook: "Outlook") -> dict[int, int]:
        """Agent -> for whom it waits."""
        meet = {pair: self._until(outlook, pair) for pair in self._pairs}
        self._meet = meet
        waits: dict[int, int] = {}
        while soon := {pair: when for pair, when in meet.items() if when <= LOOKAHEAD_STEPS}:
            i, j = min(soon, key=lambda pair: (soon[pair], pair))
            for agent, other in self._yield(outlook, (i, j), waits):
                for each in outlook.holding_with(agent):
                    waits.setdefault(each, other if each != other else agent)
            meet = {
                pair: when if waits.keys().isdisjoint(pair) else outlook.meet(pair, waits)
                for pair, when in meet.items()
                if not waits.keys() >= {*pair}
            }
        return waits

    def _until(self, outlook: "Outlook", pair: Pair) -> float:
        """Control steps until two meet if both go on. Known while they do, and nothing new was predicted."""
        if pair in self._meet and self._meet[pair] > LOOKAHEAD_STEPS and all(map(self._same(outlook), pair)):
            return self._meet[pair] - 1
        return outlook.meet(pair)

    def _same(self, outlook: "Outlook"):
        @cache
        def same(agent: int) -> bool:
            left, load = self._known.get(agent, (np.empty(0), None))
            return np.array_equal(left, outlook.ahead[agent]) and load == outlook.held(agent)

        return same

    def _yield(self, outlook: "Outlook", pair: Pair, waits: Collection[int]) -> list[Pair]:
        """(who waits, for whom) of two that would meet."""
        i, j = pair
        both = [(i, j), (j, i)]
        if waiting := [each for each in both if each[0] in waits]:
            return [(b, a) for a, b in waiting]
        alone = [each for each in both if outlook.meet(pair, {each[0]}) > LOOKAHEAD_STEPS]
        if len(alone) < 2:
            return alone or both
        late = outlook.enters(pair)
        return [max(both, key=lambda each: (self._waited[each[0]], late[each[0]], each[0]))]

    # how

    def _slowed(self, outlook: "Outlook", agent: int, waits: Collection[int]) -> float:
        """The share of its next step that an arm still goes that slows down. 0 where it stops at once."""
        step_rad = float(np.abs((outlook.ahead[agent][0] - self._given[agent - 1])[:ARM_JOINTS]).max())
        left_rad = float(self._strides_rad[agent - 1]) - SLOWING_RAD_S2 * CONTROL_DT_S**2
        if left_rad <= 0 or step_rad == 0 or not outlook.room_to_slow_down(agent, waits):
            return 0.0
        return min(left_rad / step_rad, 1.0)

    def _remember(
        self, scene: Scene, outlook: "Outlook", commands: NDArray[np.float64], waits: Collection[int]
    ) -> None:
        moved = np.abs(commands - self._given)[:, :ARM_JOINTS].max(axis=1)
        for agent in self._task.agents:
            trail = self._trails[agent]
            if agent in self._back:
                if agent not in waits:
                    self._back[agent] = self._back[agent][1:]
                    trail.pop()
            elif moved[agent - 1] > 0:
                trail.append(self._given[agent - 1].copy())
        self._known = {
            agent: (rows[1:], scene.held[agent - 1])
            for agent, rows in outlook.ahead.items()
            if agent not in waits
        }
        self._given, self._strides_rad = commands, moved

    def _moves_on(self, agent: int, waits: bool) -> bool:
        """Whether an agent is to predict anew. Ends and begins its drawing back."""
        if agent in self._back:
            self._waited[agent] += waits
            if len(self._back[agent]) and self._waited[agent] < PATIENCE_STEPS:
                return False
            del self._back[agent]
            self._waited[agent] = 0
            return True
        self._waited[agent] = self._waited[agent] + 1 if waits else max(0, self._waited[agent] - 1)
        if not waits or self._waited[agent] % PATIENCE_STEPS:
            return False
        if self._waited[agent] % (2 * PATIENCE_STEPS) or self._back or not self._trails[agent]:
            return True
        way = np.array(self._trails[agent])[::-1]
        way[:, ARM_JOINTS] = self._given[agent - 1, ARM_JOINTS]  # the hand stays as it is
        self._back[agent] = way
        self._waited[agent] = 0
        return False


class Outlook:
    """What all agents are about to do, from where they were sent last.

    The path of an agent: where it stands (twice, so that its first position is one of standing still), its
    commands ahead, and its end once more. Its load goes with its hand, also behind a command that opens it:
    until then it holds them.
    """

    def __init__(
        self, task: Task, scene: Scene, given: NDArray[np.float64], ahead: Mapping[int, Commands]
    ) -> None:
        self.ahead = ahead
        self._task, self._scene, self._given = task, scene, given
        self._bodies = Bodies(task, scene)
        self._swept: dict[int, Swept] = {}
        self._diagrams: dict[Pair, NDArray[np.bool_]] = {}

    def held(self, agent: int) -> str | None:
        return self._scene.held[agent - 1]

    def holding_with(self, agent: int) -> list[int]:
        """An agent, and those that hold the same thing."""
        load = self.held(agent)
        return [
            each
            for each in self._task.agents
            if each == agent or (load is not None and load == self.held(each))
        ]

    def meet(self, pair: Pair, waits: Collection[int] = ()) -> float:
        """The first control step from now after which two are closer than the margin; inf without one.

        Who waits stands still.
        """
        diagram = self.diagram(pair)
        steps = np.arange(1, max(map(len, map(self.ahead.__getitem__, pair))) + TRAILS_STEPS + 1)
        hit = np.zeros(len(steps), dtype=bool)
        for late in range(TRAILS_STEPS + 1):
            for behind in ((late, 0), (0, late)):
                at = [
                    self._at(agent, steps - by, agent in waits)
                    for agent, by in zip(pair, behind, strict=True)
                ]
                hit |= diagram[at[0], at[1]]
        return float(steps[hit.argmax()]) if hit.any() else inf

    def enters(self, pair: Pair) -> dict[int, int]:
        """Agent -> the first position on its path that the other one's path comes too close to."""
        diagram = self.diagram(pair)
        return {agent: int(diagram.any(axis=axis).argmax()) for agent, axis in zip(pair, (1, 0), strict=True)}

    def room_to_slow_down(self, agent: int, waits: Collection[int]) -> bool:
        """Whether the whole next step of an agent is clear of all others, whatever they do soon."""
        for other in self._task.agents:
            if other == agent:
                continue
            pair = (min(agent, other), max(agent, other))
            diagram = self.diagram(pair) if agent < other else self.diagram(pair).T
            end = 3 if other in waits else LOOKAHEAD_STEPS + 2
            if diagram[1:3, :end].any():
                return False
        return True

    def diagram(self, pair: Pair) -> NDArray[np.bool_]:
        """(P, Q) which positions on the paths of two are closer than the margin."""
        if pair not in self._diagrams:
            a, b = map(self._body, pair)
            now_m = _apart_m(a, b, 0, 0)
            if now_m >= AGENT_MARGIN_M:
                found = closer_than(a, b, AGENT_MARGIN_M)
            else:  # who lacks the margin already may go apart
                found = np.zeros((len(a), len(b)), dtype=bool)
                for row, column in ((0, 2), (2, 0), (2, 2)):
                    closer = _apart_m(a, b, row, column) < now_m - CLOSER_M
                    found[_from(row), _from(column)] = closer
            self._diagrams[pair] = found
        return self._diagrams[pair]

    def _at(self, agent: int, steps: NDArray[np.int64], waits: bool) -> NDArray[np.int64]:
        """Positions on the path of an agent after control steps."""
        return np.zeros_like(steps) if waits else np.clip(steps, 0, len(self.ahead[agent]) + 1) + 1

    def _body(self, agent: int) -> Swept:
        if agent not in self._swept:
            row = agent - 1
            given, ahead = self._given[row], self.ahead[agent]
            path = np.concatenate([[given, given], ahead, ahead[-1:]])
            measured = self._scene.qpos[row]
            # never narrower than it is now: fingers may need longer than this to close
            wide = (path[:, ARM_JOINTS:] + 1.0) / 2.0 * FINGERS_OPEN_M
            fingers = np.maximum.accumulate(np.maximum(wide, measured[ARM_JOINTS:].max()), axis=0)
            qpos = np.hstack([path[:, :ARM_JOINTS], fingers, fingers])
            load = self.held(agent)
            grip = None
            if load is not None:
                grip = inverse(self._bodies.arms[row].tcp(measured)) @ self._scene.poses[load]
            self._swept[agent] = self._bodies.arm(
                agent, qpos, carries=load, tcp_from_object=grip, touches=self._task.objects
            )
        return self._swept[agent]


def _apart_m(a: Swept, b: Swept, row: int, column: int) -> float:
    found = nearest(a, b, np.array([[row, column]]))
    assert found is not None  # links must always keep apart
    return found.distance_m


def _from(position: int) -> slice:
    """The positions of going on, or those of standing still."""
    return slice(position, None) if position else slice(0, 2)
