"""The verbs of subgoals: what each needs, how it is written, and its synonyms.

One table for plans, for parsing subgoals and sentences, and for the prompt. A verb from outside of the
package is added with `add_verb`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Literal

from rf_exp.errors import ArgumentError

Part = Literal["object", "point", "target", "target_point", "height_m"]
PARTS: Mapping[Part, str] = {  # part -> its place in the form of a subgoal
    "object": "OBJECT",
    "point": "at POINT",
    "target": "to TARGET",
    "target_point": "at POINT",
    "height_m": "by H m",
}


@dataclass(frozen=True)
class AmbiguousSynonym:
    """A synonym that means its verb only in some sentences; others are refused."""

    word: str  # its five forms, as in `Verb.words`
    advice: str  # for the error: why it is not clear for {object}, and what to write instead
    object_suffix: str = ""  # it means the verb for objects of this name, such as lid or pot_lid
    contact: bool = False  # it means the verb where a sentence gives a point or a direction of contact


@dataclass(frozen=True)
class Verb:
    """A verb of subgoals.

    `words` are its synonyms, the first the verb itself, each as base form, third person, past, past
    participle and -ing form, with underscores for spaces. `ambiguous` ones mean it only in some sentences.
    """

    name: str
    needs: tuple[Part, ...] = ()
    may_have: tuple[Part, ...] = ()
    meets: str | None = None  # the kind of the interaction points at which it is done
    words: tuple[str, ...] = ()
    ambiguous: tuple[AmbiguousSynonym, ...] = ()

    def __post_init__(self) -> None:
        for synonym in (*self.words, *(entry.word for entry in self.ambiguous)):
            if len(synonym.split()) != 5:
                raise ArgumentError(
                    f"verb {self.name!r}: {synonym!r} has {len(synonym.split())} forms; expected base, third "
                    "person, past, past participle and -ing form"
                )

    @property
    def form(self) -> str:
        """How a subgoal with it is written, e.g. `carry OBJECT to TARGET [at POINT] [by H m]`."""
        places = {part: f"[{place}]" if part in self.may_have else place for part, place in PARTS.items()}
        return " ".join(
            [self.name, *(places[part] for part in PARTS if part in (*self.needs, *self.may_have))]
        )

    @property
    def is_contact(self) -> bool:
        """Whether a gripper makes contact at an annotated point."""
        return self.meets in CONTACT_KINDS

    def ambiguous_synonym(self, word: str) -> AmbiguousSynonym | None:
        """The `AmbiguousSynonym` of a word; None for one that always means the verb."""
        return next((entry for entry in self.ambiguous if word in _forms(entry.word)), None)

    @cached_property
    def forms(self) -> tuple[tuple[str, ...], ...]:
        """The five forms of every synonym."""
        return tuple(map(_forms, (*self.words, *(entry.word for entry in self.ambiguous))))

    @property
    def all_forms(self) -> list[str]:
        """Every form of every synonym."""
        return [form for forms in self.forms for form in forms]

    @property
    def finite_forms(self) -> list[str]:
        """Every form of every synonym but the -ing forms."""
        return [form for forms in self.forms for form in forms[:4]]

    @property
    def third_person(self) -> str:
        return self.forms[0][1]

    @property
    def gerund(self) -> str:
        return self.forms[0][4]


def _forms(synonym: str) -> tuple[str, ...]:
    return tuple(form.replace("_", " ") for form in synonym.split())


CONTACT_KINDS = ("grasp", "press", "shut")  # of interaction points that a gripper meets

_VERBS: dict[str, Verb] = {}
VERBS: Mapping[str, Verb] = MappingProxyType(_VERBS)


def add_verb(verb: Verb) -> None:
    """Registers a verb. Raises ArgumentError where its name or a synonym means another one."""
    verb_of_word = {word: other.name for other in _VERBS.values() for word in other.all_forms}
    for word in (verb.name, *verb.all_forms):
        if word in verb_of_word or word in _VERBS:
            raise ArgumentError(
                f"verb {verb.name!r}: {word!r} is a word for {verb_of_word.get(word, word)!r} already"
            )
    _VERBS[verb.name] = verb


_PICK_ADVICE = "is not clear: to pick up {object} is to grasp and to lift it; say 'grasp' or 'lift'"
_TAKE_ADVICE = "is not clear: to take {object} may be to grasp it or to carry it off; say 'grasp' or 'carry'"
_OPEN_ADVICE = "is not clear: of a lid, to open is to lift it; say what is lifted in place of {object}"
_REMOVE_ADVICE = "is not clear: to remove {object} is to take it off and away; say 'lift', 'carry' or 'place'"
_PUSH_ADVICE = (
    "is not clear: to push {object} may be to press on it or to shift it; say 'press' for the former"
)

for _verb in (
    Verb(
        "grasp",
        needs=("object", "point"),
        meets="grasp",
        words=(
            "grasp grasps grasped grasped grasping",
            "grip grips gripped gripped gripping",
            "grab grabs grabbed grabbed grabbing",
            "seize seizes seized seized seizing",
        ),
        ambiguous=(
            AmbiguousSynonym("pick picks picked picked picking", _PICK_ADVICE, contact=True),
            AmbiguousSynonym("pick_up picks_up picked_up picked_up picking_up", _PICK_ADVICE, contact=True),
            AmbiguousSynonym("take takes took taken taking", _TAKE_ADVICE, contact=True),
        ),
    ),
    Verb(
        "lift",
        needs=("object", "height_m"),
        words=(
            "lift lifts lifted lifted lifting",
            "lift_up lifts_up lifted_up lifted_up lifting_up",
            "raise raises raised raised raising",
            "elevate elevates elevated elevated elevating",
        ),
        ambiguous=(
            AmbiguousSynonym("open opens opened opened opening", _OPEN_ADVICE, object_suffix="lid"),
            AmbiguousSynonym("remove removes removed removed removing", _REMOVE_ADVICE),
        ),
    ),
    Verb(
        "carry",
        needs=("object", "target"),
        may_have=("target_point", "height_m"),
        words=(
            "carry carries carried carried carrying",
            "transport transports transported transported transporting",
            "bring brings brought brought bringing",
            "move moves moved moved moving",
        ),
    ),
    Verb(
        "place",
        needs=("object", "target"),
        may_have=("target_point",),
        words=(
            "place places placed placed placing",
            "put puts put put putting",
            "put_down puts_down put_down put_down putting_down",
            "lay lays laid laid laying",
            "lay_down lays_down laid_down laid_down laying_down",
            "set sets set set setting",
            "set_down sets_down set_down set_down setting_down",
            "stack stacks stacked stacked stacking",
            "insert inserts inserted inserted inserting",
        ),
    ),
    Verb(
        "strike",
        needs=("object", "point", "target"),
        may_have=("target_point",),
        meets="tool",
        words=(
            "strike strikes struck struck striking",
            "hit hits hit hit hitting",
            "hammer hammers hammered hammered hammering",
        ),
    ),
    Verb(
        "press",
        needs=("object", "point"),
        meets="press",
        words=("press presses pressed pressed pressing", "click clicks clicked clicked clicking"),
        ambiguous=(AmbiguousSynonym("push pushes pushed pushed pushing", _PUSH_ADVICE, contact=True),),
    ),
    Verb(
        "shut",
        needs=("object", "point"),
        meets="shut",
        words=(
            "shut shuts shut shut shutting",
            "sweep_shut sweeps_shut swept_shut swept_shut sweeping_shut",
            "swing_shut swings_shut swung_shut swung_shut swinging_shut",
        ),
    ),
    Verb(
        "release",
        needs=("object",),
        words=(
            "release releases released released releasing",
            "drop drops dropped dropped dropping",
            "let_go_of lets_go_of let_go_of let_go_of letting_go_of",
        ),
    ),
    Verb("home"),
    Verb("aside"),
    Verb("hold", words=("hold holds held held holding",)),
):
    add_verb(_verb)
