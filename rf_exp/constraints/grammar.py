"""The sentences in which constraints are stated, and the checks they mean.

A sentence is matched by patterns and never executed. It is understood whole or refused whole: a form has
no place for words that it does not read, so what no form reads from the first word to the last is refused,
with the words that are in the way. Nothing may be left out but what changes no meaning: articles, `both`,
case, the closing full stop. May, can and could are no must.

Every form below is one row: an example for the error message, the pattern in a small notation, and what
is built from its parts. The notation: `{a}` an agent, `{agents}` several, `{verb}`, `{object}`, `{point}`,
`{s}` seconds; the rest is a regular expression without wildcards.
"""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher

from rf_exp.constraints.evidence import Check, agent_name
from rf_exp.constraints.logical import ConsistentHeight, ValidateDirection, ValidateInteraction
from rf_exp.constraints.spatial import ZONE_LIMIT_M, AvoidAgents, AvoidObjects, StayOut
from rf_exp.constraints.temporal import TOGETHER_S, Deadline, Sequential, ShareSpace, Simultaneous, Step
from rf_exp.errors import ArgumentError, choices
from rf_exp.tasks import Task
from rf_exp.types import Constraint, Proposal, Subgoal

CONTACT_KINDS = ("grasp", "press")  # of interaction points, and the verbs that meet them
WORK = {"place": "what is put on it", "drop": "what is put into it", "tool": "the work of the tool"}
MAX_LENGTH = 300  # characters; a constraint is one sentence
MAX_WAIT_S = 600.0
_LONGEST_RUN = 8  # words in the way within a sentence that are looked for together

# verb of a subgoal -> the words people use for it, in every form that a sentence may have
VERBS = {
    "grasp": (
        "grasp grasps grasped grip grips gripped grab grabs grabbed pick picks picked take takes taken seize "
        "seizes seized pick_up picks_up picked_up"
    ),
    "lift": (
        "lift lifts lifted raise raises raised elevate elevates elevated open opens opened remove removes "
        "removed lift_up lifts_up lifted_up"
    ),
    "carry": "carry carries carried transport transports transported bring brings brought move moves moved",
    "place": (
        "place places placed put puts lay lays laid set sets stack stacks stacked insert inserts inserted "
        "put_down puts_down set_down sets_down lay_down lays_down laid_down"
    ),
    "press": "press presses pressed push pushes pushed click clicks clicked",
    "strike": "strike strikes struck hit hits hammer hammers hammered",
    "release": "release releases released drop drops dropped let_go_of lets_go_of",
    "hold": "hold holds held keep keeps kept",
}
_CANONICAL = {word.replace("_", " "): verb for verb, words in VERBS.items() for word in words.split()} | {
    "grasping": "grasp",
    "pressing": "press",
}
DIRECTIONS = {  # of a gripper that is so, or comes so
    "perpendicular": "perpendicular",
    "perpendicularly": "perpendicular",
    "vertical": "vertical",
    "vertically": "vertical",
    "from above": "vertical",
    "horizontal": "horizontal",
    "horizontally": "horizontal",
    "from the side": "horizontal",
    "level": "level",
}

_AGENT = r"agent[ _]?\d{1,3}"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
_VERB = "|".join(sorted((word for word in _CANONICAL if not word.endswith("ing")), key=len, reverse=True))
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
    "{is}": r"(?P<direction>perpendicular|vertical|horizontal|level)",
    "{comes}": r"(?P<direction>perpendicularly|vertically|horizontally|from above|from the side)",
    "{s}": rf"(?P<s>{_NUMBER}) ?s(?:ecs?|econds?)?",
    "{low}": rf"(?P<low>{_POINT3})",
    "{high}": rf"(?P<high>{_POINT3})",
    "{must}": r"(?:must|should|shall|has to|have to|needs? to|will)",
    "{may}": r"(?:may|can|could)",
    "{not}": r"(?:(?:must|should|shall|may) (?:not|never)|can ?not|can never|never)",
    "{begins}": r"(?:(?:begins?|starts?|proceeds?)(?: {task})?|acts?|moves?)",
    "{ends}": r"(?:completes?|finish(?:es)?|ends?)",
    "{ended}": r"(?:has |is |have )?(?:finishes|finished|completes|completed|ends|ended|stops|stopped|done)",
    "{task}": r"(?:its|the|their) (?:tasks?|actions?|motions?|work)",
}


