"""Page about a demonstration, with pictures and formulas, from templates/page.md.

As HTML it has anchors, to which links at the top lead.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
from markdown_it import MarkdownIt

from rf_exp.artifacts import rendered, whole, write_text
from rf_exp.constraints import CheckedPlan
from rf_exp.constraints.stl import Execution, installed, judged, signals
from rf_exp.datagen import Outcome, Settings
from rf_exp.demonstration.notes import Phase, Picture, Round
from rf_exp.findings import Violation
from rf_exp.statements import Statement
from rf_exp.texts.markdown import Markdown, block, cell, code, table
from rf_exp.texts.markdown import text as words
from rf_exp.types import CONTROL_DT_S, ConstraintSet
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult

TEMPLATES = Path(__file__).with_name("templates")
READER = MarkdownIt("commonmark").enable("table")
FIGURES = {
    "lanes": "Who does what when",
    "diagrams": "Coordination diagrams: the schedule of each pair of agents",
}


def specified(checked: CheckedPlan, execution: Execution) -> dict[str, Any]:
    """The active checks of an executed plan, as plain JSON values: formulas, robustness, and signals (T,).

    Robustness is null where nothing was judged; without rtamt so is `holds`.
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
    """Writes the page of a success to `path` (.md), as .html too, and its pictures to a folder of that name.

    `plans`: what `specified` gives for each executed round.
    """
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    known = [None, *(each.violation for each in rounds)]
    executed = iter(plans)
    page = rendered(
        TEMPLATES / "page.md",
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
            "success": "yes",
        },
        recording=path.with_suffix(".rrd").name,
        rounds=[
            _round(folder, k, each, known[k - 1], settings.constraint_set)
            | {"specified": next(executed) if each.results else None}
            for k, each in enumerate(rounds, 1)
        ],
        data=path.with_suffix(".json").name,
        end=_picture(folder, "end.jpg", end, "The end, seen by the global camera"),
    )
    write_text(path, page)
    write_text(path.with_suffix(".html"), webpage(page))


def webpage(page: str) -> str:
    """The page as HTML, with pictures beside it. External text in `page` has to be escaped already."""
    tokens = READER.parse(page)
    title, parts = "", []
    for heading, content in pairwise(tokens):
        said = "".join(each.content for each in content.children or ())
        if heading.type == "heading_open" and heading.tag == "h1":
            title = said
        elif heading.type == "heading_open" and heading.tag == "h2":
            parts.append((anchor := f"part-{len(parts) + 1}", said))
            heading.attrSet("id", anchor)
    body = READER.renderer.render(tokens, READER.options, {})
    return rendered(TEMPLATES / "page.html", title=title, parts=parts, body=body)


def _round(
    folder: Path, number: int, made: Round, feedback: Violation | None, constraint_set: ConstraintSet
) -> dict[str, Any]:
    """A round as values for the template."""
    names = {name: f"round-{number}-{name}.png" for name in made.figures}
    drawn = [_picture(folder, names[key], made.figures[key], FIGURES[key]) for key in names]
    reached = [phase for phase in made.phases if phase.reached]
    return {
        "made": made,
        "verdict": "executed" if made.violation is None else "stopped" if made.results else "rejected",
        "told": f", told of the violated {feedback.check}," if feedback is not None else "",
        "stated": _stated(made, constraint_set),
        "calls": [] if made.code is None else [repr(check) for check in made.code.of(constraint_set)],
        "figures": drawn,
        "phases": [_phase(folder, number, index, phase, made) for index, phase in enumerate(reached)],
    }


def _formulas(checks: Sequence[Mapping[str, Any]]) -> Markdown:
    """Table of the checks in signal temporal logic, with their robustness."""
    rows: list[tuple[str, ...]] = []
    for check in checks:
        name = code(check["check"])
        if not check["formulas"]:
            rows.append((name, cell(f"none: {check['silent']}"), "", ""))
        rows += [(name, code(each["stl"]), *_judged(each)) for each in check["formulas"]]
    return table(("check", "formula", "robustness", ""), rows)


def _judged(formula: Mapping[str, Any]) -> tuple[str, str]:
    if formula["holds"] is None:
        return code("pip install 'rf_exp[stl]'"), ""
    found = "nothing was judged"
    if formula["robustness"] is not None:
        found = cell(text.quantity(formula["robustness"], formula["unit"]))
    return found, "holds" if formula["holds"] else "**violated**"


def _stated(made: Round, constraint_set: ConstraintSet) -> list[tuple[Statement, Markdown]]:
    """Each constraint as RoboBrain stated it, with the check that RoboChecker made of it.

    Those that the set switches off are marked, as the plan need not satisfy them.
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
    """A phase with the checks that are decided in it; its number is `<round>.<phase>`."""
    later = made.phases[index + 1 :]
    begins_s, ends_s = phase.begins_s if index else -inf, later[0].begins_s if later else inf

    def within(results: Iterable[CheckResult]) -> list[CheckResult]:
        """The checks decided in this phase; the first phase has all earlier ones too, the last all later."""
        return [each for each in results if begins_s <= each.time_s < ends_s]

    number = f"{of}.{index + 1}"
    return {
        "number": number,
        "span": f"from {phase.begins_s:.2f} s" + (f" to {ends_s:.2f} s" if later else ""),
        "picture": _picture(folder, f"phase-{number}.jpg", phase.picture, f"The beginning of phase {number}"),
        "goals": phase.goals,
        "planned": within(made.results),
        "measured": within(made.measured.values()),
    }


def _picture(folder: Path, name: str, picture: Picture | None, caption: str) -> Markdown | None:
    """Writes the picture to the folder; returns its Markdown."""
    if picture is None:
        return None
    _, data = cv2.imencode(Path(name).suffix, picture[..., ::-1])
    with whole(folder / name) as draft:
        draft.write_bytes(data.tobytes())
    return Markdown(f"![{words(caption)}]({quote(f'{folder.name}/{name}')})")
