"""Independent reading of sentences to test the grammar: uses only words and their order, with its own tables.

`misread` compares a sentence with the statement that the grammar parsed, and returns the error. It has tables
of the allowed words of each kind of statement and of the meanings of verbs and units, knows which events are
over and which begin, and counts negations; it shares nothing with the grammar.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import pairwise
from math import pi

from rf_exp.statements import (
    AvoidAgents,
    AvoidObjects,
    Before,
    ContactAt,
    Deadline,
    Direction,
    KeepApart,
    KeepHeight,
    KeepLevel,
    KeepOut,
    PlaceAt,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
)

OBJECTS = ("lid", "pot", "steak", "barrier", "table")
POINTS = {"knob": "knob", "inside": "inside", "center": "center", "centre": "center", "middle": "center"}
POINTS |= {"left": "left", "right": "right"}

# Sense of a verb -> its words: base form, third person, past, participle and -ing form.
VERB_WORDS = {
    "grasp": "grasp grasps grasped grasped grasping, grip grips gripped gripped gripping, grab grabs "
    "grabbed grabbed grabbing, seize seizes seized seized seizing",
    "take": "pick picks picked picked picking, pick_up picks_up picked_up picked_up picking_up, "
    "take takes took taken taking",  # to grasp where the point of contact is stated; else also to move
    "lift": "lift lifts lifted lifted lifting, lift_up lifts_up lifted_up lifted_up lifting_up, "
    "raise raises raised raised raising, elevate elevates elevated elevated elevating",
    "open": "open opens opened opened opening",  # for a lid: to lift it
    "remove": "remove removes removed removed removing",  # to take off and away
    "carry": "carry carries carried carried carrying, transport transports transported transported "
    "transporting, bring brings brought brought bringing, move moves moved moved moving",
    "place": "place places placed placed placing, put puts put put putting, put_down puts_down put_down "
    "put_down putting_down, lay lays laid laid laying, lay_down lays_down laid_down laid_down laying_down, "
    "set sets set set setting, set_down sets_down set_down set_down setting_down, "
    "stack stacks stacked stacked stacking, insert inserts inserted inserted inserting",
    "strike": "strike strikes struck struck striking, hit hits hit hit hitting, "
    "hammer hammers hammered hammered hammering",
    "press": "press presses pressed pressed pressing, click clicks clicked clicked clicking",
    "shut": "shut shuts shut shut shutting, sweep_shut sweeps_shut swept_shut swept_shut sweeping_shut, "
    "swing_shut swings_shut swung_shut swung_shut swinging_shut",
    "push": "push pushes pushed pushed pushing",  # to press where the point is stated; else to shift
    "release": "release releases released released releasing, drop drops dropped dropped dropping, "
    "let_go_of lets_go_of let_go_of let_go_of letting_go_of",
    "hold": "hold holds held held holding",
    "keep": "keep keeps kept kept keeping",
}  # fmt: skip
FORMS = [(sense, words.split()) for sense, verbs in VERB_WORDS.items() for words in verbs.split(",")]
SENSE = {form: sense for sense, forms in FORMS for form in forms}
PAST_FORMS = {form for _, forms in FORMS for form in forms[2:4] if form not in forms[:2]}  # lifted, taken

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,3})?"
LENGTHS = {"mm millimeter millimeters millimetre millimetres": 1e-3,
           "cm centimeter centimeters centimetre centimetres": 1e-2,
           "m meter meters metre metres": 1.0}  # fmt: skip
TIMES = {
    "s sec secs second seconds": 1.0,
    "ms millisecond milliseconds": 1e-3,
    "min mins minute minutes": 60.0,
}
ANGLES = {"deg degree degrees \u00b0": 1.0, "rad radian radians": 180 / pi}
PER = [f"{slash}{second}" for slash in ("/", " / ", " per ") for second in ("s", "sec", "second")]
UNITS: dict[str, tuple[str, float]] = {}
for _unit, _table in {"m": LENGTHS, "s": TIMES, "deg": ANGLES}.items():
    UNITS |= {word: (_unit, scale) for words, scale in _table.items() for word in words.split()}
UNITS |= {
    word + per: ("m/s", scale) for words, scale in LENGTHS.items() for word in words.split() for per in PER
}
_UNIT = "|".join(sorted(map(re.escape, UNITS), key=len, reverse=True))
_QUANTITY = re.compile(rf"(?<![\w.])({NUMBER}) ?({_UNIT})(?!\w)")

MUST = "must should shall will has have to needs need mustn't shouldn't can't"
DETERMINERS = "the a an its their"
TASK = "with task tasks action actions motion motions work"
END = "completes complete finish finishes finished completed ends end ended done"
BEGIN = "begin begins start starts proceed proceeds act acts"
POINT_WORDS = "point side end part handle interaction contact grasp"
NEGATIONS = "not never cannot mustn't shouldn't can't"
ALLOWED_WORDS: Mapping[type[Statement], str] = {  # allowed words of each kind
    Before: (
        f"{MUST} {DETERMINERS} {TASK} {END} {BEGIN} {NEGATIONS} may can could allowed is are be been had "
        "was by and it before after until once then first only wait waits for at least back on "
        "lies move moves"
    ),
    Together: (
        f"{MUST} {DETERMINERS} and both simultaneously at the same time together in sync synchrony "
        "concurrently within of each other to most apart perform do execute carry out start begin "
        "tasks task actions action motions motion"
    ),
    Deadline: f"{MUST} {DETERMINERS} {TASK} {END} be within",
    ShareSpace: "may can could share use occupy the same shared space area region turns and",
    ContactAt: f"{MUST} {DETERMINERS} {POINT_WORDS} at by on of",
    PlaceAt: f"{MUST} {DETERMINERS} {POINT_WORDS} at in on into of",
    Direction: (
        f"{MUST} {DETERMINERS} gripper hand of be is stay stays remain remains keep keeps hold holds to "
        "at when while it approach approaches reach reaches from above side"
    ),
    SameHeight: (
        f"{MUST} {DETERMINERS} and both keep maintain have hold gripper height heights between of for "
        "when while consistent same equal identical"
    ),
    KeepApart: (
        f"{MUST} {DETERMINERS} keep keeps hold holds have grippers hands arms stay stays remain "
        "remains be are at least apart distance of away from and"
    ),
    KeepLevel: (
        f"{MUST} {DETERMINERS} keep hold carry stay remain be kept held level upright horizontal to within"
    ),
    KeepHeight: (
        f"{MUST} {DETERMINERS} keep hold gripper hand of stay remain be kept below under above over table"
    ),
    SpeedLimit: (
        f"{MUST} {DETERMINERS} {NEGATIONS} may can move moves gripper hand of be faster slower than no "
        "more at most with"
    ),
    AvoidAgents: (
        f"{MUST} {DETERMINERS} {NEGATIONS} may can avoid any all collision collisions colliding contact "
        "between of and with other agents agent arms arm robots robot each collide touch hit "
        "interfere intersect trajectory trajectories path paths occupy enter same space as"
    ),
    AvoidObjects: (
        f"{MUST} {DETERMINERS} {NEGATIONS} may can avoid any all collision collisions between of and with "
        "other collide touch hit interfere intersect trajectory trajectories path paths objects "
        "object obstacles obstacle environment surroundings"
    ),
    KeepOut: (
        f"{MUST} {DETERMINERS} {NEGATIONS} {END} {TASK} may can stay stays keep keeps out of avoid avoids "
        "enter enters zone box region area to while when as long is still there in it inside "
        "until before been was by on lies back"
    ),
}
# Kinds whose verbs are actions of an agent; in the others, verbs state how a limit is kept.
ACTION_KINDS = (Before, Together, Deadline, ContactAt, PlaceAt, Direction, SameHeight, KeepOut)
CLAUSE_BOUNDARY = re.compile(r"\b(?:before|after|until|once|then|while|when|for)\b|,")
MIN_DEADLINE_S = 2.0  # times up to this are tolerances, not deadlines


@lru_cache(4096)
def normalised(text: str) -> str:
    """A sentence in lower case, with one name per agent, one word per verb, and quantities in base units."""
    text = " ".join(text.lower().rstrip(".! ").split())
    text = re.sub(r"\b(?:agents?|robots?|arms?)[ _-]?(\d)((?:,? and |, )(?:\d)\b(?! ?(?:s|cm|mm|m)\b))",
                  lambda found: f"agent_{found[1]} and agent_{found[2][-1]}", text)  # fmt: skip
    text = re.sub(r"\b(?:the )?(?:agents?|robots?|arms?|robot arm)[ _-]?(\d)", r"agent_\1", text)
    for side, agent in (("left", 1), ("right", 2)):
        text = re.sub(rf"\bthe {side}(?:most|-hand)? (?:agent|robot arm|robot|arm)\b", f"agent_{agent}", text)
    text = re.sub(
        r"\b(?:all )?(?:agents|robots|arms) (must|should|may|can)\b", r"agent_1 and agent_2 \1", text
    )
    text = re.sub(r"\bone after (?:the other|another)\b|\bchronologically\b|\bsequentially\b", "turns", text)
    text = re.sub(r"\bin turns?\b|\bat different times\b", "turns", text)
    text = re.sub(r"\bhas been put (back )?on\b", "is on", text)
    for phrase in sorted((form for form in SENSE if "_" in form), key=len, reverse=True):
        text = re.sub(rf"\b{phrase.replace('_', ' ')}\b", phrase, text)

    def resolved(found: re.Match[str]) -> str:
        unit, scale = UNITS[found[2]]
        return f"<{float(found[1]) * scale + 0.0:.9g} {unit}>"

    return _QUANTITY.sub(resolved, text)


def words_of(text: str) -> list[str]:
    """Words, agents, quantities and numbers of a normalised sentence."""
    return re.findall(rf"<[^>]*>|agent_\d|{NUMBER}(?!\w)|[a-z_'-]+|[^\s()]", text)


def senses(words: list[str], stated: Statement) -> Iterator[str]:
    """Senses of the verbs of a sentence."""
    if not isinstance(stated, ACTION_KINDS):
        return
    for at, word in enumerate(words):
        if (sense := SENSE.get(word)) is None:
            continue
        after = [each for each in words[at + 1 :] if each not in DETERMINERS.split()][:1]
        it = words[at + 1 : at + 2] in (["it"], [])
        auxiliary = isinstance(stated, Direction | SameHeight | KeepOut) and word.rstrip("s") in (
            "hold",
            "keep",
        )
        if auxiliary and not set(after) & set(OBJECTS):
            continue  # keeps its gripper, a height, out of a zone
        if word in ("move", "moves") and not set(after) & set(OBJECTS):
            continue  # begins
        if word == "carry" and after == ["out"]:
            continue
        if word == "grasp" and after[:1] and after[0] in ("point", "side", "end", "part", "handle"):
            continue
        passive = {"is", "be", "been", "was"} & set(words[max(0, at - 1) : at]) or it
        if sense == "open" and ("lid" in after or (passive and "lid" in words[max(0, at - 5) : at])):
            sense = "lift"
        contact_stated = {"from", "perpendicularly"} & set(words)
        if isinstance(stated, ContactAt) or (isinstance(stated, Direction) and contact_stated):
            sense = {"take": "grasp", "push": "press"}.get(sense, sense)
        yield sense


def directions(words: list[str]) -> Iterator[str]:
    """Stated directions, each with its subject: the gripper or an object."""
    gripper = {"gripper", "hand", "approach", "approaches", "reach", "reaches"} & set(words)
    for word in words:
        if word in ("level", "upright", "horizontal", "vertical", "perpendicular"):
            name = "level" if word == "upright" or (word == "horizontal" and not gripper) else word
            yield f"{name} {'gripper' if gripper else 'thing'}"
        if word.removesuffix("ly") in ("horizontal", "vertical", "perpendicular") and word.endswith("ly"):
            contact_verbs = {"grasp", "press", "shut"} | (
                {"take", "push"} if word == "perpendicularly" else set()
            )
            of_gripper = gripper or contact_verbs & {SENSE.get(each) for each in words}
            yield f"{word.removesuffix('ly')} {'gripper' if of_gripper else 'motion or thing'}"
    for at, word in enumerate(words):
        if word == "from" and words[at + 1 : at + 2] in (["above"], ["the"]):
            contact = {"grasp", "take", "press", "push", "shut"} & {SENSE.get(each) for each in words}
            name = "vertical" if words[at + 1] == "above" else "horizontal"
            yield f"{name} {'gripper' if gripper or contact else 'motion or thing'}"


def content(text: str, stated: Statement) -> Counter[str]:
    """Counts of what a sentence names: agents, objects, points, quantities, verbs and directions."""
    words = words_of(normalised(text))
    found: Counter[str] = Counter()
    for at, word in enumerate(words):
        is_side = word in ("left", "right") and not isinstance(stated, ContactAt)
        if word.startswith(("<", "agent_")) or word in OBJECTS:
            if not (word == "table" and isinstance(stated, KeepHeight)):
                found[word] += 1
        elif word in POINTS and not is_side and not isinstance(stated, KeepOut):
            found[POINTS[word]] += 1
        elif re.fullmatch(NUMBER, word):
            found[f"{float(word) + 0.0:g}"] += 1
        elif word in ("below", "under"):
            found["below"] += 1
        elif word in ("above", "over") and isinstance(stated, KeepHeight):
            found["above"] += not words[at - 1].startswith("<")  # 5 cm above the table
    if not isinstance(stated, Before):  # repeated agents in a list count once
        found.update({key: 1 - found[key] for key in found if key.startswith("agent_")})
    found.update(senses(words, stated))
    if isinstance(stated, Direction | KeepLevel):
        found.update(directions(words))
    return found


def count_negations(words: list[str]) -> int:
    return sum(word in NEGATIONS.split() for word in words)


def clauses(text: str) -> Iterator[list[str]]:
    """The clauses of a sentence, as words."""
    for part in CLAUSE_BOUNDARY.split(normalised(text)):
        words = words_of(part)
        subjects = [0]
        for at, word in enumerate(words):
            passive = (
                word in OBJECTS
                and words[at + 1 : at + 2]
                and words[at + 1] in f"is was be lies {MUST}".split()
            )
            if passive or (word.startswith("agent_") and "by" not in words[at - 1 : at]):
                subjects.append(at)
        for begins, ends in pairwise([*subjects, len(words)]):
            yield words[begins:ends]


def event_phases(words: list[str]) -> set[str]:
    """Stated phases of an event: that it begins, or that it is over."""
    found = {"begins"} & {"begins" for word in words if word in BEGIN.split()}
    perfect = any(
        word in ("has", "have", "had") and following != "to" for word, following in pairwise([*words, ""])
    )
    if perfect or set(words) & (set(END.split()) | PAST_FORMS):
        found.add("is over")
    if {"is", "lies", "be"} & set(words) and "on" in words:
        found.add("is over")
    return found


def phase_error(text: str, stated: Statement) -> str:
    """Error if a beginning event was read as a completed one or vice versa; else empty."""
    if not isinstance(stated, Before):
        return ""
    first = f"agent_{stated.first.agent}" if isinstance(stated.first, Step) else stated.first.object
    for words in clauses(text):
        is_first = first in words and (isinstance(stated.first, Step) or "on" in words)
        allowed = {"is over"} if is_first else {"begins"}
        passive = {"is", "be"} & set(words) and "by" in words and "on" not in words
        if wrong := event_phases(words) - allowed - ({"is over"} if passive else set()):
            return f"{' '.join(words)!r} {' and '.join(wrong)}"
    return ""


def first_mentioned_waits(words: list[str]) -> bool:
    """Whether the event that is mentioned first has to wait."""
    if words[0] in ("after", "once", "first") or words[:2] in (["only", "after"], ["only", "once"]):
        return False
    if count_negations(words) or words[0] == "before":
        return True
    return bool({"wait", "waits"} & set(words)) or not ({"before", "then"} & set(words))


def phrasing_error(words: list[str], stated: Statement) -> str:
    """Error in the negation, time, permission or order of a statement; else empty."""
    text, negations = " ".join(words), count_negations(words)
    allowed = {"may", "can", "could"} & set(words)
    match stated:
        case AvoidAgents() | AvoidObjects() | KeepOut():
            if negations + ("avoid" in text) + ("out of" in text) != 1:
                return "denied twice, or not at all"
        case SpeedLimit():
            slow = any(each in text for each in ("slower than", "no faster than", "at most", "no more than"))
            if ("faster than" in text and "no faster than" not in text) != (negations == 1) or slow == (
                negations == 1
            ):
                return "the wrong way round"
        case Before():
            if negations > 1 or (negations and not {"before", "until"} & set(words)):
                return "denied"
            if negations and {"wait", "waits"} & set(words):
                return "denied"
        case _ if negations:
            return "denied"
        case _:
            pass
    order_words = isinstance(stated, Before) and {"only", "before", "then"} & set(words)
    if allowed and not (negations or order_words or isinstance(stated, ShareSpace)):
        return "a permission"
    if isinstance(stated, ShareSpace) and not allowed:
        return "no permission"
    if (
        isinstance(stated, Together)
        and "together" in words
        and {"put", "set", "lay", "stack", "bring"} & {word.split("_")[0].rstrip("s") for word in words}
    ):
        return "to join"
    times = [word for word in words if word.endswith(" s>")]
    if len(times) > 1:
        return "two times"
    for time in times:
        at, value_s = words.index(time), float(time[1:-3])
        before, after = words[at - 1], words[at + 1 : at + 4]
        apart = after == ["of", "each", "other"] or (before == "most" and after[:1] == ["apart"])
        apart |= words[at - 2 : at] == ["to", "within"]
        at_once = {"simultaneously", "sync", "synchrony", "concurrently"} & set(words) or "same time" in text
        apart |= bool(before == "within" and at_once and value_s <= MIN_DEADLINE_S)
        if isinstance(stated, Together) != apart:
            return "a deadline for a tolerance, or the other way round"
        if isinstance(stated, Together) and value_s > 10:
            return "no tolerance is so large"
        if isinstance(stated, Deadline) and before != "within":
            return "no deadline"
        if isinstance(stated, Before):
            pause = {"wait", "waits"} & set(words) or words[at - 2 : at] == ["at", "least"]
            if not pause or after[:1] != ["after"]:
                return "no pause"
    if isinstance(stated, Before):
        first = f"agent_{stated.first.agent}" if isinstance(stated.first, Step) else stated.first.object
        then = f"agent_{stated.then.agent}"
        if (words.index(then) < words.index(first)) != first_mentioned_waits(words):
            return "the wrong one waits"
    if isinstance(stated, KeepLevel) and {"vertical", "vertically"} & set(words):
        return "vertical is not level"
    return ""


def added_by_sentence(stated: Statement, in_text: Counter[str]) -> Counter[str]:
    """Contents that the sentence of a statement has in addition to the original text."""
    added: Counter[str] = Counter()
    if isinstance(stated, Together) and not any(key.endswith(" s>") for key in in_text):
        added["<0.1 s>"] += 1
    if isinstance(stated, KeepLevel) and not any(key.endswith(" deg>") for key in in_text):
        added["<10 deg>"] += 1
    if not any(key.startswith("agent_") for key in in_text):  # the agents that it is listed under
        added.update(f"agent_{agent}" for agent in stated.agents)
    return added


def misread(text: str, stated: Statement) -> str:
    """Error in the reading of a sentence; empty if there is none."""
    words = words_of(normalised(text))
    lexicon = {*ALLOWED_WORDS[type(stated)].split(), *OBJECTS, *POINTS, "turns"}
    if isinstance(stated, ACTION_KINDS):
        lexicon |= SENSE.keys()
    if isinstance(stated, Direction):
        lexicon |= {"level", "perpendicular", "vertical", "horizontal"}
        lexicon |= {"perpendicularly", "vertically", "horizontally"}
    unknown = [
        word
        for word in words
        if not (
            word in lexicon or word == "," or word.startswith(("<", "agent_")) or re.fullmatch(NUMBER, word)
        )
    ]
    if unknown:
        return f"words that say something else: {unknown}"
    in_text, in_sentence = content(text, stated), content(stated.sentence, stated)
    if unread := in_text - in_sentence:
        return f"words that were not read: {dict(unread)}"
    if invented := (in_sentence - in_text) - added_by_sentence(stated, in_text):
        return f"words that are not there: {dict(invented)}"
    return phase_error(text, stated) or phrasing_error(words, stated)
