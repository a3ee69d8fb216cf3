"""Another reading of sentences, to judge the grammar by: words and their order alone, with tables of its own.

`misread` takes a sentence and the statement that the grammar made of it, and says what is wrong. It knows
what each kind of statement may be said with, what each verb means, what each unit is, which event is over and
which begins, and how often a sentence denies; nothing of it comes from the grammar but its answer.
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

# What a word for a verb says: base form, third person, past, participle and -ing form.
SAYS = {
    "grasp": "grasp grasps grasped grasped grasping, grip grips gripped gripped gripping, grab grabs "
    "grabbed grabbed grabbing, seize seizes seized seized seizing",
    "take": "pick picks picked picked picking, pick_up picks_up picked_up picked_up picking_up, "
    "take takes took taken taking",  # to grasp where a gripper takes hold is told; else to move it as well
    "lift": "lift lifts lifted lifted lifting, lift_up lifts_up lifted_up lifted_up lifting_up, "
    "raise raises raised raised raising, elevate elevates elevated elevated elevating",
    "open": "open opens opened opened opening",  # of a lid to lift it
    "remove": "remove removes removed removed removing",  # to take it off, and away
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
    "push": "push pushes pushed pushed pushing",  # to press where it is said at which point; else to shift
    "release": "release releases released released releasing, drop drops dropped dropped dropping, "
    "let_go_of lets_go_of let_go_of let_go_of letting_go_of",
    "hold": "hold holds held held holding",
    "keep": "keep keeps kept kept keeping",
}  # fmt: skip
FORMS = [(sense, words.split()) for sense, said in SAYS.items() for words in said.split(",")]
SENSE = {form: sense for sense, forms in FORMS for form in forms}
OVER = {form for _, forms in FORMS for form in forms[2:4] if form not in forms[:2]}  # lifted, taken

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
NAMING = "the a an its their"
TASK = "with task tasks action actions motion motions work"
END = "completes complete finish finishes finished completed ends end ended done"
BEGIN = "begin begins start starts proceed proceeds act acts"
POINTED = "point side end part handle interaction contact grasp"
DENIES = "not never cannot mustn't shouldn't can't"
WITH_WHAT: Mapping[type[Statement], str] = {  # the words with which each kind may be said
    Before: (
        f"{MUST} {NAMING} {TASK} {END} {BEGIN} {DENIES} may can could allowed is are be been had "
        "was by and it before after until once then first only wait waits for at least back on "
        "lies move moves"
    ),
    Together: (
        f"{MUST} {NAMING} and both simultaneously at the same time together in sync synchrony "
        "concurrently within of each other to most apart perform do execute carry out start begin "
        "tasks task actions action motions motion"
    ),
    Deadline: f"{MUST} {NAMING} {TASK} {END} be within",
    ShareSpace: "may can could share use occupy the same shared space area region turns and",
    ContactAt: f"{MUST} {NAMING} {POINTED} at by on of",
    PlaceAt: f"{MUST} {NAMING} {POINTED} at in on into of",
    Direction: (
        f"{MUST} {NAMING} gripper hand of be is stay stays remain remains keep keeps hold holds to "
        "at when while it approach approaches reach reaches from above side"
    ),
    SameHeight: (
        f"{MUST} {NAMING} and both keep maintain have hold gripper height heights between of for "
        "when while consistent same equal identical"
    ),
    KeepApart: (
        f"{MUST} {NAMING} keep keeps hold holds have grippers hands arms stay stays remain "
        "remains be are at least apart distance of away from and"
    ),
    KeepLevel: (
        f"{MUST} {NAMING} keep hold carry stay remain be kept held level upright horizontal to within"
    ),
    KeepHeight: (
        f"{MUST} {NAMING} keep hold gripper hand of stay remain be kept below under above over table"
    ),
    SpeedLimit: (
        f"{MUST} {NAMING} {DENIES} may can move moves gripper hand of be faster slower than no "
        "more at most with"
    ),
    AvoidAgents: (
        f"{MUST} {NAMING} {DENIES} may can avoid any all collision collisions colliding contact "
        "between of and with other agents agent arms arm robots robot each collide touch hit "
        "interfere intersect trajectory trajectories path paths occupy enter same space as"
    ),
    AvoidObjects: (
        f"{MUST} {NAMING} {DENIES} may can avoid any all collision collisions between of and with "
        "other collide touch hit interfere intersect trajectory trajectories path paths objects "
        "object obstacles obstacle environment surroundings"
    ),
    KeepOut: (
        f"{MUST} {NAMING} {DENIES} {END} {TASK} may can stay stays keep keeps out of avoid avoids "
        "enter enters zone box region area to while when as long is still there in it inside "
        "until before been was by on lies back"
    ),
}
# A verb of these is what an agent does; in the others it says how a limit is kept.
DOING = (Before, Together, Deadline, ContactAt, PlaceAt, Direction, SameHeight, KeepOut)
CLAUSES = re.compile(r"\b(?:before|after|until|once|then|while|when|for)\b|,")
SHORT_S = 2.0  # so soon nothing is over: no deadline


@lru_cache(4096)
def tidy(text: str) -> str:
    """A sentence in lower case, with one name for each agent and word for each verb, and units resolved."""
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
    """Words, agents, quantities and numbers of a tidy sentence."""
    return re.findall(rf"<[^>]*>|agent_\d|{NUMBER}(?!\w)|[a-z_'-]+|[^\s()]", text)


def senses(words: list[str], stated: Statement) -> Iterator[str]:
    """What the verbs of a sentence say."""
    if not isinstance(stated, DOING):
        return
    for at, word in enumerate(words):
        if (sense := SENSE.get(word)) is None:
            continue
        after = [each for each in words[at + 1 :] if each not in NAMING.split()][:1]
        it = words[at + 1 : at + 2] in (["it"], [])
        auxiliary = isinstance(stated, Direction | SameHeight | KeepOut) and word.rstrip("s") in (
            "hold",
            "keep",
        )
        if auxiliary and not set(after) & set(OBJECTS):
            continue  # its gripper, a height, out of a zone
        if word in ("move", "moves") and not set(after) & set(OBJECTS):
            continue  # begins
        if word == "carry" and after == ["out"]:
            continue
        if word == "grasp" and after[:1] and after[0] in ("point", "side", "end", "part", "handle"):
            continue
        passive = {"is", "be", "been", "was"} & set(words[max(0, at - 1) : at]) or it
        if sense == "open" and ("lid" in after or (passive and "lid" in words[max(0, at - 5) : at])):
            sense = "lift"
        told = {"from", "perpendicularly"} & set(words)
        if isinstance(stated, ContactAt) or (isinstance(stated, Direction) and told):
            sense = {"take": "grasp", "push": "press"}.get(sense, sense)
        yield sense


def turned(words: list[str]) -> Iterator[str]:
    """What is said of directions, and of what: the gripper, or a thing."""
    gripper = {"gripper", "hand", "approach", "approaches", "reach", "reaches"} & set(words)
    for word in words:
        if word in ("level", "upright", "horizontal", "vertical", "perpendicular"):
            name = "level" if word == "upright" or (word == "horizontal" and not gripper) else word
            yield f"{name} {'gripper' if gripper else 'thing'}"
        if word.removesuffix("ly") in ("horizontal", "vertical", "perpendicular") and word.endswith("ly"):
            meets = {"grasp", "press", "shut"} | ({"take", "push"} if word == "perpendicularly" else set())
            held = gripper or meets & {SENSE.get(each) for each in words}
            yield f"{word.removesuffix('ly')} {'gripper' if held else 'motion or thing'}"
    for at, word in enumerate(words):
        if word == "from" and words[at + 1 : at + 2] in (["above"], ["the"]):
            touches = {"grasp", "take", "press", "push", "shut"} & {SENSE.get(each) for each in words}
            name = "vertical" if words[at + 1] == "above" else "horizontal"
            yield f"{name} {'gripper' if gripper or touches else 'motion or thing'}"


def content(text: str, stated: Statement) -> Counter[str]:
    """What a sentence names: agents, things, points, quantities, verbs and directions."""
    words = words_of(tidy(text))
    found: Counter[str] = Counter()
    for at, word in enumerate(words):
        nouns = word in ("left", "right") and not isinstance(stated, ContactAt)
        if word.startswith(("<", "agent_")) or word in OBJECTS:
            if not (word == "table" and isinstance(stated, KeepHeight)):
                found[word] += 1
        elif word in POINTS and not nouns and not isinstance(stated, KeepOut):
            found[POINTS[word]] += 1
        elif re.fullmatch(NUMBER, word):
            found[f"{float(word) + 0.0:g}"] += 1
        elif word in ("below", "under"):
            found["below"] += 1
        elif word in ("above", "over") and isinstance(stated, KeepHeight):
            found["above"] += not words[at - 1].startswith("<")  # 5 cm above the table
    if not isinstance(stated, Before):  # of a list it does not matter who is in it twice
        found.update({key: 1 - found[key] for key in found if key.startswith("agent_")})
    found.update(senses(words, stated))
    if isinstance(stated, Direction | KeepLevel):
        found.update(turned(words))
    return found


def denials(words: list[str]) -> int:
    return sum(word in DENIES.split() for word in words)


def clauses(text: str) -> Iterator[list[str]]:
    """The parts of a sentence that say one thing each."""
    for part in CLAUSES.split(tidy(text)):
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


def edges(words: list[str]) -> set[str]:
    """What is said of an event: that it begins, or that it is over."""
    found = {"begins"} & {"begins" for word in words if word in BEGIN.split()}
    perfect = any(
        word in ("has", "have", "had") and following != "to" for word, following in pairwise([*words, ""])
    )
    if perfect or set(words) & (set(END.split()) | OVER):
        found.add("is over")
    if {"is", "lies", "be"} & set(words) and "on" in words:
        found.add("is over")
    return found


def misplaced(text: str, stated: Statement) -> str:
    """Whether an event that begins is taken for one that is over, or the other way round."""
    if not isinstance(stated, Before):
        return ""
    first = f"agent_{stated.first.agent}" if isinstance(stated.first, Step) else stated.first.object
    for words in clauses(text):
        is_first = first in words and (isinstance(stated.first, Step) or "on" in words)
        allowed = {"is over"} if is_first else {"begins"}
        passive = {"is", "be"} & set(words) and "by" in words and "on" not in words
        if wrong := edges(words) - allowed - ({"is over"} if passive else set()):
            return f"{' '.join(words)!r} {' and '.join(wrong)}"
    return ""


def waits(words: list[str]) -> bool:
    """Whether what is mentioned first is what has to wait."""
    if words[0] in ("after", "once", "first") or words[:2] in (["only", "after"], ["only", "once"]):
        return False
    if denials(words) or words[0] == "before":
        return True
    return bool({"wait", "waits"} & set(words)) or not ({"before", "then"} & set(words))


def amiss(words: list[str], stated: Statement) -> str:
    """What is wrong with how a statement of its kind is said: denied, timed, allowed or ordered."""
    text, denied = " ".join(words), denials(words)
    allowed = {"may", "can", "could"} & set(words)
    match stated:
        case AvoidAgents() | AvoidObjects() | KeepOut():
            if denied + ("avoid" in text) + ("out of" in text) != 1:
                return "denied twice, or not at all"
        case SpeedLimit():
            slow = any(each in text for each in ("slower than", "no faster than", "at most", "no more than"))
            if ("faster than" in text and "no faster than" not in text) != (denied == 1) or slow == (
                denied == 1
            ):
                return "the wrong way round"
        case Before():
            if denied > 1 or (denied and not {"before", "until"} & set(words)):
                return "denied"
            if denied and {"wait", "waits"} & set(words):
                return "denied"
        case _ if denied:
            return "denied"
        case _:
            pass
    later = isinstance(stated, Before) and {"only", "before", "then"} & set(words)
    if allowed and not (denied or later or isinstance(stated, ShareSpace)):
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
        apart |= bool(before == "within" and at_once and value_s <= SHORT_S)
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
        if (words.index(then) < words.index(first)) != waits(words):
            return "the wrong one waits"
    if isinstance(stated, KeepLevel) and {"vertical", "vertically"} & set(words):
        return "vertical is not level"
    return ""


def defaults(stated: Statement, said: Counter[str]) -> Counter[str]:
    """What the sentence of a statement adds to what it was read from."""
    added: Counter[str] = Counter()
    if isinstance(stated, Together) and not any(key.endswith(" s>") for key in said):
        added["<0.1 s>"] += 1
    if isinstance(stated, KeepLevel) and not any(key.endswith(" deg>") for key in said):
        added["<10 deg>"] += 1
    if not any(key.startswith("agent_") for key in said):  # those that it is filed under
        added.update(f"agent_{agent}" for agent in stated.agents)
    return added


def misread(text: str, stated: Statement) -> str:
    """What is wrong with the reading of a sentence; empty if nothing is."""
    words = words_of(tidy(text))
    lexicon = {*WITH_WHAT[type(stated)].split(), *OBJECTS, *POINTS, "turns"}
    if isinstance(stated, DOING):
        lexicon |= SENSE.keys()
    if isinstance(stated, Direction):
        lexicon |= {"level", "perpendicular", "vertical", "horizontal"}
        lexicon |= {"perpendicularly", "vertically", "horizontally"}
    strange = [
        word
        for word in words
        if not (
            word in lexicon or word == "," or word.startswith(("<", "agent_")) or re.fullmatch(NUMBER, word)
        )
    ]
    if strange:
        return f"words that say something else: {strange}"
    said, says = content(text, stated), content(stated.sentence, stated)
    if unread := said - says:
        return f"words that were not read: {dict(unread)}"
    if invented := (says - said) - defaults(stated, said):
        return f"words that are not there: {dict(invented)}"
    return misplaced(text, stated) or amiss(words, stated)
