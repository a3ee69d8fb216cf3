"""A Question as messages to a language model (paper, supplementary A: system prompt and inputs)."""

from collections.abc import Iterator

import numpy as np

from rf_exp.datagen.brain.chat.exchanges import Message
from rf_exp.datagen.brain.prompts import filled, listed
from rf_exp.datagen.brain.protocol import Question
from rf_exp.datagen.brain.sight import Sight
from rf_exp.statements import samples, subgoal_forms
from rf_exp.transforms import Matrix


def constraint_forms() -> str:
    """Sentences that are understood: some of every kind."""
    return listed(sample.sentence for sample in samples())


def messages(question: Question, sight: Sight | None) -> tuple[Message, Message]:
    """The system prompt, and what is known of the present scene, with the pictures that are to be seen."""
    task, scene = question.task, question.scene
    system = filled("propose", subgoals=listed(subgoal_forms()), constraints=constraint_forms())
    text = filled(
        "question",
        title=task.title,
        description=task.description,
        target=task.target_condition,
        agents=listed(_agents(question)),
        objects=listed(_objects(question)),
        places=listed(f"{name}: {_at(pose)}" for name, pose in task.places(scene).items()),
        previous=listed(f"Agent_{subgoal.agent}: {subgoal.text}" for subgoal in question.previous),
        feedback=listed(f"{violation.check}: {violation.sentence}" for violation in question.feedback),
    )
    pictures = {} if sight is None else sight.jpegs(question.images, len(task.agents))
    return Message("system", system), Message("user", text, pictures)


def _agents(question: Question) -> Iterator[str]:
    for agent, robot, held in zip(
        question.task.agents, question.task.robots, question.scene.held, strict=True
    ):
        yield (
            f"Agent_{agent}: base at ({robot.x_m:.2f}, {robot.y_m:.2f}), facing {robot.yaw_deg:.0f} deg; "
            f"holds {held or 'nothing'}"
        )


def _objects(question: Question) -> Iterator[str]:
    task = question.task
    for name, pose in question.scene.poses.items():
        asset = task.asset(name)
        size_m = np.ptp(asset.bounds_m, axis=0)
        yaw_deg = np.round(np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))) + 0.0
        kind = "a mark on the table" if asset.ghost else "fixed" if asset.static else "movable"
        yield (
            f"{name}: {_at(pose)}, turned {yaw_deg:.0f} deg, "
            f"{size_m[0]:.2f} x {size_m[1]:.2f} x {size_m[2]:.2f} m, {kind}"
        )
        for label, point in asset.points.items():
            world_from_tcp = pose @ point.object_from_tcp
            along = ", ".join(f"{value:.1f}" for value in np.round(world_from_tcp[:3, 2], 1) + 0.0)
            yield f"{name}, point {label}: to {point.kind}, {_at(world_from_tcp)}, along ({along})"


def _at(pose: Matrix) -> str:
    # Adding zero turns -0.0 into 0.0, so that noise around zero does not change the text.
    x, y, z = np.round(pose[:3, 3], 3) + 0.0
    return f"at ({x:.3f}, {y:.3f}, {z:.3f})"
