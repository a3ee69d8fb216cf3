"""Proposals, check code and evidence as Markdown, for recordings and for pages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from rf_exp.findings import Violation
from rf_exp.statements import Proposal
from rf_exp.texts import markdown, one_line
from rf_exp.texts.markdown import Markdown
from rf_exp.types import CONTROL_DT_S, Measured, Rollout, Subgoal, Verdict

SHOWN_AS_ZERO = 5e-4  # smaller numbers are shown as 0


@dataclass(frozen=True)
class CheckResult:
    """One check of the check code with its evidence."""

    code: str  # as the paper prints it, e.g. VI(Agent_1, barrier, left)
    text: str  # the constraint as it was stated
    ok: bool
    value: float  # measured
    bound: float  # permitted
    unit: str  # of both
    time_s: float  # since the start of the episode
    reason: str


def subgoals(goals: Sequence[Subgoal]) -> Markdown:
    """A bold line for each agent, its subgoals numbered below."""
    lines = []
    for agent in sorted({goal.agent for goal in goals}):
        texts = [markdown.text(goal.text) for goal in goals if goal.agent == agent]
        lines += [
            f"**Agent {agent}**",
            "",
            *(f"{number}. {text}" for number, text in enumerate(texts, 1)),
            "",
        ]
    return Markdown("\n".join(lines))


def proposal(answer: Proposal) -> Markdown:
    """RoboBrain's answer: subgoals of each agent, then the constraints as it stated them, by kind."""
    constraint_lines = [
        f"- *{item.kind}*, agents {', '.join(map(str, item.agents))}: {markdown.text(item.sentence)}"
        for item in answer.constraints
    ]
    return Markdown(f"{subgoals(answer.subgoals)}\n**Constraints**\n\n" + "\n".join(constraint_lines))


def code(checks: Sequence[str]) -> Markdown:
    """Check code, one call per line, joined by `and`."""
    return markdown.block("\nand ".join(map(one_line, checks)), "python")


def code_with_values(results: Sequence[CheckResult]) -> Markdown:
    """Check code with the value and the bound of each check beside it."""
    lines = []
    for result in results:
        value, bound = (quantity(number, result.unit) for number in (result.value, result.bound))
        lines.append(f"{result.code}  # {'holds' if result.ok else 'VIOLATED'}: {value}, bound {bound}")
    return code(lines)


def verdicts(results: Sequence[CheckResult]) -> Markdown:
    """A table: a row for each check, with value, bound, time and reason."""
    rows = [
        (
            "holds" if result.ok else "**violated**",
            markdown.code(result.code),
            *(markdown.cell(quantity(number, result.unit)) for number in (result.value, result.bound)),
            f"{result.time_s:.2f} s",
            markdown.cell(result.reason),
        )
        for result in results
    ]
    return markdown.table(("", "check", "value", "bound", "at", "evidence"), rows)


def summary(results: Sequence[CheckResult]) -> Markdown:
    """The verdict of the whole check code, in words."""
    failed = [result for result in results if not result.ok]
    if failed:
        return Markdown(f"**False**: {len(failed)} of {len(results)} checks are violated.")
    return Markdown(f"**True**: all {len(results)} checks hold.")


def violation(violation: Violation) -> str:
    """One line about a violation: agents, constraint and evidence. A refusal has no value and no bound."""
    agents = " and ".join(f"agent {agent}" for agent in violation.agents)
    value, bound = quantity(violation.value, violation.unit), quantity(violation.bound, violation.unit)
    numbers = f"{value}, bound {bound}, " if violation.value or violation.bound else ""
    return f"{f'{agents}: ' if agents else ''}{violation.sentence} ({numbers}at {violation.time_s:.2f} s)"


def measured(condition: Measured, digits: int) -> str:
    """The value of a condition with its unit; 0 for noise of the physics."""
    value = f"{condition.value:.{digits}g}" if abs(condition.value) >= SHOWN_AS_ZERO else "0"
    return f"{value} {condition.unit}"


def conditions(verdict: Verdict, since: Mapping[str, int]) -> Markdown:
    """A table: a row for each condition of success, with its value and the time of its last change."""
    rows = []
    for name, holds in verdict.evidence.items():
        measurement = verdict.measured.get(name)
        cells = (
            name,
            *((measured(measurement, 3), measurement.requirement) if measurement is not None else ("", "")),
        )
        mark = "holds" if holds else "**not yet**"
        rows.append((mark, *map(markdown.cell, cells), f"{since[name] * CONTROL_DT_S:.2f} s"))
    lost = [markdown.text(f"{name} is {how}") for name, how in verdict.lost.items()]
    lines = [markdown.table(("", "condition", "value", "asked", "since"), rows)]
    return Markdown("\n".join([*lines, *(["", *(f"- {line}" for line in lost)] if lost else [])]))


def outcome(result: Rollout) -> Markdown:
    """Outcome of a rollout, with a bullet for each failure or event."""
    ended = f"{'Succeeded' if result.success else 'Failed'} after {result.steps * CONTROL_DT_S:.2f} s"
    counts = f"{result.violations} steps with a violation, {result.contacts} with contact between arms."
    if result.interventions:
        counts += f" In {result.interventions} steps the shield kept an arm from its command."
    failure_lines = [] if result.success else [f"- {markdown.text(part)}" for part in result.account.parts]
    return Markdown("\n".join([f"**{ended}**", "", counts, "", *failure_lines]))


def withheld(reasons: Mapping[int, str]) -> str:
    """The shield in a control step, in words; `reasons`: agent -> why its command was withheld."""
    parts = ", ".join(f"agent {agent} {reason}" for agent, reason in sorted(reasons.items()))
    return f"shield: {parts or 'all may go on'}"


def quantity(number: float, unit: str) -> str:
    """A value with its unit; `none` where there was nothing to measure."""
    return f"{round(number, 4) + 0.0:g} {unit}".strip() if isfinite(number) else "none"