class Words:
    """The parts of a matched sentence, looked up in the task and the plan."""

    def __init__(
        self, parts: Mapping[str, str], text: str, task: Task, proposal: Proposal, stated: Constraint
    ):
        self._parts, self.text, self._task, self._proposal = parts, text, task, proposal
        self._stated = stated

    def agent(self, key: str) -> int:
        return self._known(int(re.sub(r"\D", "", self._parts[key])))

    def agents(self) -> tuple[int, ...]:
        """The agents of the sentence; where it names none, all, or those the constraint is filed under."""
        listed = self._parts.get("agents")
        numbers = [int(n) for n in re.findall(r"\d+", listed)] if listed else list(self._stated.agents)
        if self._parts.get("all"):
            numbers = list(self._task.agents)
        found = tuple(dict.fromkeys(self._known(n) for n in numbers)) or self._task.agents
        if len(found) < 2:
            raise self.refused(f"needs two different agents; it names {len(found)}")
        return found

    def object(self, key: str = "object") -> str:
        name = _name(self._parts[key])
        if name not in self._task.objects:
            raise choices(f"object in constraint {self.text!r}:", name, self._task.objects)
        return name

    def point(self, name: str) -> str:
        points = self._task.asset(name).points
        point = self._parts["point"]
        point = {"centre": "center", "middle": "center"}.get(point, point)
        if point not in points:
            raise choices(f"point of {name} in constraint {self.text!r}:", point, points)
        return point

    def kind(self, name: str, point: str) -> str:
        return self._task.asset(name).points[point].kind

    def contacts(self, agent: int, name: str) -> list[Subgoal]:
        """The agent's subgoals that meet an object."""
        mine = self._proposal.of(agent)
        return [each for each in mine if each.object == name and each.verb in CONTACT_KINDS]

    def placed(self, agent: int, name: str, target: str) -> list[Subgoal]:
        """The agent's subgoals that put an object to a target."""
        mine = self._proposal.of(agent)
        return [each for each in mine if (each.verb, each.object, each.target) == ("place", name, target)]

    def verb(self, key: str = "verb") -> str | None:
        """The verb of a subgoal that a word stands for; None where the sentence has none."""
        word = self._parts.get(key)
        return _CANONICAL[word] if word else None

    def refused(self, why: str) -> ArgumentError:
        return ArgumentError(f"constraint {self.text!r} {why}")

    def no_subgoal(self, what: str, agent: int) -> ArgumentError:
        listed = "; ".join(subgoal.text for subgoal in self._proposal.of(agent)) or "none"
        return self.refused(
            f"speaks of {what}, which is no subgoal of {agent_name(agent)}; its subgoals: {listed}"
        )

    def orientation(self) -> str:
        return DIRECTIONS[self._parts["direction"]]

    def step(self, agent: int, verb: str = "verb", name: str = "object") -> Step:
        """The subgoals of an agent that the sentence speaks of; all of them where it names no verb."""
        canonical = self.verb(verb)
        if canonical is None:
            return Step(agent)
        step = Step(agent, canonical, self.object(name))
        mine = self._proposal.of(agent)
        if not any((subgoal.verb, subgoal.object) == (step.verb, step.object) for subgoal in mine):
            raise self.no_subgoal(step.text, agent)
        return step

    def seconds(self, default_s: float | None = None) -> float:
        number = self._parts.get("s")
        value = float(number) if number else default_s
        assert value is not None  # the pattern demands a number where there is no default
        if not 0 <= value <= MAX_WAIT_S:
            raise self.refused(f"is not possible: {value:g} s is not between 0 and {MAX_WAIT_S:g} s")
        return value

    def zone(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        corners = [[float(n) for n in re.findall(_NUMBER, self._parts[key])] for key in ("low", "high")]
        if max(abs(value) for corner in corners for value in corner) > ZONE_LIMIT_M:
            raise self.refused(f"is not possible: zones lie within {ZONE_LIMIT_M:g} m of the origin")
        (x0, x1), (y0, y1), (z0, z1) = (sorted(pair) for pair in zip(*corners, strict=True))
        if min(x1 - x0, y1 - y0, z1 - z0) < 1e-3:
            raise self.refused("is not possible: the zone is flat; each side must be at least 1 mm")
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
    count = itertools.count()  # a part that stands in two alternatives is numbered; _read takes that off
    numbered = re.sub(r"\(\?P<(\w+)>", lambda group: f"(?P<{group[1]}__{next(count)}>", notation)
    return Form(example, re.compile(numbered), build)


def _interaction(words: Words) -> Check:
    """Contact of the gripper; the agent's own subgoals must mean the same point, met the same way."""
    agent, name, verb = words.agent("a"), words.object(), words.verb()
    point = words.point(name)
    kind = words.kind(name, point)
    if kind not in CONTACT_KINDS:
        raise words.refused(f"is not possible: {point} of {name} is for {WORK[kind]}, not for a gripper")
    if verb != kind:
        raise words.refused(f"is not possible: the {point} point of {name} is to {kind}, not to {verb}")
    planned = {each.point for each in words.contacts(agent, name) if each.point}
    if planned and point not in planned:
        raise words.refused(
            f"demands point {point}, but {agent_name(agent)} is to meet {name} at "
            f"{' and '.join(sorted(planned))}; change the subgoal or the constraint"
        )
    return ValidateInteraction(agent, name, point, words.text)


def _placing(words: Words) -> Check:
    """Where something is put; the agent's own subgoals must put the same thing to the same target."""
    agent, name, target = words.agent("a"), words.object(), words.object("object2")
    point = words.point(target)
    if words.verb() != "place":
        raise words.refused(f"is not possible: to {words.verb()} {name} is not to place it")
    if (kind := words.kind(target, point)) in CONTACT_KINDS:
        raise words.refused(f"is not possible: the {point} point of {target} is to {kind}")
    if not words.placed(agent, name, target):
        raise words.no_subgoal(f"{agent_name(agent)}: place {name} to {target}", agent)
    return ValidateInteraction(agent, target, point, words.text)


def _direction(words: Words) -> Check:
    agent, name, verb = words.agent("a"), words.object(), words.verb()
    planned = {each.verb for each in words.contacts(agent, name)}
    if verb is not None and planned and verb not in planned:
        raise words.no_subgoal(f"{agent_name(agent)}: {verb} {name}", agent)
    return ValidateDirection(agent, name, words.orientation(), words.text)


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
        raise words.refused(f"needs two different agents; it names {agent_name(then.agent)}")
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
        raise words.refused(f"needs two different agents; it names {agent_name(a)}")
    return AvoidAgents(tuple(sorted((a, b))), words.text)


def _avoid_each_other(words: Words) -> Check:
    return AvoidAgents(tuple(sorted(words.agents())), words.text)


def _avoid_objects(words: Words) -> Check:
    return AvoidObjects((words.agent("a"),), words.text)


def _stay_out(words: Words) -> Check:
    return StayOut(words.agent("a"), *words.zone(), words.text)


_WHEN = r"(?: when (?P<verb>grasping|pressing)(?: it)?)?"
_OTHERS = r"(?:any |the |all )?other (?:agents?|arms?|robots?)"
_OBJECTS = (
    r"(?:(?:the |any |all |all the |other |any other |the other |all other )?(?:objects|obstacles)|"
    r"any (?:other )?(?:object|obstacle)|(?:the |its )?(?:environment|surroundings))"
)
_COLLIDE = (
    r"(?:collide with|touch|hit|interfere with|"
    r"intersect(?: with)?(?: the (?:trajectory|trajectories|paths?) of)?)"
)
_COLLISIONS = r"(?:any |all )?collisions?"
_TOGETHER = r"(?:simultaneously|at the same time|together|in sync(?:hrony)?|concurrently)"
_WITHIN = r"(?:,? (?:to )?within {s}(?: of each other)?|,? at most {s} apart)?"
_IN_TURN = (
    r"(?:one after the other|one after another|chronologically|in turns?|at different times|sequentially)"
)
_CONSISTENT = r"(?:consistent|same|equal|identical)"
_POINT = r"{point}(?: (?:interaction |contact |grasp )?(?:point|side|end|part|handle))?"

FORMS = (
    # logical
    _form(
        "Agent_1 must place steak at the inside point of pot.",
        r"{a} {must} {verb} {object} (?:at|on|in|into) (?:the )?{point}(?: point| side)? of {object2}",
        _placing,
    ),
    _form(
        "Agent_1 must approach barrier perpendicularly.",
        r"{a} {must} (?:approach|reach|{verb}) {object} {comes}",
        _direction,
    ),
    _form(
        "Agent_1 must grasp barrier at its left point.",
        rf"{{a}} (?:{{must}} )?{{verb}} {{object}} (?:at|by|on) (?:its |the )?{_POINT}",
        _interaction,
    ),
    _form(
        "Agent_1 must grasp the left end of barrier.",
        r"{a} (?:{must} )?{verb} (?:the |its ){point} (?:point|side|end|part) of {object}",
        _interaction,
    ),
    _form(
        "The gripper of Agent_1 must be perpendicular to barrier.",
        rf"the (?:gripper|hand) of {{a}} (?:{{must}} be|is) {{is}} (?:to|at) {{object}}{_WHEN}",
        _direction,
    ),
    _form(
        "Agent_1 and Agent_2 must keep a consistent gripper height.",
        rf"{{agents}} (?:both )?(?:{{must}} )?(?:both )?(?:keep|maintain|have|hold) (?:the |a |an )?"
        rf"{_CONSISTENT} (?:gripper )?heights?",
        _height,
    ),
    _form(
        "Keep the gripper height consistent between Agent_2 and Agent_3.",
        rf"keep (?:the )?gripper heights? (?:{_CONSISTENT}|the same)(?: (?:between|of|for) {{agents}})?",
        _height,
    ),
    # temporal
    _form(
        "Agent_1 and Agent_2 must lift barrier simultaneously within 0.5 s.",
        rf"{{agents}} (?:both )?(?:{{must}} )?(?:both )?{{verb}} {{object}} {_TOGETHER}{_WITHIN}",
        _simultaneous,
    ),
    _form(
        "Agent_1 and Agent_2 perform their tasks simultaneously.",
        rf"{{agents}} (?:{{must}} )?(?:perform|do|execute|carry out|start|begin) (?:(?:the|their) )?"
        rf"(?:tasks?|actions?|motions?) {_TOGETHER}{_WITHIN}",
        _simultaneous,
    ),
    _form(
        "Agent_2 must complete its task before Agent_1 begins.",
        r"{a} (?:{must} )?{ends}(?: {task})? before {b} (?:(?:{must}|{may}) )?{begins}",
        _sequential,
    ),
    _form(
        "Agent_2 must lift lid before Agent_1 may place steak.",
        r"{a} (?:{must} )?{verb} {object} before {b} (?:(?:{must}|{may}) )?(?:(?:begin|start)s? to )?"
        r"{verb2} {object2}",
        _sequential,
    ),
    _form(
        "Agent_2 must lift lid before Agent_1 begins.",
        r"{a} (?:{must} )?{verb} {object} before {b} (?:(?:{must}|{may}) )?{begins}",
        _sequential,
    ),
    _form(
        "Agent_4 must place steak only after Agent_5 lifts lid.",
        r"{b} (?:(?:{must} )?(?:only )?{verb2} {object2}|{may} only {verb2} {object2}|"
        r"(?:{must}|{may}) {verb2} {object2} only) after {a} (?:has |have )?{verb} {object}",
        _sequential,
    ),
    _form(
        "Agent_1 must wait 2 s after Agent_2 lifts lid.",
        r"{a} (?:{must} )?waits? (?:for )?(?:at least )?{s} after {b} (?:has |have )?{verb} {object}",
        _wait,
    ),
    _form(
        "Agent_1 must wait 2 s after Agent_2 has finished.",
        r"{a} (?:{must} )?waits? (?:for )?(?:at least )?{s} after {b}(?: {ended}(?: {task})?)?",
        _wait,
    ),
    _form(
        "Agent_1 must finish within 10 s.",
        r"{a} (?:(?:{must} )?{ends}(?: {task})?|{must} be done) within {s}",
        _deadline,
    ),
    _form(
        "Agent_1 must lift barrier within 10 s.",
        r"{a} (?:{must} )?{verb} {object} within {s}",
        _deadline,
    ),
    _form(
        "Agent_1 and Agent_2 may share the same space one after the other.",
        rf"{{agents}} {{may}} (?:share|use|occupy) (?:the )?(?:same |shared )?(?:space|area|region) "
        rf"{_IN_TURN}",
        _share,
    ),
    # spatial
    _form(
        "Agent_1 must stay out of zone (-0.1, 0.2, 0) to (0.1, 0.4, 0.5).",
        r"{a} (?:(?:{must} )?(?:(?:stays?|keeps?) out of|avoids?)|{not} enters?)(?: the)? "
        r"(?:zone|box|region|area) {low} to {high}",
        _stay_out,
    ),
    _form(
        "Avoid collision between Agent_1 and the objects.",
        rf"(?:avoid {_COLLISIONS} (?:between|of) {{a}} (?:and|with)|{{a}} {{not}} {_COLLIDE}) {_OBJECTS}",
        _avoid_objects,
    ),
    _form(
        "Avoid collision between Agent_1 and other agents.",
        rf"(?:avoid {_COLLISIONS} (?:between|of) {{a}} (?:and|with)|{{a}} {{not}} {_COLLIDE}) {_OTHERS}",
        _avoid_others,
    ),
    _form(
        "Avoid collision between Agent_1 and Agent_2.",
        rf"(?:avoid {_COLLISIONS} between {{a}} and|{{a}} {{must}} avoid(?: {_COLLISIONS} with)?) {{b}}",
        _avoid_pair,
    ),
    _form(
        "Agent_1 must not occupy the same space as Agent_3.",
        rf"{{a}} {{not}} (?:occupy the same space as|{_COLLIDE}|enter the space of) {{b}}",
        _avoid_pair,
    ),
    _form(
        "Agents must avoid colliding with each other.",
        r"(?:(?P<all>all )?agents|{agents}) (?:{must} avoid (?:colliding|collisions?|contact) with each "
        r"other|{not} collide(?: with each other)?)",
        _avoid_each_other,
    ),
)
_WORD = re.compile(r"[^\W\d_]+")
_WRITTEN = re.compile(
    r"\(\?P<\w+>|([a-z]+)(\??)"
)  # in a pattern: a word, or one with and without its last letter
_KNOWN = frozenset(
    word
    for form in FORMS
    for written, optional in _WRITTEN.findall(form.pattern.pattern)
    for word in (written, written[:-1] if optional else written)
)


def parse(constraint: Constraint, task: Task, proposal: Proposal) -> Check:
    """The check that a textual constraint means.

    Raises ArgumentError when no form reads the whole sentence (naming the words in the way and the nearest
    form), or when it names an agent, object, point or subgoal that does not exist (naming those that do).
    """
    text = constraint.text
    if len(text) > MAX_LENGTH:
        raise ArgumentError(
            f"constraint of {len(text)} characters; a constraint is one sentence of up to {MAX_LENGTH}"
        )
    words = text.rstrip(".! \t\n").split()
    if (read := _read(words)) is None:
        raise _not_understood(text, words, task)
    form, parts = read
    return form.build(Words(parts, text, task, proposal, constraint))


def _name(part: str) -> str:
    """The name that words for an object stand for."""
    return re.sub(r"^(?:the|an?|its) ", "", part).replace(" ", "_")


def _read(words: Sequence[str]) -> tuple[Form, dict[str, str]] | None:
    """The form that reads all of these words, and their parts."""
    sentence = " ".join(words).lower()
    for form in FORMS:
        if found := form.pattern.fullmatch(sentence):
            said = {name: value for name, value in found.groupdict().items() if value is not None}
            return form, {name.partition("__")[0]: value for name, value in said.items()}
    return None


def _not_understood(text: str, words: Sequence[str], task: Task) -> ArgumentError:
    """Names the words in the way, the nearest form, and what this task has to speak of."""
    nearest, in_the_way = _nearest(words, task)
    why = f"cannot read {in_the_way!r}" if in_the_way else "knows these words, but not in this order"
    if not words:
        why = "finds no words"
    things = (
        f"{name} ({', '.join(points)})" if (points := task.asset(name).points) else name
        for name in task.objects
    )
    return ArgumentError(
        f"constraint {text!r} is not understood: the grammar {why}; the nearest form: {nearest.example!r}; "
        f"agents: {', '.join(map(agent_name, task.agents))}; objects with their points: "
        f"{', '.join(things) or 'none'}; verbs: {', '.join(VERBS)}"
    )


def _nearest(words: Sequence[str], task: Task) -> tuple[Form, str]:
    """The form that reads most of the words, and those that it does not: the end, or a run anywhere."""
    count = len(words)
    tails = [(start, count) for start in range(count - 1, 0, -1)]
    runs = [(k, k + length) for length in range(1, _LONGEST_RUN + 1) for k in range(count - length, -1, -1)]
    for start, end in (*tails, *runs):
        read = _read([*words[:start], *words[end:]])
        if read and all(_name(part) in task.objects for key, part in read[1].items() if "object" in key):
            return read[0], " ".join(words[start:end])
    names = " ".join([*task.objects, *(point for name in task.objects for point in task.asset(name).points)])
    known = _KNOWN.union(_WORD.findall(names.lower()))
    unknown = [word for word in words if not known.issuperset(_WORD.findall(word.lower()))]
    sentence = [word.lower() for word in words]
    likeness = {
        form: SequenceMatcher(None, form.example.lower().rstrip(".").split(), sentence).ratio()
        for form in FORMS
    }
    return max(FORMS, key=lambda form: likeness[form]), " ".join(unknown)
