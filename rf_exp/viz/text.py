"""Proposals, check code and evidence as Markdown, for recordings and for pages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from rf_exp.findings import Violation
from rf_exp.statements import Proposal
from rf_exp.texts import markdown, one_line
from rf_exp.texts.markdown import Markdown
from rf_exp.types import CONTROL_DT_S, Measured, Rollout, Subgoal, Verdict

LEAST = 5e-4  # smaller numbers are shown as 0


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
        own = [markdown.text(goal.text) for goal in goals if goal.agent == agent]
        lines += [f"**Agent {agent}**", "", *(f"{number}. {text}" for number, text in enumerate(own, 1)), ""]
    return Markdown("\n".join(lines))


def proposal(answer: Proposal) -> Markdown:
    """RoboBrain's answer: subgoals of each agent, then the constraints as it stated them, by kind."""
    stated = [
        f"- *{each.kind}*, agents {', '.join(map(str, each.agents))}: {markdown.text(each.sentence)}"
        for each in answer.constraints
    ]
    return Markdown(f"{subgoals(answer.subgoals)}\n**Constraints**\n\n" + "\n".join(stated))


def code(checks: Sequence[str]) -> Markdown:
    """Check code, one call per line, joined by `and`."""
    return markdown.block("\nand ".join(map(one_line, checks)), "python")


def judged_code(results: Sequence[CheckResult]) -> Markdown:
    """Check code with the value and the bound of each check beside it."""
    lines = []
    for each in results:
        value, bound = (quantity(number, each.unit) for number in (each.value, each.bound))
        lines.append(f"{each.code}  # {'holds' if each.ok else 'VIOLATED'}: {value}, bound {bound}")
    return code(lines)


def verdicts(results: Sequence[CheckResult]) -> Markdown:
    """A table: a row for each check, with value, bound, time and reason."""
    rows = [
        (
            "holds" if each.ok else "**violated**",
            markdown.code(each.code),
            *(markdown.cell(quantity(number, each.unit)) for number in (each.value, each.bound)),
            f"{each.time_s:.2f} s",
            markdown.cell(each.reason),
        )
        for each in results
    ]
    return markdown.table(("", "check", "value", "bound", "at", "evidence"), rows)


def summary(results: Sequence[CheckResult]) -> Markdown:
    """The verdict of the whole check code, in words."""
    failed = [each for each in results if not each.ok]
    if failed:
        return Markdown(f"**False**: {len(failed)} of {len(results)} checks are violated.")
    return Markdown(f"**True**: all {len(results)} checks hold.")


def violation(found: Violation) -> str:
    """One line about a violation: agents, constraint and evidence. A refusal has no value and no bound."""
    agents = " and ".join(f"agent {agent}" for agent in found.agents)
    value, bound = quantity(found.value, found.unit), quantity(found.bound, found.unit)
    numbers = f"{value}, bound {bound}, " if found.value or found.bound else ""
    return f"{f'{agents}: ' if agents else ''}{found.sentence} ({numbers}at {found.time_s:.2f} s)"


def measured(found: Measured, digits: int) -> str:
    """The value of a condition with its unit; 0 for noise of the physics."""
    value = f"{found.value:.{digits}g}" if abs(found.value) >= LEAST else "0"
    return f"{value} {found.unit}"


def conditions(verdict: Verdict, since: Mapping[str, int]) -> Markdown:
    """A table: a row for each condition of success, with its value and the time of its last change."""
    rows = []
    for name, holds in verdict.evidence.items():
        found = verdict.measured.get(name)
        said = (name, *((measured(found, 3), found.asked) if found is not None else ("", "")))
        mark = "holds" if holds else "**not yet**"
        rows.append((mark, *map(markdown.cell, said), f"{since[name] * CONTROL_DT_S:.2f} s"))
    lost = [markdown.text(f"{name} is {how}") for name, how in verdict.lost.items()]
    lines = [markdown.table(("", "condition", "value", "asked", "since"), rows)]
    return Markdown("\n".join([*lines, *(["", *(f"- {each}" for each in lost)] if lost else [])]))


def outcome(result: Rollout) -> Markdown:
    """Outcome of a rollout, with a bullet for each failure or event."""
    ended = f"{'Succeeded' if result.success else 'Failed'} after {result.steps * CONTROL_DT_S:.2f} s"
    counts = f"{result.violations} steps with a violation, {result.contacts} with contact between arms."
    if result.interventions:
        counts += f" In {result.interventions} steps the shield kept an arm from its command."
    told = [] if result.success else [f"- {markdown.text(part)}" for part in result.account.parts]
    return Markdown("\n".join([f"**{ended}**", "", counts, "", *told]))


def withheld(reasons: Mapping[int, str]) -> str:
    """The shield in a control step, in words; `reasons`: agent -> why its command was withheld."""
    said = ", ".join(f"agent {agent} {reason}" for agent, reason in sorted(reasons.items()))
    return f"shield: {said or 'all may go on'}"


def quantity(number: float, unit: str) -> str:
    """A value with its unit; `none` where there was nothing to measure."""
    return f"{round(number, 4) + 0.0:g} {unit}".strip() if isfinite(number) else "none"
