"""The RoboBrain that needs no network: the plan written in the task's module."""

from rf_exp.datagen.brain.protocol import Question, to_json


class ScriptedBrain:
    """Answers with the task's own plan for the present scene."""

    name = "scripted"

    def answer(self, question: Question) -> str:
        return to_json(question.task.module.plan(question.scene, question.task))
