"""The sentences in which constraints are stated, and the checks they mean.

A sentence is matched by patterns and never executed. Every form below is one row: an example for the
error message, the pattern in a small notation, and what is built from its parts. The notation:
`{a}` an agent, `{agents}` several, `{verb}`, `{object}`, `{point}`, `{s}` seconds; the rest is a
regular expression. Case, articles and the closing full stop do not matter.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rf_exp.constraints.evidence import Check, agent_name
from rf_exp.constraints.logical import ConsistentHeight, ValidateDirection, ValidateInteraction
from rf_exp.constraints.spatial import ZONE_LIMIT_M, AvoidAgents, AvoidObjects, StayOut
from rf_exp.constraints.temporal import TOGETHER_S, Deadline, Sequential, ShareSpace, Simultaneous, Step
from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks import Task
from rf_exp.types import Constraint, Proposal

CONTACT_KINDS = ("grasp", "press")  # of interaction points, and the verbs that meet them
WORK = {"place": "what is put on it", "drop": "what is put into it", "tool": "the work of the tool"}
MAX_LENGTH = 300  # characters; a constraint is one sentence
MAX_WAIT_S = 600.0

# verb of a subgoal -> stems of the words people use for it
VERBS = {
    "grasp": ("grasp", "grip", "grab", "pick", "take", "seize"),
    "lift": ("lift", "rais", "elevat", "open", "remov"),
    "carry": ("carr", "transport", "bring", "mov"),
    "place": ("plac", "put", "lay", "set", "stack", "insert"),
    "press": ("press", "push", "click"),
    "strike": ("strik", "hit", "hammer"),
    "release": ("releas", "drop", "let go"),
    "hold": ("hold", "keep"),
    "home": ("home", "return"),
    "aside": ("aside", "withdraw"),
}
DIRECTIONS = {
    "perpendicular": "perpendicular",
    "along": "perpendicular",
    "aligned": "perpendicular",
    "vertical": "vertical",
    "down": "vertical",
    "above": "vertical",
    "horizontal": "horizontal",
    "side": "horizontal",
    "level": "level",
}

_AGENT = r"agent[ _]?\d{1,3}"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
_VERB = rf"(?:{'|'.join(stem for stems in VERBS.values() for stem in stems)})[a-z]*(?: up| down| off| of)?"
_NOUN = r"(?!(?:only|after|before|from|at|by|on|in|to|within|and|together)\b)\w+"
_NAME = rf"(?:(?:the|an?|its) )?{_NOUN}(?: {_NOUN})?"
_POINT3 = rf"\( *{_NUMBER} *, *{_NUMBER} *, *{_NUMBER} *\)"
_NOTATION = {
    "{a}": rf"(?P<a>{_AGENT})",
    "{b}": rf"(?P<b>{_AGENT})",
    "{agents}": rf"(?P<agents>{_AGENT}(?:(?:, and |, | and |,){_AGENT})+)",
    "{verb}": rf"(?P<verb>{_VERB})",
    "{verb2}": rf"(?P<verb2>{_VERB})",
    "{object}": rf"(?P<object>{_NAME})",
    "{object2}": rf"(?P<object2>{_NAME})",
    "{point}": r"(?P<point>\w+)",
    "{direction}": rf"(?P<direction>{'|'.join(DIRECTIONS)})\w*",
    "{s}": rf"(?P<s>{_NUMBER}) ?s(?:ec|ecs|econds?)?",
    "{low}": rf"(?P<low>{_POINT3})",
    "{high}": rf"(?P<high>{_POINT3})",
    "{must}": r"(?:must|should|has to|have to|needs? to|can|could|may|will)(?: be able to)?",
    "{not}": r"(?:must not|should not|may not|can ?not|never|must never)",
    "{starts}": r"(?:begins?|starts?|acts?|moves?|proceeds?)",
    "{task}": r"(?:(?:its|the|their) (?:tasks?|actions?|motions?|work))",
}


class Words:
    """The parts of a matched sentence, looked up in the task and the plan."""

    def __init__(
        self, parts: Mapping[str, str | None], text: str, task: Task, proposal: Proposal, stated: Constraint
    ):
        self._parts, self.text, self._task, self._proposal = parts, text, task, proposal
        self._stated = stated

    def agent(self, key: str) -> int:
        return self._known(int(re.sub(r"\D", "", self._parts[key] or "")))

    def agents(self) -> tuple[int, ...]:
        """The agents of the sentence, or where it names none, those the constraint is filed under."""
        listed = self._parts.get("agents")
        numbers = [int(n) for n in re.findall(r"\d+", listed)] if listed else list(self._stated.agents)
        found = tuple(dict.fromkeys(self._known(n) for n in numbers)) or self._task.agents
        if len(found) < 2:
            raise ArgumentError(f"constraint {self.text!r} needs two different agents; it names {len(found)}")
        return found

    def object(self, key: str = "object") -> str:
        name = re.sub(r"^(?:the|a|an|its) ", "", self._parts[key] or "").replace(" ", "_")
        if name not in self._task.objects:
            raise choices(f"object in constraint {self.text!r}:", name, self._task.objects)
        return name

    def point(self, name: str) -> str:
        points = self._task.asset(name).points
        point = self._parts["point"] or ""
        point = {"centre": "center", "middle": "center"}.get(point, point)
        if point not in points:
            raise choices(f"point of {name} in constraint {self.text!r}:", point, points)
        return point

    def kind(self, name: str, point: str) -> str:
        return self._task.asset(name).points[point].kind

    def contacts(self, agent: int, name: str) -> set[str]:
        """The points at which the agent's subgoals meet an object."""
        mine = (each for each in self._proposal.of(agent) if each.object == name)
        return {each.point for each in mine if each.verb in CONTACT_KINDS and each.point}

    def orientation(self) -> str:
        return DIRECTIONS[self._parts["direction"] or ""]

    def step(self, agent: int, verb: str = "verb", name: str = "object") -> Step:
        """The subgoals of an agent that the sentence speaks of; all of them where it names no verb."""
        word = self._parts.get(verb)
        if not word:
            return Step(agent)
        canonical = next(verb for verb, stems in VERBS.items() if word.startswith(stems))
        step = Step(agent, canonical, self.object(name))
        mine = self._proposal.of(agent)
        if not any((subgoal.verb, subgoal.object) == (step.verb, step.object) for subgoal in mine):
            listed = "; ".join(subgoal.text for subgoal in mine) or "none"
            raise ArgumentError(
                f"constraint {self.text!r} speaks of {step.text}, which is no subgoal of "
                f"{agent_name(agent)}; its subgoals: {listed}"
            )
        return step

    def seconds(self, default_s: float | None = None) -> float:
        number = self._parts.get("s")
        value = float(number) if number else default_s
        assert value is not None  # the pattern demands a number where there is no default
        if not 0 <= value <= MAX_WAIT_S:
            raise ArgumentError(
                f"constraint {self.text!r}: {value:g} s is not between 0 and {MAX_WAIT_S:g} s"
            )
        return value

    def zone(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        corners = [[float(n) for n in re.findall(_NUMBER, self._parts[key] or "")] for key in ("low", "high")]
        if max(abs(value) for corner in corners for value in corner) > ZONE_LIMIT_M:
            raise ArgumentError(
                f"constraint {self.text!r}: zones lie within {ZONE_LIMIT_M:g} m of the origin"
            )
        (x0, x1), (y0, y1), (z0, z1) = (sorted(pair) for pair in zip(*corners, strict=True))
        if min(x1 - x0, y1 - y0, z1 - z0) < 1e-3:
            raise ArgumentError(
                f"constraint {self.text!r}: the zone is flat; each side must be at least 1 mm"
            )
        return (x0, y0, z0), (x1, y1, z1)

    def _known(self, agent: int) -> int:
        if agent not in self._task.agents:
            named = [agent_name(known) for known in self._task.agents]
            raise choices(f"agent in constraint {self.text!r}:", agent_name(agent), named)
        return agent


@dataclass(frozen=True)
class Form:
    """One way to state a constraint."""

    example: str
    pattern: re.Pattern[str]
    build: Callable[[Words], Check]


def _form(example: str, notation: str, build: Callable[[Words], Check]) -> Form:
    for token, expression in _NOTATION.items():
        notation = notation.replace(token, expression)
    return Form(example, re.compile(notation), build)


def _interaction(words: Words) -> Check:
    """Contact of the gripper; the agent's own subgoals must mean the same point."""
    agent, name = words.agent("a"), words.object()
    point = words.point(name)
    kind = words.kind(name, point)
    if kind not in CONTACT_KINDS:
        raise ArgumentError(
            f"constraint {words.text!r}: {point} of {name} is for {WORK[kind]}, not for a gripper"
        )
    planned = words.contacts(agent, name)
    if planned and point not in planned:
        raise ArgumentError(
            f"constraint {words.text!r} demands point {point}, but {agent_name(agent)} is to meet {name} at "
            f"{' and '.join(sorted(planned))}; change the subgoal or the constraint"
        )
    return ValidateInteraction(agent, name, point, words.text)


def _placing(words: Words) -> Check:
    words.object()
    name = words.object("object2")
    return ValidateInteraction(words.agent("a"), name, words.point(name), words.text)


def _direction(words: Words) -> Check:
    return ValidateDirection(words.agent("a"), words.object(), words.orientation(), words.text)


def _height(words: Words) -> Check:
    return ConsistentHeight(words.agents(), words.text)


def _simultaneous(words: Words) -> Check:
    steps = tuple(words.step(agent) for agent in words.agents())
    return Simultaneous(steps, words.seconds(TOGETHER_S), words.text)


def _sequential(words: Words) -> Check:
    """a first, then b."""
    first, then = words.agent("a"), words.agent("b")
    return _order(words, words.step(first), words.step(then, "verb2", "object2"))


def _order(words: Words, first: Step, then: Step, wait_s: float = 0.0) -> Check:
    if first.agent == then.agent:
        raise ArgumentError(
            f"constraint {words.text!r} needs two different agents; it names {agent_name(then.agent)}"
        )
    return Sequential(first, then, wait_s, words.text)


def _wait(words: Words) -> Check:
    """a waits after b."""
    return _order(words, words.step(words.agent("b")), Step(words.agent("a")), words.seconds())


def _deadline(words: Words) -> Check:
    return Deadline(words.step(words.agent("a")), words.seconds(), words.text)


def _share(words: Words) -> Check:
    return ShareSpace(words.agents(), words.text)


def _avoid_others(words: Words) -> Check:
    return AvoidAgents((words.agent("a"),), words.text)


def _avoid_pair(words: Words) -> Check:
    a, b = words.agent("a"), words.agent("b")
    if a == b:
        raise ArgumentError(f"constraint {words.text!r} needs two different agents; it names {agent_name(a)}")
    return AvoidAgents(tuple(sorted((a, b))), words.text)


def _avoid_each_other(words: Words) -> Check:
    return AvoidAgents(tuple(sorted(words.agents())), words.text)


def _avoid_objects(words: Words) -> Check:
    return AvoidObjects((words.agent("a"),), words.text)


def _stay_out(words: Words) -> Check:
    return StayOut(words.agent("a"), *words.zone(), words.text)


_WHEN = r"(?: (?:when|while|during|if|to|so that|in order|in the|without|at any|at all).*)?"
_OTHERS = r"(?:any |the |all )?other (?:agents?|arms?|robots?)"
_OBJECTS = r"(?:the |any |other |all )*(?:objects?|obstacles?|environment|surroundings|scene|table)"
_COLLIDE = (
    r"(?:collide with|touch|hit|interfere with|"
    r"intersect(?: with)?(?: the (?:trajectory|trajectories|paths?) of)?)"
)
_TOGETHER = r"(?:simultaneously|at the same time|together|in sync(?:hrony)?|concurrently)"
_WITHIN = r"(?:,? (?:within|to within|at most) {s}(?: of each other| apart)?)?"
_IN_TURN = (
    r"(?:one after the other|one after another|chronologically|in turns?|at different times|sequentially)"
)

FORMS = (
    # logical
    _form(
        "Agent_1 must place steak at the inside point of pot.",
        rf"{{a}} {{must}} (?:place|put|lay|set|insert) {{object}} (?:at|on|in|into) (?:the "
        rf")?{{point}}(?: point| side)? of {{object2}}{_WHEN}",
        _placing,
    ),
    _form(
        "Agent_1 must approach barrier perpendicularly.",
        rf"{{a}} {{must}} (?:approach|grasp|press|reach) {{object}} (?:from (?:the )?)?{{direction}}{_WHEN}",
        _direction,
    ),
    _form(
        "Agent_1 must grasp barrier at its left point.",
        rf"{{a}} (?:{{must}} )?{{verb}} {{object}} (?:at|by|on|from) (?:its |the )?{{point}}(?: "
        rf"(?:interaction |contact |grasp )?(?:point|side|end|part|handle))?(?: of (?:it|the "
        rf"object))?{_WHEN}",
        _interaction,
    ),
    _form(
        "Agent_1 must grasp the left end of barrier.",
        rf"{{a}} (?:{{must}} )?{{verb}} (?:the |its ){{point}} (?:point|side|end|part) of {{object}}{_WHEN}",
        _interaction,
    ),
    _form(
        "The gripper of Agent_1 must be perpendicular to barrier.",
        rf"the (?:gripper|hand) of {{a}} (?:{{must}} (?:be|stay|remain|point|be "
        rf"kept)|is|stays|remains|points) {{direction}}(?: to| with| over| towards?| at| of)? "
        rf"{{object}}{_WHEN}",
        _direction,
    ),
    _form(
        "Agent_1 and Agent_2 must keep a consistent gripper height.",
        rf"{{agents}} (?:{{must}} )?(?:keep|maintain|have|hold) (?:their |the |a "
        rf")?(?:consistent|same|equal|level|identical) (?:gripper )?heights?{_WHEN}",
        _height,
    ),
    _form(
        "Keep the gripper height consistent between Agent_2 and Agent_3.",
        rf"keep (?:the )?gripper heights? (?:of {{agents}} )?(?:consistent|equal|level|the "
        rf"same)(?: (?:between|of|for) (?P<agents2>{_AGENT}(?:(?:, and |, | and "
        rf"|,){_AGENT})+))?{_WHEN}",
        _height,
    ),
    # temporal
    _form(
        "Agent_1 and Agent_2 must lift barrier simultaneously within 0.5 s.",
        rf"{{agents}} (?:both )?(?:{{must}} )?(?:both )?{{verb}} {{object}} {_TOGETHER}{_WITHIN}{_WHEN}",
        _simultaneous,
    ),
    _form(
        "Agent_1 and Agent_2 perform their tasks simultaneously.",
        rf"{{agents}} (?:{{must}} )?(?:perform|do|execute|carry out|start|begin) (?:(?:the|their) "
        rf")?(?:tasks?|actions?|motions?) {_TOGETHER}{_WITHIN}{_WHEN}",
        _simultaneous,
    ),
    _form(
        "Agent_2 must complete its task before Agent_1 begins.",
        rf"{{a}} (?:{{must}} )?(?:completes?|finish(?:es)?|ends?)(?: {{task}})? before {{b}} "
        rf"(?:{{must}} )?{{starts}}(?: {{task}})?{_WHEN}",
        _sequential,
    ),
    _form(
        "Agent_2 must lift lid before Agent_1 may place steak.",
        rf"{{a}} (?:{{must}} )?{{verb}} {{object}} before {{b}} (?:{{must}} )?(?:(?:begin|start)s? "
        rf"to )?{{verb2}} {{object2}}{_WHEN}",
        _sequential,
    ),
    _form(
        "Agent_2 must lift lid before Agent_1 begins.",
        rf"{{a}} (?:{{must}} )?{{verb}} {{object}} before {{b}} (?:{{must}} )?{{starts}}(?: "
        rf"{{task}})?{_WHEN}",
        _sequential,
    ),
    _form(
        "Agent_4 must place steak only after Agent_5 lifts lid.",
        rf"{{b}} (?:{{must}} )?(?:only )?{{verb2}} {{object2}} (?:only )?after {{a}} (?:has |have "
        rf")?{{verb}} {{object}}{_WHEN}",
        _sequential,
    ),
    _form(
        "Agent_1 must wait 2 s after Agent_2 lifts lid.",
        rf"{{a}} (?:{{must}} )?waits? (?:for )?(?:at least )?{{s}} after {{b}} (?:has |have "
        rf")?{{verb}} {{object}}{_WHEN}",
        _wait,
    ),
    _form(
        "Agent_1 must wait 2 s after Agent_2 has finished.",
        rf"{{a}} (?:{{must}} )?waits? (?:for )?(?:at least )?{{s}} after {{b}}(?: (?:has |have |is "
        rf")?(?:finish|complet|end|stop|done)\w*(?: {{task}})?)?{_WHEN}",
        _wait,
    ),
    _form(
        "Agent_1 must finish within 10 s.",
        rf"{{a}} (?:{{must}} )?(?:completes?|finish(?:es)?|ends?|be done)(?: {{task}})? within {{s}}{_WHEN}",
        _deadline,
    ),
    _form(
        "Agent_1 must lift barrier within 10 s.",
        rf"{{a}} (?:{{must}} )?{{verb}} {{object}} within {{s}}{_WHEN}",
        _deadline,
    ),
    _form(
        "Agent_1 and Agent_2 may share the same space one after the other.",
        rf"{{agents}} (?:{{must}} )?(?:share|use|occupy) (?:the )?(?:same |shared "
        rf")?(?:space|area|region) {_IN_TURN}{_WHEN}",
        _share,
    ),
    # spatial
    _form(
        "Agent_1 must stay out of zone (-0.1, 0.2, 0) to (0.1, 0.4, 0.5).",
        rf"{{a}} (?:{{must}} )?(?:stays? out of|keeps? out of|avoids?|not enter|never enter)(?: "
        rf"the)? (?:zone|box|region|area) {{low}} to {{high}}{_WHEN}",
        _stay_out,
    ),
    _form(
        "Avoid collision between Agent_1 and the objects.",
        rf"(?:avoid (?:any )?collisions? (?:between|of) {{a}} (?:and|with) "
        rf"{_OBJECTS}|(?P<a2>{_AGENT}) {{not}} {_COLLIDE} {_OBJECTS}){_WHEN}",
        _avoid_objects,
    ),
    _form(
        "Avoid collision between Agent_1 and other agents.",
        rf"(?:avoid (?:any )?collisions? (?:between|of) {{a}} (?:and|with) "
        rf"{_OTHERS}|(?P<a2>{_AGENT}) {{not}} {_COLLIDE} {_OTHERS}){_WHEN}",
        _avoid_others,
    ),
    _form(
        "Avoid collision between Agent_1 and Agent_2.",
        rf"(?:avoid (?:any )?collisions? between|{{must}} avoid) {{a}} and {{b}}{_WHEN}",
        _avoid_pair,
    ),
    _form(
        "Agent_1 must not occupy the same space as Agent_3.",
        rf"{{a}} {{not}} (?:occupy the same space as|{_COLLIDE}|enter the space of) {{b}}{_WHEN}",
        _avoid_pair,
    ),
    _form(
        "Agents must avoid colliding with each other.",
        rf"(?:(?:all )?agents|{{agents}}) (?:{{must}} avoid (?:colliding|collisions?|contact) with "
        rf"each other|{{not}} collide(?: with each other)?){_WHEN}",
        _avoid_each_other,
    ),
)


def parse(constraint: Constraint, task: Task, proposal: Proposal) -> Check:
    """The check that a textual constraint means.

    Raises ArgumentError when no form matches (naming the forms), or when the sentence names an agent,
    object, point or subgoal that does not exist (naming those that do).
    """
    text = constraint.text
    if len(text) > MAX_LENGTH:
        raise ArgumentError(
            f"constraint of {len(text)} characters; a constraint is one sentence of up to {MAX_LENGTH}"
        )
    sentence = " ".join(text.lower().split()).rstrip(".! ")
    for form in FORMS:
        found = form.pattern.fullmatch(sentence)
        if found:
            parts = found.groupdict()
            for key in ("a", "agents"):
                parts[key] = parts.get(key) or parts.get(f"{key}2")
            return form.build(Words(parts, text, task, proposal, constraint))
    forms, verbs = "\n  ".join(form.example for form in FORMS), ", ".join(VERBS)
    raise ArgumentError(
        f"constraint {text!r} is not understood; forms that are:\n  {forms}\nwith the verbs {verbs}"
    )
