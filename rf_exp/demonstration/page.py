"""A demonstration as a page with its pictures and formulas; templates/page.md says how it reads."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2

from rf_exp.artifacts import rendered, whole, write_text
from rf_exp.constraints import CheckedPlan
from rf_exp.constraints.stl import Execution, installed, judged, signals
from rf_exp.datagen import Outcome, Settings
from rf_exp.demonstration.notes import Phase, Picture, Round
from rf_exp.demonstration.webpage import webpage
from rf_exp.findings import Violation
from rf_exp.statements import Statement
from rf_exp.texts.markdown import Markdown, block, cell, code, table
from rf_exp.texts.markdown import text as words
from rf_exp.types import CONTROL_DT_S, ConstraintSet
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult

TEMPLATE = Path(__file__).with_name("templates") / "page.md"
FIGURES = {
    "lanes": "Who does what when",
    "diagrams": "Coordination diagrams: the schedule of each pair of agents",
}


def specified(checked: CheckedPlan, execution: Execution) -> dict[str, Any]:
    """The active checks of an executed plan, as plain JSON values: formulas, robustness, and signals (T,).

    Robustness is null where nothing was judged; `holds` as well where rtamt is not installed.
    """
    checks = []
    for check in checked.checks:
        form = check.stl(execution.plan.task)
        found = judged(execution, check) if installed() else (None,) * len(form.formulas)
        formulas = [
            {
                "stl": formula.text,
                "unit": formula.unit,
                "strict": formula.strict,
                "robustness": each.robustness if each is not None and each.judged else None,
                "holds": None if each is None else each.holds,
            }
            for formula, each in zip(form.formulas, found, strict=True)
        ]
        checks.append({"check": repr(check), "text": check.text, "silent": form.silent, "formulas": formulas})
    return {
        "begins_s": execution.plan.begins_s,
        "period_s": CONTROL_DT_S,
        "checks": checks,
        "signals": {
            each.name: {"unit": each.unit, "how": each.how, "values": execution.values(each).tolist()}
            for each in signals(execution, checked.checks)
        },
    }


def write_page(
    path: Path,
    settings: Settings,
    outcome: Outcome,
    rounds: Sequence[Round],
    plans: Sequence[Mapping[str, Any]],
    end: Picture | None,
) -> None:
    """Writes `path` (.md), the same for a browser (.html), and a folder of the same name with the pictures.

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
        formulas=_formulas,
        task=settings.task,
        constraint_set=settings.constraint_set,
        facts={
            "agents": len(settings.task.agents),
            "scene seed": outcome.seed,
            "constraints": settings.constraint_set.name,
            "brain": settings.brain.name,
            "rounds": len(rounds),
            "length": f"{outcome.steps} control steps, {outcome.steps * CONTROL_DT_S:.2f} s",
            "success": "yes" if outcome.success else f"no: {outcome.reason}",
        },
        recording=path.with_suffix(".rrd").name,
        rounds=[
            _round(folder, k, each, known[k - 1], settings.constraint_set)
            | {"specified": next(executed) if each.results else None}
            for k, each in enumerate(rounds, 1)
        ],
        data=path.with_suffix(".json").name,
        succeeded=outcome.success,
        end=_picture(
            folder, "end.jpg", end if outcome.success else None, "The end, seen by the global camera"
        ),
    )
    write_text(path, page)
    write_text(path.with_suffix(".html"), webpage(page))


def _round(
    folder: Path, number: int, made: Round, feedback: Violation | None, constraint_set: ConstraintSet
) -> dict[str, Any]:
    """A round, with what is to be said about it."""
    drawn = (
        _picture(folder, f"round-{number}-{name}.png", made.figures.get(name), caption)
        for name, caption in FIGURES.items()
    )
    reached = [phase for phase in made.phases if phase.reached]
    return {
        "made": made,
        "verdict": "executed" if made.violation is None else "stopped" if made.results else "rejected",
        "told": f", told of the violated {feedback.check}," if feedback is not None else "",
        "stated": _stated(made, constraint_set),
        "calls": [] if made.code is None else [repr(check) for check in made.code.of(constraint_set)],
        "figures": [each for each in drawn if each is not None],
        "phases": [_phase(folder, number, index, phase, made) for index, phase in enumerate(reached)],
    }


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
    if formula["robustness"] is not None:
        found = cell(text.quantity(formula["robustness"], formula["unit"]))
    else:
        found = code("pip install 'rf_exp[stl]'") if formula["holds"] is None else "nothing was judged"
    verdict = "" if formula["holds"] is None else "holds" if formula["holds"] else "**violated**"
    return found, verdict


def _stated(made: Round, constraint_set: ConstraintSet) -> list[tuple[Statement, Markdown]]:
    """Each constraint as RoboBrain stated it, beside the check that RoboChecker made of it.

    What the set switches off is marked: nothing holds the plan to it.
    """
    stated = made.proposal.constraints if made.proposal is not None else ()
    if made.code is None:
        return [(each, Markdown("not understood")) for each in stated]
    checks = (
        Markdown("*switched off*: " * (check.kind in constraint_set.off) + code(repr(check)))
        for check in made.code.checks
    )
    return list(zip(stated, checks, strict=True))


def _phase(folder: Path, of: int, index: int, phase: Phase, made: Round) -> dict[str, Any]:
    """A phase, with the checks that are decided in it; its number is of its round and of its own."""
    later = made.phases[index + 1 : index + 2]
    ends_s = later[0].begins_s if later else None

    def within(results: Iterable[CheckResult]) -> list[CheckResult]:
        """The checks that are decided in this phase; the last one takes what comes after it."""
        first = phase is made.phases[0]
        return [
            each
            for each in results
            if (first or each.time_s >= phase.begins_s) and (ends_s is None or each.time_s < ends_s)
        ]

    number = f"{of}.{index + 1}"
    return {
        "number": number,
        "span": f"from {phase.begins_s:.2f} s" + (f" to {ends_s:.2f} s" if ends_s is not None else ""),
        "picture": _picture(folder, f"phase-{number}.jpg", phase.picture, f"The beginning of phase {number}"),
        "goals": phase.goals,
        "planned": within(made.results),
        "measured": within(made.measured.values()),
    }


def _picture(folder: Path, name: str, picture: Picture | None, caption: str) -> Markdown | None:
    """The picture as a file in the folder, and as the page shows it."""
    if picture is None:
        return None
    _, data = cv2.imencode(Path(name).suffix, picture[..., ::-1])
    with whole(folder / name) as draft:
        draft.write_bytes(data.tobytes())
    return Markdown(f"![{words(caption)}]({quote(f'{folder.name}/{name}')})")
