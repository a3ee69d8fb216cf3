"""A demonstration as a Markdown page with its pictures."""

from collections.abc import Sequence
from pathlib import Path

import cv2

from rf_exp.datagen.episode import Outcome
from rf_exp.datagen.planning import Settings
from rf_exp.demonstration.notes import Phase, Picture, Round
from rf_exp.types import CONTROL_DT_S, Violation
from rf_exp.viz import text
from rf_exp.viz.text import CheckResult

LEGEND = (
    "VI: Validate Interaction, VD: Validate Direction, VSO: Validate Spatial Occupancy, "
    "VS: Validate Scheduling. The check code is true only when all of them are."
)
FIGURES = {
    "lanes": "Who does what when",
    "diagrams": "Coordination diagrams: the schedule of each pair of agents",
}


def write_page(
    path: Path, settings: Settings, outcome: Outcome, rounds: Sequence[Round], end: Picture | None
) -> None:
    """Writes `path` (.md) and, beside it, a folder of the same name with the pictures."""
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    task = settings.task
    parts = [
        f"# {task.title}: one demonstration",
        " ".join(task.description.split()),
        _facts(settings, outcome, len(rounds)),
        f"Recording of all of it: `rerun {path.with_suffix('.rrd').name}`. {LEGEND}",
    ]
    for number, each in enumerate(rounds, 1):
        parts += _round(folder, number, each, rounds[number - 2].violation if number > 1 else None)
    if outcome.success:
        parts += ["## The end", " ".join(task.target_condition.split())]
        parts += _picture(folder, "end.jpg", end, "The end, seen by the global camera")
    path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")


def _facts(settings: Settings, outcome: Outcome, rounds: int) -> str:
    facts = {
        "agents": len(settings.task.agents),
        "scene seed": outcome.seed,
        "constraints": settings.row.name,
        "brain": settings.brain.name,
        "rounds": rounds,
        "length": f"{outcome.steps} control steps, {outcome.steps * CONTROL_DT_S:.2f} s",
        "success": "yes" if outcome.success else f"no: {outcome.reason}",
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts.items())])


def _round(folder: Path, number: int, shown: Round, feedback: Violation | None) -> list[str]:
    verdict = "executed" if shown.violation is None else "stopped" if shown.results else "rejected"
    told = f", told of the violated {feedback.check}," if feedback is not None else ""
    parts = [f"## Round {number}, at {shown.begins_s:.2f} s: {verdict}"]
    if shown.proposal is not None:
        parts += [f"RoboBrain{told} proposes:", text.subgoals(shown.proposal.subgoals), _constraints(shown)]
    elif shown.answer:
        parts += [f"RoboBrain{told} answers:", f"```json\n{shown.answer}\n```"]
    if shown.results:
        parts += [f"The check code of the whole plan is {text.summary(shown.results)}"]
    elif shown.code is not None:
        parts += [text.code([repr(check) for check in shown.code.checks])]
    for name, caption in FIGURES.items():
        parts += _picture(folder, f"round-{number}-{name}.png", shown.figures.get(name), caption)
    reached = [phase for phase in shown.phases if phase.reached]
    for index, phase in enumerate(reached):
        later = shown.phases[index + 1 : index + 2]
        parts += _phase(folder, f"{number}.{index + 1}", phase, later[0].begins_s if later else None, shown)
    if shown.violation is not None:
        parts += [
            f"### Violation: `{shown.violation.check}`",
            f"{text.violation(shown.violation)}. This is the feedback to RoboBrain.",
        ]
    return parts


def _constraints(shown: Round) -> str:
    """Each constraint as RoboBrain stated it, beside the check that RoboChecker made of it."""
    assert shown.proposal is not None  # only called for one
    stated = shown.proposal.constraints
    checks = (
        [f"`{check!r}`" for check in shown.code.checks] if shown.code else ["not understood"] * len(stated)
    )
    lines = ["| kind | constraint | check |", "|---|---|---|"]
    lines += [
        f"| {each.kind} | {each.sentence} | {check} |" for each, check in zip(stated, checks, strict=True)
    ]
    return "\n".join(lines)


def _phase(folder: Path, number: str, phase: Phase, ends_s: float | None, shown: Round) -> list[str]:
    def within(results: Sequence[CheckResult]) -> list[CheckResult]:
        """The checks that are decided in this phase; the last one takes what comes after it."""
        first = phase is shown.phases[0]
        return [
            each
            for each in results
            if (first or each.time_s >= phase.begins_s) and (ends_s is None or each.time_s < ends_s)
        ]

    span = f"from {phase.begins_s:.2f} s" + (f" to {ends_s:.2f} s" if ends_s is not None else "")
    parts = [f"### Phase {number}, {span} of the plan"]
    parts += _picture(folder, f"phase-{number}.jpg", phase.picture, f"The beginning of phase {number}")
    parts += ["Now begin:", "\n".join(f"- agent {goal.agent}: {goal.text}" for goal in phase.goals)]
    planned, measured = within(shown.results), within(tuple(shown.measured.values()))
    if planned:
        parts += ["Decided in this phase:", text.code([each.code for each in planned])]
        parts += [text.summary(planned), text.verdicts(planned)]
    if measured:
        parts += ["As measured when it happened:", text.verdicts(measured)]
    return parts


def _picture(folder: Path, name: str, picture: Picture | None, caption: str) -> list[str]:
    if picture is None:
        return []
    _, data = cv2.imencode(Path(name).suffix, picture[..., ::-1])
    (folder / name).write_bytes(data.tobytes())
    return [f"![{caption}]({folder.name}/{name})"]
