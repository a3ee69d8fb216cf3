"""Constraints that the grammar does not understand, restated by a language model.

The paper lets a model match each constraint to a validator and its parameters. Here it may only say the
constraint again, in a sentence that the grammar knows; the grammar does the matching. What a model
writes is read, never executed.
"""

from dataclasses import replace

from pydantic import BaseModel, ConfigDict, ValidationError

from rf_exp.datagen.brain.chat.exchanges import Chat, Message
from rf_exp.datagen.brain.prompts import filled, listed
from rf_exp.datagen.brain.questions import constraint_forms
from rf_exp.datagen.brain.reading import BadAnswer, read_object
from rf_exp.statements import Proposal, Unread, understood
from rf_exp.tasks import Task


class _Restated(BaseModel):
    model_config = ConfigDict(extra="forbid")
    Sentences: list[str]


def restate(proposal: Proposal, task: Task, chat: Chat) -> Proposal:
    """The proposal with constraints that are not understood said again, in one call for all of them.

    Where the model has no better sentence the constraint stays as it is, and the checker says what is
    wrong with it: a sentence about something that does not exist is no question of wording.
    """
    unclear = [each for each in proposal.constraints if isinstance(each, Unread)]
    if not unclear:
        return proposal
    try:
        text = chat.ask("restate", _messages(unclear, proposal, task), _Restated.model_json_schema())
        sentences = _Restated.model_validate(read_object(text, "Sentences")).Sentences
    except (BadAnswer, ValidationError):
        return proposal
    if len(sentences) != len(unclear):
        return proposal
    better = {
        old: new
        for old, sentence in zip(unclear, sentences, strict=True)
        if not isinstance(new := understood(sentence, task.vocabulary, old.kind, old.agents), Unread)
    }
    stated = (better.get(each, each) if isinstance(each, Unread) else each for each in proposal.constraints)
    return replace(proposal, constraints=tuple(stated))


def _messages(unclear: list[Unread], proposal: Proposal, task: Task) -> tuple[Message, Message]:
    text = filled(
        "unclear",
        objects=listed(f"{name}: {', '.join(task.asset(name).points) or 'none'}" for name in task.objects),
        subgoals=listed(f"Agent_{subgoal.agent}: {subgoal.text}" for subgoal in proposal.subgoals),
        unclear="\n".join(f"{number}. {each.sentence}" for number, each in enumerate(unclear, start=1)),
    )
    return Message("system", filled("restate", constraints=constraint_forms())), Message("user", text)
