"""Round trip of the constraint language: the sentence of a statement is parsed to the same statement."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
    LiesOn,
    PlaceAt,
    SameHeight,
    ShareSpace,
    SpeedLimit,
    Statement,
    Step,
    Together,
    UnparsedStatement,
    Vocabulary,
    kinds,
    read,
    samples,
)
from tests.conftest import CONF
from tests.constraints.robots import team
from tests.statements.sentences import FOOD

AGENT, OBJECT = st.sampled_from((1, 2)), st.sampled_from(("lid", "pot", "steak"))
VERB = st.sampled_from(("grasp", "lift", "carry", "place", "strike", "press", "shut", "release", "hold"))
STEP = st.builds(Step, AGENT) | st.builds(Step, AGENT, VERB, OBJECT)
SECONDS = st.floats(0, 600, allow_subnormal=False)
TOLERANCE = st.floats(0, 10, allow_subnormal=False)
CORNERS = st.tuples(*[st.floats(-9, 9, allow_subnormal=False)] * 3).map(
    lambda low: (tuple(value + 0.0 for value in low), tuple(value + 0.5 for value in low))
)
LENGTH = st.floats(0, 2, allow_subnormal=False)
PAIR = st.sampled_from(((1, 2), (2, 1)))


def step_of_other_agent(step: Step) -> st.SearchStrategy[Step]:
    return STEP.filter(lambda then: then.agent != step.agent)


BEFORE = STEP.flatmap(
    lambda first: st.builds(
        Before, st.just(first) | st.builds(LiesOn, OBJECT), step_of_other_agent(first), SECONDS
    )
)
STRATEGIES: dict[type[Statement], st.SearchStrategy[Statement]] = {
    ContactAt: st.sampled_from((("lid", "knob"), ("steak", "center"))).flatmap(
        lambda at: st.builds(ContactAt, AGENT, st.just("grasp"), st.just(at[0]), st.just(at[1]))
    ),
    PlaceAt: st.builds(PlaceAt, AGENT, OBJECT, st.just("pot"), st.just("inside")),
    Direction: st.builds(
        Direction, AGENT, OBJECT, st.sampled_from(("vertical", "horizontal", "level")), st.none() | VERB
    )
    | st.builds(
        Direction, AGENT, OBJECT, st.just("perpendicular"), st.sampled_from((None, "grasp", "press", "shut"))
    ),
    SameHeight: st.builds(SameHeight, PAIR) | st.builds(SameHeight, PAIR, VERB, OBJECT),
    Before: BEFORE,
    Together: st.builds(Together, PAIR, VERB, OBJECT, TOLERANCE)
    | st.builds(Together, PAIR, within_s=TOLERANCE),
    Deadline: st.builds(Deadline, STEP, SECONDS),
    ShareSpace: st.builds(ShareSpace, PAIR),
    KeepApart: st.builds(KeepApart, st.just((1, 2)), LENGTH, st.sampled_from(("grippers", "arms"))),
    KeepLevel: st.builds(KeepLevel, OBJECT, st.floats(0, 90, allow_subnormal=False), st.none() | AGENT),
    KeepHeight: st.builds(KeepHeight, AGENT, LENGTH, st.sampled_from(("below", "above"))),
    SpeedLimit: st.builds(SpeedLimit, AGENT, st.floats(0.01, 10)),
    AvoidAgents: st.sampled_from((AvoidAgents((1,)), AvoidAgents((2,)), AvoidAgents((1, 2)))),
    AvoidObjects: st.builds(AvoidObjects, AGENT),
    KeepOut: CORNERS.flatmap(
        lambda box: (
            st.builds(KeepOut, st.just(1), st.just(box[0]), st.just(box[1]))
            | st.builds(KeepOut, st.just(1), st.just(box[0]), st.just(box[1]), st.just(2) | OBJECT)
            | st.builds(
                KeepOut,
                st.just(1),
                st.just(box[0]),
                st.just(box[1]),
                until=STEP.filter(lambda step: step.agent == 2) | st.builds(LiesOn, OBJECT),
            )
        )
    ),
}


def test_every_kind_has_a_strategy():
    assert set(STRATEGIES) == set(kinds()) - {UnparsedStatement}


@pytest.mark.slow
@pytest.mark.parametrize("kind", STRATEGIES, ids=lambda kind: kind.__name__)
def test_the_sentence_of_a_statement_is_parsed_to_the_statement(kind):
    """For all kinds of statements."""

    @settings(max_examples=150, deadline=5000)
    @given(STRATEGIES[kind])
    def round_trip(stated: Statement) -> None:
        assert read(stated.sentence, FOOD.vocabulary) == stated

    round_trip()


def test_the_documentation_shows_every_sample():
    text = (CONF.parent / "docs/constraints.md").read_text("utf-8")
    assert [each.sentence for each in samples() if f"| {each.kind} | {each.sentence} |" not in text] == []


def test_samples_cover_every_kind_and_are_parsed():
    team_vocabulary = team(3).vocabulary
    points = {"barrier": {"left": "grasp"}, "lid": {}, "steak": {}, "pot": {"inside": "drop"}}
    vocabulary = Vocabulary(team_vocabulary.agents, points)
    shown = list(samples())
    assert {type(sample) for sample in shown} == set(STRATEGIES)
    assert [read(sample.sentence, vocabulary) for sample in shown] == shown
