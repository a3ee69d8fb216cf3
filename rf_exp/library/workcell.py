"""Workcell: arms in a third-party ManiSkill environment, to read, plan, check, schedule and execute."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint

from rf_exp.datagen import (
    Planned,
    Planner,
    Settings,
    at_last_command,
    execute_commands,
    execute_monitored,
    plan_commands,
)
from rf_exp.datagen.brain import Question, ScriptedSpec, to_json
from rf_exp.errors import ArgumentError, RfError, unknown_choice
from rf_exp.findings import CheckName, Violation, agent_name
from rf_exp.library.reading import GREY, ReadRobot, ReadTask, asset_of, upright_frame
from rf_exp.sim import Arm, StepResult, ThirdPartyEnvironment
from rf_exp.statements import Proposal, Statement, read, read_subgoal
from rf_exp.tasks import Task
from rf_exp.tasks.assets import Asset, InteractionPoint, Part
from rf_exp.transforms import Matrix
from rf_exp.types import ConstraintSet, JointLimits, Scene, Subgoal

FULL = ConstraintSet("full")
SETTLE_STEPS = 20  # control steps to hold still after a plan, for placed objects to settle
SUPPORT_GAP_M = 0.005  # largest gap between an object and the one on which it stands

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
            return "the environment truncated the episode"
        if "success" not in self.info:
            return "the plan was executed; the environment does not report success"
        missing = [name for name, holds in self.info.items() if name != "success" and _is_false(holds)]
        return f"the plan was executed, but the environment reports no success: not {', '.join(missing)}"

    def __str__(self) -> str:
        return f"{'success' if self.success else 'failure'} after {self.steps} steps {self.reason}".strip()


class FixedBrain:
    """RoboBrain that answers every question with a given proposal."""

    def __init__(self, proposal: Proposal) -> None:
        self.name, self._proposal = "said", proposal

    def answer(self, question: Question) -> str:
        return to_json(self._proposal)


class EnvironmentDriver:
    """Driver of an environment by commands, until it ends its episode; poses are in the objects' frames."""

    def __init__(self, environment: ThirdPartyEnvironment, frames: Mapping[str, Matrix]) -> None:
        """`frames`: object -> body_from_object (4, 4)."""
        self._environment, self._frames = environment, frames
        self.last_command: NDArray[np.float64] | None = None  # (N, A) the last command
        self.last_result: StepResult | None = None  # result of the last step of a plan

    @property
    def scene(self) -> Scene:
        """The scene measured now."""
        scene = self._environment.scene()
        return replace(scene, poses={name: pose @ self._frames[name] for name, pose in scene.poses.items()})

    @property
    def finished(self) -> bool:
        """Whether the environment has ended its episode."""
        return self.last_result is not None and (self.last_result.terminated or self.last_result.truncated)

    def step(self, command: NDArray[np.float64]) -> None:
        """Run one control step."""
        self.last_command, self.last_result = command, self._environment.step(command)


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
        self._environment = ThirdPartyEnvironment(env, ignore)
        poses = self._environment.poses()
        points_by_object = points or {}
        for name in points_by_object:
            if name not in poses:
                raise unknown_choice("object in points:", name, poses)
        for name in places or {}:
            if name in poses:
                raise ArgumentError(f"place {name!r} has the name of an object; call it another name")
        bodies = self._environment.bodies
        frames = {name: upright_frame(body.solids, poses[name]) for name, body in bodies.items()}
        self._arms = EnvironmentDriver(self._environment, frames)
        assets = {
            name: asset_of(
                name, body.solids, frames[name], body.movable, body.mass_kg, points_by_object.get(name, {})
            )
            for name, body in bodies.items()
        }
        robots = tuple(map(_robot, self._environment.arms))
        name = type(getattr(env, "unwrapped", env)).__name__
        below = _below(assets, self.scene().poses)
        self.task: Task = ReadTask.of(name, robots, assets, dict(places or {}), below)
        changes = {} if limits is None else {"limits": limits}
        # A placeholder for the brain: `plan` uses one of its own for each proposal.
        self._settings = Settings.configured(self.task, constraint_set, ScriptedSpec(), **changes)

    def __str__(self) -> str:
        arms = zip(self.task.agents, self._environment.arms, strict=True)
        lines = [f"{agent_name(agent)}: {arm.name} at {_at(arm.world_from_base)}" for agent, arm in arms]
        for name, pose in self.scene().poses.items():
            points = [
                f"{point} ({point_spec.kind})" for point, point_spec in self.task.asset(name).points.items()
            ]
            lines.append(f"{name} at {_at(pose)}: {', '.join(points) or 'no interaction points'}")
        lines += [f"{name} at {_at(pose)}: a place" for name, pose in self.task.places(self.scene()).items()]
        return "\n".join([*lines, f"the table: {', '.join(self._environment.table) or 'z = 0'}"])

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
        planner = Planner(self._settings, FixedBrain(proposal))
        scene = at_last_command(self.scene(), self._arms.last_command)
        result = planner.plan(Question(self.task, scene, {}), scene, np.random.default_rng(seed))
        if result is None:
            raise ArgumentError("there are no subgoals; expected one for some agent")
        if isinstance(result, Violation):
            if result.check in (CheckName.BRAIN, CheckName.CODE):
                raise ArgumentError(result.refusal)
            raise NoPlan(result)
        return result

    def execute(self, plan: Planned, *, settle_steps: int = SETTLE_STEPS) -> Execution:
        """Executes a plan that was made for the present scene, monitored at every control step.

        Ends when the environment ends its episode, after a violation, or after the plan and `settle_steps` of
        holding still. After a violation the arms first come to rest. Raises ArgumentError for a plan that
        does not start at the present step.
        """
        start_step, checked_plan = self._environment.scene().step, plan.checked.plan
        if checked_plan.task is not self.task or checked_plan.scene.step != start_step:
            raise ArgumentError(
                f"the plan is for step {checked_plan.scene.step} of {checked_plan.task.name}, and this is "
                f"step {start_step} of {self.task.name}; plan again"
            )
        self._arms.last_result, commands = None, plan_commands(plan)
        violation = execute_monitored(self._arms, commands, plan.checked.monitor(), self._settings.limits)
        if violation is None:
            execute_commands(self._arms, np.tile(commands[-1], (settle_steps, 1, 1)))
        last = self._arms.last_result
        final_state = (last.terminated, last.truncated, last.info) if last is not None else (False, False, {})
        scene = self.scene()
        return Execution(scene, scene.step - start_step, violation, *final_state)

    def _proposal(self, subgoals: Subgoals, constraints: Iterable[str | Statement]) -> Proposal:
        vocabulary = self.task.vocabulary
        subgoal_values = []
        for agent, sentences in subgoals.items():
            vocabulary.agent(agent, "subgoals")
            for sentence in [sentences] if isinstance(sentences, str) else sentences:
                text = sentence.text if isinstance(sentence, Subgoal) else sentence
                subgoal_values.append(read_subgoal(agent, text, vocabulary))
        statements = [
            read(constraint, vocabulary)
            if isinstance(constraint, str)
            else constraint.checked_against(vocabulary)
            for constraint in constraints
        ]
        return Proposal(tuple(subgoal_values), tuple(statements))


