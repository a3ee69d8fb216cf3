"""Workcell: arms in a third-party ManiSkill environment, to read, plan, check, schedule and execute."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint

from rf_exp.datagen import Planned, Planner, Settings, as_commanded, commands_of, drive, follow
from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
from rf_exp.errors import ArgumentError, RfError, choices
from rf_exp.findings import CheckName, Violation, agent_name
from rf_exp.library.reading import GREY, ReadRobot, ReadTask, asset_of, upright_frame
from rf_exp.sim import Arm, Stepped, Stock
from rf_exp.statements import Proposal, Statement, read, read_subgoal
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset, InteractionPoint, Part
from rf_exp.transforms import Matrix
from rf_exp.types import ConstraintSet, JointLimits, Scene, Subgoal

FULL = ConstraintSet("full")
SETTLE_STEPS = 20  # control steps to hold still after a plan, for placed objects to settle
ON_M = 0.005  # largest gap between an object and the one on which it stands

Subgoals = Mapping[int, Iterable[str | Subgoal]]  # agent -> its subgoals, in this order


class NoPlan(RfError):
    """No plan satisfies the constraints and checks; `violation` is the first reason."""

    def __init__(self, violation: Violation) -> None:
        super().__init__(f"{violation.check}: {violation.sentence}")
        self.violation = violation


@dataclass(frozen=True)
class Execution:
    """Result of the execution of a plan."""

    scene: Scene  # at the end
    steps: int  # control steps since the start
    violation: Violation | None  # found by the monitor, which stopped the execution
    terminated: bool  # by the environment
    truncated: bool
    info: Mapping[str, Any] = field(default_factory=dict)  # of the environment's last step

    @property
    def success(self) -> bool:
        """The environment's `info["success"]`, False where it has none."""
        return bool(self.info.get("success", False))

    @property
    def reason(self) -> str:
        """Reason of a failure in words; empty for success."""
        if self.success:
            return ""
        if self.violation is not None:
            return self.violation.sentence
        if self.truncated:
            return "the environment cut the episode off"
        if "success" not in self.info:
            return "the plan was carried out; the environment does not say what success is"
        missing = [name for name, holds in self.info.items() if name != "success" and _is_false(holds)]
        return f"the plan was carried out, but the environment says no success: not {', '.join(missing)}"

    def __str__(self) -> str:
        return f"{'success' if self.success else 'failure'} after {self.steps} steps {self.reason}".strip()


class Saying:
    """RoboBrain that answers every question with a given proposal."""

    def __init__(self, proposal: Proposal) -> None:
        self.name, self._proposal = "said", proposal

    def answer(self, question: Question) -> str:
        return to_json(self._proposal)


class Driven:
    """Driver of an environment by commands, until it ends its episode; poses are in the objects' frames."""

    def __init__(self, stock: Stock, frames: Mapping[str, Matrix]) -> None:
        """`frames`: object -> body_from_object (4, 4)."""
        self._stock, self._frames = stock, frames
        self.told: NDArray[np.float64] | None = None  # (N, A) the last command
        self.last: Stepped | None = None  # result of the last step of a plan

    @property
    def scene(self) -> Scene:
        """The scene measured now."""
        scene = self._stock.scene()
        return replace(scene, poses={name: pose @ self._frames[name] for name, pose in scene.poses.items()})

    @property
    def over(self) -> bool:
        """Whether the environment has ended its episode."""
        return self.last is not None and (self.last.terminated or self.last.truncated)

    def take(self, command: NDArray[np.float64]) -> None:
        """Run one control step."""
        self.told, self.last = command, self._stock.step(command)


