"""The findings there are, and the form of the sentence about each. Nothing reads such a sentence.

What a form names in braces is a fact of `Found`, or written from them (`violation`).
"""

from enum import StrEnum


class Finding(StrEnum):
    """What was found, with the form of its sentence: here after the first colon."""

    form: str

    def __new__(cls, said: str) -> "Finding":
        code, _, form = said.partition(": ")
        found = str.__new__(cls, code)
        found._value_, found.form = code, form
        return found

    # Where and how an object is met.
    BESIDE_POINT = (
        "meets it beside the point: {a} {meets} {object} {cm:.1f} cm from its {aspect} point (allowed "
        "{bound_cm:.1f} cm)"
    )
    PUT_BESIDE_POINT = (
        "puts it beside the point: {a} would put {object} {cm:.1f} cm beside the {aspect} (allowed "
        "{bound_cm:.1f} cm)"
    )
    NO_CONTACT = (
        "makes no contact: {a} must meet {object} at its {aspect} point, but {a} neither holds {object} nor "
        "makes contact with it in this plan; its subgoals that move: {listed}"
    )
    NO_DIRECTION = (
        "makes no contact that has a direction: the gripper of {a} must be {aspect} at {object}, but {a} "
        "neither holds {object} nor makes contact with it in this plan; its subgoals that move: {listed}"
    )
    OFF_DIRECTION = (
        "comes from another direction: the gripper of {a} is {value:.0f} deg off {aspect} at {object} "
        "(allowed {bound:.0f} deg)"
    )
    UNEVEN = (
        "heights drift apart: the gripper heights of {agents} drift {cm:.1f} cm apart (allowed "
        "{bound_cm:.1f} cm)"
    )
    TILTED = (
        "tilts it: {at} {object}, held by {a} ({state}), is tilted by {value:.1f} deg (allowed {bound:g} deg)"
    )
    HOLDS_IT = "holds it already: {a} holds {object} already"

    # Order and time.
    TOO_SOON = "begins too soon: {then} begins {value:.2f} s after {first} has ended (at least {bound:g} s)"
    NOT_TOGETHER = "does not begin together: {agents} begin {first} {value:.2f} s apart (allowed {bound:g} s)"
    TOO_LATE = "ends too late: {first} ends {value:.2f} s after the start of the plan (allowed {bound:g} s)"
    TOO_FAST = (
        "moves too fast: {at} the gripper of {a} ({state}) moves at {value:.2f} m/s (allowed {bound:.2f} m/s)"
    )
    SHARED = (
        "shares space: {a} and {b} use the same space one after the other: closest in time {at}, when {b} "
        "comes to where {a} has been until {value:.2f} s before"
    )
    NOT_SHARED = "shares no space: {agents} use no space that another of them uses at any time"

    # Room.
    CLOSE = (
        "comes too close: {at} {a}, {a_does}, comes within {cm:.1f} cm of {b}, {b_does} ({parts[0]} near "
        "{parts[1]})"
    )
    CLOSE_TO_THING = (
        "comes too close to a thing: {at} {a}, {a_does}, comes within {cm:.1f} cm of {obstacle} "
        "({parts[0]}), which it may not touch"
    )
    TOUCHING = "touch: {both} touch each other with {value:.0f} N"
    OVERLAPPING = "overlap: {both} overlap by {depth_mm:.0f} mm ({parts[0]} with {parts[1]})"
    TOO_NEAR = (
        "does not keep its distance: {at} the {aspect} of {everyone}, are {cm:.1f} cm apart (at least "
        "{bound_cm:.1f} cm)"
    )
    OFF_HEIGHT = (
        "leaves its heights: {at} the gripper of {a} ({state}) is {cm:.1f} cm over the table (it has to stay"
        " {aspect} {bound_cm:.1f} cm)"
    )
    IN_ZONE = "enters a zone: {a} {at} enters the keep-out {obstacle} ({parts[0]}, {state})"
    OUT_OF_ZONE = "stays out of a zone: {a} stays out of the keep-out {obstacle} ({parts[0]}, {state})"
    CLEAR = "stays clear: {both} stay {cm:.1f} cm apart"
    CLEAR_OF_THING = "stays clear of a thing: {a} stays {cm:.1f} cm clear of {obstacle}"

    # Schedules: why there is none.
    UNEQUAL = (
        "plans of other lengths: {both} do {first!r} together but one of them plans {value:g} s more; plan "
        "it as one motion"
    )
    NO_SCHEDULE = (
        "no schedule within the budget: no schedule was found within the search budget; plan fewer subgoals "
        "at once or one after the other"
    )
    CLOSE_AT_FIRST = (
        "stand too close: {both} already stand too close to each other; move one of them away first"
    )
    CLOSE_AT_LAST = (
        "would end too close: {both} would end too close to each other ({a} {a_is}, {b} {b_is}); timing "
        "cannot help, choose another end or retreat"
    )
    PARKED = (
        "stands in the way: where {parked} stands before and after its motion blocks {blocked} {blocked_is};"
        " timing cannot help, {blocked} needs another path or {parked} must yield"
    )
    BLOCKED_BOTH = (
        "block each other: {both} block each other: they get no further than {a} {a_is} and {b} {b_is}; one "
        "of them needs another path or a place to wait"
    )
    ORDERS = (
        "orders that contradict one another: the constraints on the order of {both} contradict one another: "
        "they get no further than {a} {a_is} and {b} {b_is}; drop or change one of them"
    )
    ORDERS_OR_WAYS = (
        "orders that contradict one another, or the way past each other: the constraints on the order of "
        "{both} contradict one another or their way past each other: they get no further than {a} {a_is} and"
        " {b} {b_is}; drop or change one of them"
    )
    DEADLINE = (
        "cannot be done in time: {a} cannot be done within {bound:g} s; the shortest schedule needs "
        "{value:g} s"
    )
    NOT_ALL = (
        "cannot pass all together: every pair of agents could pass, but not all together; let some of them "
        "finish first"
    )

    # Motion: why there is none.
    BLOCKED = "is blocked: {a} cannot {first}: {in_the_way}{how_near}"
    TAKEN = (
        "place is taken: {a} cannot {first}: {object} would overlap {obstacle} there by {depth_mm:.0f} mm; "
        "move one of them"
    )
    NO_PATH = "finds no free path: {a} cannot {first}: no free path{how_near}"
    OUT_OF_REACH = "is out of reach: {a} cannot {first}: out of reach"
    TOO_HIGH = "does not reach that high: {a} cannot {first}: the arm does not reach that high"
    NO_RETREAT = "cannot retreat: {a} cannot retreat after letting go of {object}"
    HOLDS_OTHER = "holds something: {a} already holds {object}"
    HOLDS_NOT = "does not hold it: {a} cannot {first}: it does not hold {object}"
    NO_TARGET = "no such place: there is no place or object {aspect!r}; available: {names}"
    NO_POINT = "no such point: {object} has no place point {aspect!r}; available: {names}"
    NO_PLACE = "no place: {object} has no place point: nothing can be put there"
    CIRCLE = (
        "subgoals that wait for one another: the subgoals wait for one another: their orders are in conflict"
        " ({listed})"
    )
    UNEVEN_LIFT = "lift by different heights: agents lift {object} by different heights"

    # Execution.
    HIT = "hit each other: {everyone}, hit each other with {value:.0f} N (arms stop at {bound:g} N)"
    PUSHES = "pushes: {everyone}, pushes {obstacle} with {value:.0f} N (arms stop at {bound:g} N)"
    DROPPED = "no longer holds: {everyone}, no longer holds {object}"
    STRAYED = (
        "off its path: {everyone}, is {value:.2f} rad off its path (allowed {bound:g} rad): something is in "
        "its way"
    )
    OBJECT_MOVED = "object_moved: a disturbed arm has moved {object} by {mm:.0f} mm"
    CLUTTER_MOVED = "clutter_moved: an arm, or what it carries, has moved {object} by {mm:.0f} mm"

    # Whatever else.
    REFUSED = "not understood: {refusal}"
    IDLE = "not in this plan: nothing in this plan is about it"
    CONSTRAINT = "breaks a constraint: {at} {constraint!r}: {value:.4g} {unit} (bound {bound:g} {unit})"