def _robot(arm: Arm) -> ReadRobot:
    x_m, y_m = arm.world_from_base[:2, 3].tolist()
    yaw_deg = float(np.degrees(np.arctan2(arm.world_from_base[1, 0], arm.world_from_base[0, 0])))
    parts = tuple(Part(solid, GREY) for solid in arm.mounted)
    on_hand = Asset(f"on the hand of {arm.name}", parts) if parts else None
    return ReadRobot(x_m, y_m, yaw_deg, arm.rest_rad, arm.robot, pose=arm.world_from_base, on_hand=on_hand)


def _below(assets: Mapping[str, Asset], poses: Mapping[str, Matrix]) -> dict[str, str]:
    corners = {name: asset.vertices(poses[name]) for name, asset in assets.items() if asset.hulls}
    outlines = {name: MultiPoint(points[:, :2]).convex_hull for name, points in corners.items()}
    return {
        name: other
        for name, other in permutations(corners, 2)
        if abs(corners[name][:, 2].min() - corners[other][:, 2].max()) < SUPPORT_GAP_M
        and outlines[name].intersects(outlines[other])
    }


def _is_false(value: Any) -> bool:
    return str(getattr(value, "dtype", type(value).__name__)).endswith("bool") and not bool(value)


def _at(pose: Matrix) -> str:
    x, y, z = np.round(pose[:3, 3], 3) + 0.0
    return f"({x:g}, {y:g}, {z:g})"
