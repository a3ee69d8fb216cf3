"""A demonstration as a Markdown page with its pictures; templates/page.md says how it reads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2

from rf_exp.artifacts import rendered, whole, write_text
from rf_exp.datagen import Outcome, Settings
from rf_exp.demonstration.notes import Phase, Picture, Round
from rf_exp.findings import Violation
from rf_exp.statements import Statement
from rf_exp.texts.markdown import Markdown, block, cell, code, table
from rf_exp.texts.markdown import text as words
from rf_exp.types import CONTROL_DT_S, ConstraintSet, Subgoal
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult

TEMPLATE = Path(__file__).with_name("templates") / "page.md"
FIGURES = {
    "lanes": "Who does what when",
    "diagrams": "Coordination diagrams: the schedule of each pair of agents",
}


@dataclass(frozen=True)
class Shown:
    """A picture that lies beside the page."""

    caption: str
    path: str  # as seen from the page


@dataclass(frozen=True)
class PhaseShown:
    """A phase, with the checks that are decided in it."""

    number: str  # of its round and of its own
    span: str
    picture: Shown | None
    goals: tuple[Subgoal, ...]
    planned: tuple[CheckResult, ...]
    measured: tuple[CheckResult, ...]


@dataclass(frozen=True)
class RoundShown:
    """A round, with what is to be said about it."""

    made: Round
    verdict: str
    told: str  # of which violation RoboBrain knew
    stated: tuple[tuple[Statement, Markdown], ...]  # each constraint beside the check that was made of it
    calls: tuple[str, ...]  # of the check code
    figures: tuple[Shown, ...]
    phases: tuple[PhaseShown, ...]
    specified: Mapping[str, Any] | None  # in signal temporal logic, where it was executed


def write_page(
    path: Path,
    settings: Settings,
    outcome: Outcome,
    rounds: Sequence[Round],
    plans: Sequence[Mapping[str, Any]],
    end: Picture | None,
) -> None:
    """Writes `path` (.md) and, beside it, a folder of the same name with the pictures.

    `plans`: of each round that was executed what it is in signal temporal logic.
    """
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    known = [None, *(each.violation for each in rounds)]
    executed = iter(plans)
    page = rendered(
        TEMPLATE,
        text=text,
        block=block,
        code=code,
        picture=_shown,
        formulas=_formulas,
        task=settings.task,
        constraint_set=settings.constraint_set,
        facts=_facts(settings, outcome, len(rounds)),
        recording=path.with_suffix(".rrd").name,
        rounds=[
            _round(folder, k, each, known[k - 1], executed, settings) for k, each in enumerate(rounds, 1)
        ],
        data=path.with_suffix(".json").name,
        succeeded=outcome.success,
        end=_picture(
            folder, "end.jpg", end if outcome.success else None, "The end, seen by the global camera"
        ),
    )
    write_text(path, page)


def _facts(settings: Settings, outcome: Outcome, rounds: int) -> dict[str, object]:
    return {
        "agents": len(settings.task.agents),
        "scene seed": outcome.seed,
        "constraints": settings.constraint_set.name,
        "brain": settings.brain.name,
        "rounds": rounds,
        "length": f"{outcome.steps} control steps, {outcome.steps * CONTROL_DT_S:.2f} s",
        "success": "yes" if outcome.success else f"no: {outcome.reason}",
    }


def _round(
    folder: Path,
    number: int,
    made: Round,
    feedback: Violation | None,
    executed: Iterator[Mapping[str, Any]],
    settings: Settings,
) -> RoundShown:
    verdict = "executed" if made.violation is None else "stopped" if made.results else "rejected"
    drawn = (
        _picture(folder, f"round-{number}-{name}.png", made.figures.get(name), caption)
        for name, caption in FIGURES.items()
    )
    reached = [phase for phase in made.phases if phase.reached]
    return RoundShown(
        made,
        verdict,
        f", told of the violated {feedback.check}," if feedback is not None else "",
        _stated(made, settings.constraint_set),
        tuple(repr(check) for check in made.code.of(settings.constraint_set))
        if made.code is not None
        else (),
        tuple(each for each in drawn if each is not None),
        tuple(_phase(folder, number, index, phase, made) for index, phase in enumerate(reached)),
        next(executed) if made.results else None,
    )


def _shown(picture: Shown) -> Markdown:
    """A picture of the page."""
    return Markdown(f"![{words(picture.caption)}]({quote(picture.path)})")


def _formulas(checks: Sequence[Mapping[str, Any]]) -> Markdown:
    """A table: each check in signal temporal logic, with its robustness."""
    rows: list[tuple[str, ...]] = []
    for check in checks:
        name = code(check["check"])
        if not check["formulas"]:
            rows.append((name, cell(f"none: {check['silent']}"), "", ""))
        rows += [(name, code(each["stl"]), *_judged(each)) for each in check["formulas"]]
    return table(("check", "formula", "robustness", ""), rows)


def _judged(formula: Mapping[str, Any]) -> tuple[str, str]:
    """How robustly a formula holds, and whether it does."""
    if formula["robustness"] is not None:
        found = cell(text.quantity(formula["robustness"], formula["unit"]))
    else:
        found = code("pip install 'rf_exp[stl]'") if formula["holds"] is None else "nothing was judged"
    verdict = "" if formula["holds"] is None else "holds" if formula["holds"] else "**violated**"
    return found, verdict


def _stated(made: Round, constraint_set: ConstraintSet) -> tuple[tuple[Statement, Markdown], ...]:
    """Each constraint as RoboBrain stated it, beside the check that RoboChecker made of it.

    What the set switches off is marked: nothing holds the plan to it.
    """
    stated = made.proposal.constraints if made.proposal is not None else ()
    if made.code is None:
        return tuple((each, Markdown("not understood")) for each in stated)
    return tuple(
        (
            each,
            Markdown(f"{'*switched off*: ' if check.kind in constraint_set.off else ''}{code(repr(check))}"),
        )
        for each, check in zip(stated, made.code.checks, strict=True)
    )


def _phase(folder: Path, of: int, index: int, phase: Phase, made: Round) -> PhaseShown:
    later = made.phases[index + 1 : index + 2]
    ends_s = later[0].begins_s if later else None

    def within(results: Sequence[CheckResult]) -> tuple[CheckResult, ...]:
        """The checks that are decided in this phase; the last one takes what comes after it."""
        first = phase is made.phases[0]
        return tuple(
            each
            for each in results
            if (first or each.time_s >= phase.begins_s) and (ends_s is None or each.time_s < ends_s)
        )

    number = f"{of}.{index + 1}"
    return PhaseShown(
        number,
        f"from {phase.begins_s:.2f} s" + (f" to {ends_s:.2f} s" if ends_s is not None else ""),
        _picture(folder, f"phase-{number}.jpg", phase.picture, f"The beginning of phase {number}"),
        phase.goals,
        within(made.results),
        within(tuple(made.measured.values())),
    )


def _picture(folder: Path, name: str, picture: Picture | None, caption: str) -> Shown | None:
    if picture is None:
        return None
    _, data = cv2.imencode(Path(name).suffix, picture[..., ::-1])
    with whole(folder / name) as draft:
        draft.write_bytes(data.tobytes())
    return Shown(caption, f"{folder.name}/{name}")
