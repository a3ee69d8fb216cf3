"""Logical: where a gripper meets and where it puts an object (paper, section 3.2, interaction position)."""

from dataclasses import dataclass

from rf_exp.statements.language.base import Names, OneAgentStatement, Statement, Words, agent_name
from rf_exp.statements.language.verbs import CONTACT_KINDS, VERBS

POINT_USES = {"place": "what is put on it", "drop": "what is put into it", "tool": "the work of the tool"}


@dataclass(frozen=True)
class ContactAt(OneAgentStatement):
    """Interaction position: the gripper of an agent meets an object at an annotated point."""

    kind = "logical"
    patterns = (
        r"{agent} (?:{must} )?{verb} {object} (?:at|by|on) (?:its |the )?{point}",
        r"{agent} (?:{must} )?{verb} (?:the |its ){point} of {object}",
    )

    verb: str  # one that meets a point: grasp, press, shut
    object: str
    point: str

    @property
    def names(self) -> Names:
        return ((self.object, self.point),)

    @property
    def sentence(self) -> str:
        return f"{agent_name(self.agent)} must {self.verb} {self.object} at its {self.point} point."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agent, name, verb = words.agent(), words.object(), words.verb(contact=True) or ""
        point = words.point(name)
        kind = words.vocabulary.points[name][point]
        if kind not in CONTACT_KINDS:
            raise words.error(
                f"is not possible: {point} of {name} is for {POINT_USES[kind]}, not for a gripper"
            )
        if VERBS[verb].meets != kind:
            raise words.error(f"is not possible: the {point} point of {name} is to {kind}, not to {verb}")
        return cls(agent, verb, name, point)


@dataclass(frozen=True)
class PlaceAt(OneAgentStatement):
    """Place position: an agent puts an object at an annotated point of another one."""

    kind = "logical"
    patterns = (r"{agent} {must} {verb} {object} (?:at|on|in|into) (?:the )?{point} of {object target}",)

    object: str
    target: str
    point: str

    @property
    def names(self) -> Names:
        return (self.object, None), (self.target, self.point)

    @property
    def sentence(self) -> str:
        agent = agent_name(self.agent)
        return f"{agent} must place {self.object} at the {self.point} point of {self.target}."

    @classmethod
    def from_words(cls, words: Words) -> Statement:
        agent, name, target = words.agent(), words.object(), words.object("target")
        point = words.point(target)
        if words.verb() != "place":
            raise words.error(f"is not possible: to {words.verb()} {name} is not to place it")
        if (kind := words.vocabulary.points[target][point]) in CONTACT_KINDS:
            raise words.error(f"is not possible: the {point} point of {target} is to {kind}")
        return cls(agent, name, target, point)


ContactAt.samples = (ContactAt(1, "grasp", "barrier", "left"),)
PlaceAt.samples = (PlaceAt(1, "steak", "pot", "inside"),)