class Workcell:
    """A scene with one or more arms. Agents are numbered from 1, in the environment's order of robots.

    Every actor, and every link of an articulation that is no arm, is an object. Its frame has z up and its
    origin on its underside, in the state in which it was read. Graspable objects have the point `center` (a
    grasp from above), flat-topped ones the place point `top`, those without collision shapes (such as a goal)
    the place point `middle`. Bodies below z = 0 are the table.
    """

    def __init__(
        self,
        env: Any,
        *,
        points: Mapping[str, Mapping[str, InteractionPoint]] | None = None,
        places: Mapping[str, Matrix] | None = None,
        ignore: Collection[str] = (),
        constraint_set: ConstraintSet = FULL,
        limits: JointLimits | None = None,
    ) -> None:
        """Reads the scene of an environment that has been reset.

        `points` are further interaction points, object -> name -> point in the frame of the object; `places`
        named target poses (4, 4) of object frames in the world; `ignore` objects that planners do not see.
        `constraint_set` selects the constraints. Raises ArgumentError for an environment that is not
        supported, for unknown objects, and for places with the name of an object.
        """
        self._stock = Stock(env, ignore)
        poses = self._stock.poses()
        given = points or {}
        for name in given:
            if name not in poses:
                raise choices("object in points:", name, poses)
        for name in places or {}:
            if name in poses:
                raise ArgumentError(f"place {name!r} has the name of an object; call it another name")
        bodies = self._stock.bodies
        frames = {name: upright_frame(body.solids, poses[name]) for name, body in bodies.items()}
        self._arms = Driven(self._stock, frames)
        assets = {
            name: asset_of(name, body.solids, frames[name], body.movable, body.mass_kg, given.get(name, {}))
            for name, body in bodies.items()
        }
        robots = tuple(map(_robot, self._stock.arms))
        name = type(getattr(env, "unwrapped", env)).__name__
        below = _below(assets, self.scene().poses)
        self.task: Task = ReadTask.of(name, robots, assets, dict(places or {}), below)
        changes = {} if limits is None else {"limits": limits}
        # A placeholder for the brain: `plan` uses one of its own for each proposal.
        self._settings = Settings.configured(self.task, constraint_set, ScriptedSpec(), **changes)

    def __str__(self) -> str:
        arms = zip(self.task.agents, self._stock.arms, strict=True)
        lines = [f"{agent_name(agent)}: {arm.name} at {_at(arm.world_from_base)}" for agent, arm in arms]
        for name, pose in self.scene().poses.items():
            points = [f"{point} ({found.kind})" for point, found in self.task.asset(name).points.items()]
            lines.append(f"{name} at {_at(pose)}: {', '.join(points) or 'no interaction points'}")
        lines += [f"{name} at {_at(pose)}: a place" for name, pose in self.task.places(self.scene()).items()]
        return "\n".join([*lines, f"the table: {', '.join(self._stock.table) or 'z = 0'}"])

    def scene(self) -> Scene:
        """The scene measured now; poses are those of the objects' frames."""
        return self._arms.scene

    def plan(
        self, subgoals: Subgoals, constraints: Iterable[str | Statement] = (), *, seed: int = 0
    ) -> Planned:
        """A plan from the present scene that has passed its checks.

        Subgoals and constraints are sentences or values, see docs/constraints.md. Collisions are always
        excluded. The same seed gives the same plan. Raises ArgumentError for sentences that are not
        understood, for unknown names and without any subgoal, and NoPlan where no plan is found.
        """
        proposal = self._proposal(subgoals, constraints)
        planner = Planner(self._settings, Saying(proposal))
        scene = as_commanded(self.scene(), self._arms.told)
        made = planner.plan(Question(self.task, scene, {}), scene, np.random.default_rng(seed))
        if made is None:
            raise ArgumentError("there are no subgoals; expected one for some agent")
        if isinstance(made, Violation):
            if made.check in (CheckName.BRAIN, CheckName.CODE):
                raise ArgumentError(made.refusal)
            raise NoPlan(made)
        return made

    def execute(self, plan: Planned, *, settle_steps: int = SETTLE_STEPS) -> Execution:
        """Executes a plan that was made for the present scene, monitored at every control step.

        Ends when the environment ends its episode, after a violation, or after the plan and `settle_steps` of
        holding still. After a violation the arms first come to rest. Raises ArgumentError for a plan that
        does not start at the present step.
        """
        begins, made = self._stock.scene().step, plan.checked.plan
        if made.task is not self.task or made.scene.step != begins:
            raise ArgumentError(
                f"the plan is for step {made.scene.step} of {made.task.name}, and this is step {begins} of "
                f"{self.task.name}; plan again"
            )
        self._arms.last, commands = None, commands_of(plan)
        violation = drive(self._arms, commands, plan.checked.monitor(), self._settings.limits)
        if violation is None:
            follow(self._arms, np.tile(commands[-1], (settle_steps, 1, 1)))
        last = self._arms.last
        ended = (last.terminated, last.truncated, last.info) if last is not None else (False, False, {})
        scene = self.scene()
        return Execution(scene, scene.step - begins, violation, *ended)

    def _proposal(self, subgoals: Subgoals, constraints: Iterable[str | Statement]) -> Proposal:
        words = self.task.vocabulary
        found = []
        for agent, lines in subgoals.items():
            words.agent(agent, "subgoals")
            for line in [lines] if isinstance(lines, str) else lines:
                text = line.text if isinstance(line, Subgoal) else line
                found.append(read_subgoal(agent, text, words))
        stated = [
            read(each, words) if isinstance(each, str) else each.known_in(words) for each in constraints
        ]
        return Proposal(tuple(found), tuple(stated))


def _robot(arm: Arm) -> ReadRobot:
    x_m, y_m = arm.world_from_base[:2, 3].tolist()
    yaw_deg = float(np.degrees(np.arctan2(arm.world_from_base[1, 0], arm.world_from_base[0, 0])))
    parts = tuple(Part(solid, GREY) for solid in arm.mounted)
    on_hand = Asset(f"on the hand of {arm.name}", parts) if parts else None
    return ReadRobot(x_m, y_m, yaw_deg, arm.rest_rad, arm.robot, pose=arm.world_from_base, on_hand=on_hand)


def _below(assets: Mapping[str, Asset], poses: Mapping[str, Matrix]) -> dict[str, str]:
    corners = {name: asset.vertices(poses[name]) for name, asset in assets.items() if asset.hulls}
    outlines = {name: MultiPoint(each[:, :2]).convex_hull for name, each in corners.items()}
    return {
        name: other
        for name, other in permutations(corners, 2)
        if abs(corners[name][:, 2].min() - corners[other][:, 2].max()) < ON_M
        and outlines[name].intersects(outlines[other])
    }


def _is_false(value: Any) -> bool:
    return str(getattr(value, "dtype", type(value).__name__)).endswith("bool") and not bool(value)


def _at(pose: Matrix) -> str:
    x, y, z = np.round(pose[:3, 3], 3) + 0.0
    return f"({x:g}, {y:g}, {z:g})"
