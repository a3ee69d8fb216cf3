"""Pages of the suite with untrusted words in every place: none of them becomes markup."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from rf_exp.ablation import Results
from rf_exp.ablation.formats import markdown
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.inputs import TaskFacts
from rf_exp.datagen import Outcome, Settings
from rf_exp.datagen.brain import ScriptedSpec
from rf_exp.demonstration.episode_log import Phase, Round
from rf_exp.demonstration.page import write_page
from rf_exp.findings import Account, Cause, CheckName, Finding, Unmet, Violation
from rf_exp.statements import Proposal, UnparsedStatement
from rf_exp.store import Description, Store, card
from rf_exp.types import ConstraintSet, Measured, Rollout, Subgoal, Verdict
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult
from tests.ablation.conftest import evaluation, generation
from tests.conftest import read_task
from tests.store.episodes import AGENTS, CAMERAS, HEIGHT, IDENTITY, OBJECTS, WIDTH
from tests.test_data import LABELS
from tests.trust.payloads import EXTENSIONS, MARK, MARKUP, structure

LIFT = read_task("lift_barrier")
CODE = ("p", "pre", "code", "div", "span", "!--")  # tags of code blocks, and of paragraphs that they end


def refusal(payload: str) -> Violation:
    return Violation(
        check=CheckName.BRAIN, cause=Cause.ANSWER, finding=Finding.REFUSED, time_s=0.0, refusal=payload,
        constraint=payload,
    )  # fmt: skip


def results(payload: str) -> tuple[CheckResult, ...]:
    return tuple(CheckResult(payload, payload, ok, 0.1, 0.2, payload, 1.0, payload) for ok in (True, False))


def tables(payload: str, folder: Path) -> str:
    """All tables, with the payload in the file of a task and in rows."""
    suite = {"lift_barrier": TaskFacts(payload, 2, payload, payload, "1")}
    account = Account(unmet=(Unmet(payload),), ended=payload)
    rows = [replace(row, account=account) for row in generation("lift_barrier", "full", 3, 2)]
    rollouts = [
        *evaluation("lift_barrier", "separate_local", 50, 3, 2),
        *evaluation("lift_barrier", "separate_local", 50, 3, 2, recipe="fast"),
        *evaluation("lift_barrier", "separate_local", 50, 3, 2, shield=True, recipe="fast"),
        *evaluation("lift_barrier", "separate_local", 50, 3, 2, constraints="logical"),
        *evaluation("lift_barrier", "foreign", 0, 3, 2, recipe="theirs", version="2"),
    ]
    by_name = build(Results(tuple(rows), tuple(rollouts), (payload,)), suite)
    return "\n".join(map(markdown, by_name.values()))


def data_card(payload: str, folder: Path) -> str:
    """The card of a store with the payload in its attributes."""
    description = Description(
        language=dict.fromkeys(("title", "description", "target_condition"), payload),
        conditions=(payload.replace("/", ""),),
        world_from_base=[], camera_models={}, depth=False, labels=LABELS,
    )  # fmt: skip
    path = folder / "data.zarr"
    Store.create(path, IDENTITY, AGENTS, CAMERAS, HEIGHT, WIDTH, OBJECTS, True).close()
    store = Store.open(path)
    changed = {"criteria_version": payload, "generator": payload, "commit": payload}
    store.attrs.update(vars(description), **changed, task=payload, objects=[payload], cameras=[payload])
    store.attrs.update(versions={payload: payload}, identity={payload: payload, "row": {"name": payload}})
    return card(store)


def demonstration(payload: str, folder: Path) -> str:
    """The page of an episode, with an answer that is not JSON, and one that cannot be parsed."""
    task = replace(LIFT, title=payload, description=payload, target_condition=payload)
    settings = Settings.configured(task, ConstraintSet(payload, spatial=False), ScriptedSpec())
    goal = Subgoal(1, "grasp", payload, payload)
    proposal = Proposal((goal,), (UnparsedStatement("logical", (1,), payload, payload),))
    phase = Phase(0.0, (goal,), reached=True)
    rejected = Round(0.0, results=results(payload), phases=(phase,), violation=refusal(payload))
    rejected.measured = {payload: results(payload)[0]}
    unreadable = Round(0.0, answer=payload, violation=refusal(payload))
    unparsed = Round(0.0, answer=payload, proposal=proposal, violation=refusal(payload))
    formula = {"stl": payload, "unit": payload, "strict": True, "robustness": 0.5, "holds": True}
    checks = [{"check": payload, "text": payload, "silent": payload, "formulas": [formula]}]
    checks += [{**checks[0], "formulas": []}]
    outcome = Outcome(0, False, False, 3, 1, 0, 1.0, Account(ended=payload))
    write_page(
        folder / "page.md", settings, outcome, [unreadable, unparsed, rejected], [{"checks": checks}], None
    )
    return (folder / "page.md").read_text("utf-8")


def recording_texts(payload: str, folder: Path) -> str:
    """The texts of recordings."""
    verdict = Verdict(
        False, False, {payload: False, "lifted": True}, {payload: Measured(False, 1.0, 2.0, payload, True)}
    )
    verdict = verdict._replace(lost={payload: payload})
    rollout = Rollout(0, False, False, 3, 1, 0, Account(ended=payload), 1)
    proposal = Proposal(
        (Subgoal(1, "grasp", payload),), (UnparsedStatement("logical", (1,), payload, payload),)
    )
    parts = (
        text.proposal(proposal), text.code_with_values(results(payload)), text.verdicts(results(payload)),
        text.summary(results(payload)), text.conditions(verdict, {payload: 1, "lifted": 2}),
        text.outcome(rollout),
    )  # fmt: skip
    return "\n\n".join(parts)


@pytest.mark.slow
@pytest.mark.parametrize("page", [tables, data_card, demonstration, recording_texts])
def test_payloads_add_no_markup_to_pages(page: Callable[[str, Path], str], tmp_path: Path) -> None:
    """No tags, links or cells beyond those with a plain word, except for code blocks.

    `test_markdown` tests every payload; here a few of them test every place.
    """

    def tags_of(payload: str, folder: str) -> list[list[tuple[str, tuple]]]:
        (tmp_path / folder).mkdir()
        content, tags_per_reader = page(payload, tmp_path / folder), []
        for extensions in EXTENSIONS[1:]:
            tags, words = structure(content, extensions)
            assert MARK in words
            tags_per_reader.append([tag for tag in tags if tag[0].strip("/") not in CODE])
        return tags_per_reader

    plain = tags_of(MARK, "plain")
    for number, payload in enumerate((*MARKUP[::4], f"{MARK} | x |", f"{MARK} {{: onclick={MARK}() }}")):
        assert tags_of(payload, str(number)) == plain, payload
