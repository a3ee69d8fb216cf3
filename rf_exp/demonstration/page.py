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

from rf_exp.artifacts import atomic_path, render_template, write_text
from rf_exp.constraints import CheckedPlan
from rf_exp.constraints.stl import Execution, evaluate_check, rtamt_installed, signals
from rf_exp.datagen import Outcome, Settings
from rf_exp.demonstration.episode_log import Phase, Picture, Round
from rf_exp.findings import Violation
from rf_exp.statements import Statement
from rf_exp.texts.markdown import Markdown, block, cell, code, table
from rf_exp.texts.markdown import text as words
from rf_exp.types import CONTROL_DT_S, ConstraintSet
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult

TEMPLATES = Path(__file__).with_name("templates")
MARKDOWN_READER = MarkdownIt("commonmark").enable("table")
FIGURES = {
    "lanes": "Who does what when",
    "diagrams": "Coordination diagrams: the schedule of each pair of agents",
}


def specification(checked: CheckedPlan, execution: Execution) -> dict[str, Any]:
    """The active checks of an executed plan, as plain JSON values: formulas, robustness, and signals (T,).

    Robustness is null where nothing was judged; without rtamt so is `holds`.
    """
    checks = []
    for check in checked.checks:
        stl = check.stl(execution.plan.task)
        results = evaluate_check(execution, check) if rtamt_installed() else (None,) * len(stl.formulas)
        formulas = [
            {
                "stl": formula.text,
                "unit": formula.unit,
                "strict": formula.strict,
                "robustness": result.robustness if result is not None and result.applies else None,
                "holds": None if result is None else result.holds,
            }
            for formula, result in zip(stl.formulas, results, strict=True)
        ]
        checks.append(
            {"check": repr(check), "text": check.text, "silent": stl.no_formulas_reason, "formulas": formulas}
        )
    return {
        "begins_s": execution.plan.begins_s,
        "period_s": CONTROL_DT_S,
        "checks": checks,
        "signals": {
            result.name: {
                "unit": result.unit,
                "how": result.description,
                "values": execution.values(result).tolist(),
            }
            for result in signals(execution, checked.checks)
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

    `plans`: what `specification` gives for each executed round.
    """
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    feedback = [None, *(each.violation for each in rounds)]
    specifications = iter(plans)
    page = render_template(
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
            _round(folder, k, each, feedback[k - 1], settings.constraint_set)
            | {"specification": next(specifications) if each.results else None}
            for k, each in enumerate(rounds, 1)
        ],
        data=path.with_suffix(".json").name,
        end=_picture(folder, "end.jpg", end, "The end, seen by the global camera"),
    )
    write_text(path, page)
    write_text(path.with_suffix(".html"), webpage(page))


def webpage(page: str) -> str:
    """The page as HTML, with pictures beside it. External text in `page` has to be escaped already."""
    tokens = MARKDOWN_READER.parse(page)
    title, sections = "", []
    for heading, content in pairwise(tokens):
        title_text = "".join(each.content for each in content.children or ())
        if heading.type == "heading_open" and heading.tag == "h1":
            title = title_text
        elif heading.type == "heading_open" and heading.tag == "h2":
            sections.append((anchor := f"part-{len(sections) + 1}", title_text))
            heading.attrSet("id", anchor)
    body = MARKDOWN_READER.renderer.render(tokens, MARKDOWN_READER.options, {})
    return render_template(TEMPLATES / "page.html", title=title, sections=sections, body=body)


def _round(
    folder: Path, number: int, current: Round, feedback: Violation | None, constraint_set: ConstraintSet
) -> dict[str, Any]:
    """A round as values for the template."""
    files = {name: f"round-{number}-{name}.png" for name in current.figures}
    pictures = [_picture(folder, files[key], current.figures[key], FIGURES[key]) for key in files]
    reached = [phase for phase in current.phases if phase.reached]
    return {
        "round": current,
        "verdict": "executed" if current.violation is None else "stopped" if current.results else "rejected",
        "feedback": f", told of the violated {feedback.check}," if feedback is not None else "",
        "stated": _stated(current, constraint_set),
        "calls": []
        if current.code is None
        else [repr(check) for check in current.code.enabled(constraint_set)],
        "figures": pictures,
        "phases": [_phase(folder, number, index, phase, current) for index, phase in enumerate(reached)],
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
    robustness = "nothing was judged"
    if formula["robustness"] is not None:
        robustness = cell(text.quantity(formula["robustness"], formula["unit"]))
    return robustness, "holds" if formula["holds"] else "**violated**"


def _stated(current: Round, constraint_set: ConstraintSet) -> list[tuple[Statement, Markdown]]:
    """Each constraint as RoboBrain stated it, with the check that RoboChecker made of it.

    Those that the set switches off are marked, as the plan need not satisfy them.
    """
    stated = current.proposal.constraints if current.proposal is not None else ()
    if current.code is None:
        return [(each, Markdown("not understood")) for each in stated]
    checks = (
        Markdown("*switched off*: " * (check.kind in constraint_set.off) + code(repr(check)))
        for check in current.code.checks
    )
    return list(zip(stated, checks, strict=True))


def _phase(folder: Path, round_number: int, index: int, phase: Phase, current: Round) -> dict[str, Any]:
    """A phase with the checks that are decided in it; its number is `<round>.<phase>`."""
    following = current.phases[index + 1 :]
    begins_s, ends_s = phase.begins_s if index else -inf, following[0].begins_s if following else inf

    def decided_here(results: Iterable[CheckResult]) -> list[CheckResult]:
        """The checks decided in this phase; the first phase has all earlier ones too, the last all later."""
        return [each for each in results if begins_s <= each.time_s < ends_s]

    number = f"{round_number}.{index + 1}"
    return {
        "number": number,
        "span": f"from {phase.begins_s:.2f} s" + (f" to {ends_s:.2f} s" if following else ""),
        "picture": _picture(folder, f"phase-{number}.jpg", phase.picture, f"The beginning of phase {number}"),
        "goals": phase.goals,
        "planned": decided_here(current.results),
        "measured": decided_here(current.measured.values()),
    }


def _picture(folder: Path, name: str, picture: Picture | None, caption: str) -> Markdown | None:
    """Writes the picture to the folder; returns its Markdown."""
    if picture is None:
        return None
    _, data = cv2.imencode(Path(name).suffix, picture[..., ::-1])
    with atomic_path(folder / name) as draft:
        draft.write_bytes(data.tobytes())
    return Markdown(f"![{words(caption)}]({quote(f'{folder.name}/{name}')})")
