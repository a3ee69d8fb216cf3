"""The report: every table beside the paper's, plots, pictures and where it all came from, in one file."""

from collections import Counter
from pathlib import Path

from rf_exp.ablation import found, page, plots, tables
from rf_exp.ablation.formats import write
from rf_exp.ablation.page import Panel, Section, Texts, Tile
from rf_exp.ablation.results import Results, load
from rf_exp.ablation.rollouts import learnt_from
from rf_exp.ablation.suite import Suite, configured
from rf_exp.ablation.tables import Table, paper, title_of
from rf_exp.artifacts import write_text
from rf_exp.errors import StageError
from rf_exp.types import UNVARIED

REASONS = 30  # at most so many in one report; more are counted


def publish(out: Path, suite: Suite) -> tuple[dict[str, Table], Path]:
    """Tables and report from the result rows below `out` and what is known of the tasks. Returns both."""
    results = load(out)
    built = tables.build(results, suite)
    for table in built.values():
        write(table, out / "tables")
    return built, _write(out, results, built, suite)


def write_report(out: Path) -> Path:
    """`out/report.html`: self-contained but for films, which lie beside it; no script, no network.

    Raises StageError when it cannot be written.
    """
    results, suite = load(out), configured()
    return _write(out, results, tables.build(results, suite), suite)


def _write(out: Path, results: Results, built: dict[str, Table], suite: Suite) -> Path:
    compared = built["comparison"]
    sections = [
        _summary(results),
        *(_table(table) for table in built.values() if table is not compared and table.lines),
        _policy_failures(results, suite),
        found.rollouts(out, results, suite),
        _failures(results, suite),
        found.curves(out),
        found.data(out),
        found.margins(out, suite),
        found.pictures(out, results),
        Section(compared.name, compared.title, table=page.laid(compared)),
        found.recordings(out),
        found.provenance(out, results),
    ]
    path = out / "report.html"
    try:
        write_text(path, page.document("RoboFactory experiments", paper().source, sections))
    except OSError as error:
        raise StageError(f"cannot write the report to {path}: {error.strerror or error}") from error
    return path


def _summary(results: Results) -> Section:
    """Tiles of what there are rows of."""
    tiles: list[Tile] = []
    if tried := len(results.generation):
        made = sum(row.success for row in results.generation)
        hours = sum(row.wall_s for row in results.generation) / 3600
        words = "scene seeds gave a demonstration, all rows of constraints together"
        tiles.append(Tile(f"{made} of {tried}", words))
        if hours:
            tiles.append(Tile(f"{made / hours:,.0f}", "demonstrations an hour of one worker's time"))
    own = tables.unvaried(tables.ours(results))
    for kind, shield in (("rollouts", False), ("shielded rollouts", True)):
        if any(row.shield is shield for row in own.evaluation):
            tiles += _rollout_tiles(own, kind, shield)
    if varied := [row for row in results.evaluation if row.variation != UNVARIED]:
        won = sum(row.success for row in varied)
        tiles.append(Tile(f"{won} of {len(varied)}", "rollouts in scenes that vary succeeded"))
    tasks = {row.task for row in (*results.generation, *results.evaluation)}
    tiles.append(Tile(str(len(tasks)), f"{'task' if len(tasks) == 1 else 'tasks'} with results"))
    command = "" if tried or results.evaluation else "python -m rf_exp.run"
    return Section("summary", "Summary", command, tuple(tiles), notes=results.notes)


def _rollout_tiles(results: Results, kind: str, shield: bool) -> tuple[Tile, Tile]:
    rows = [row for row in results.evaluation if row.shield is shield]
    policies = {(r.task, r.arch, r.constraints, r.recipe, r.demos, r.train_seed) for r in rows}
    won, violated = sum(r.success for r in rows), sum(r.violations > 0 for r in rows)
    acted = "one policy" if len(policies) == 1 else f"{len(policies)} policies"
    return (
        Tile(f"{won} of {len(rows)}", f"{kind} of {acted} succeeded"),
        Tile(f"{violated} of {len(rows)}", f"{kind} had a violation: arms touched"),
    )


def _table(table: Table) -> Section:
    if table.name == "benchmark":
        first = table.cell(table.lines[0].key, "recipe")  # `recipes` draws the others
        drawn = [
            (line.title, plots.over_demos(line, table.columns, f"{table.name}-{line.key}"))
            for line in table.lines
            if not line.average and plots.measured(line.cells)
            if table.cell(line.key, "recipe") == first
        ]
    elif table.name == "robustness":
        drawn = plots.maps(table)
    elif table.name == "tasks":
        drawn = []  # its figures are drawn with the other tables
    else:
        drawn = plots.panels(table)
    panels = tuple(Panel(title, svg) for title, svg in drawn)
    return Section(table.name, table.title, table=page.laid(table), panels=panels)


def _policy_failures(results: Results, suite: Suite) -> Section:
    """Failures of one kind are counted together, for each policy."""
    kinds: Counter[tuple[str, ...]] = Counter()
    tried: Counter[tuple[str, ...]] = Counter()
    scenes: dict[tuple[str, ...], int] = {}
    for row in results.evaluation:
        policy = (row.task, row.arch, learnt_from(row))
        tried[policy] += 1
        if not row.success:
            kind = (*policy, row.account.kind)
            kinds[kind] += 1
            scenes[kind] = min(row.scene_seed, scenes.get(kind, row.scene_seed))
    common = sorted(kinds, key=lambda kind: (-kinds[kind] / tried[kind[:3]], kind))[:REASONS]
    lines = [
        (title_of(kind[0], suite), *kind[1:], f"{kinds[kind]} of {tried[kind[:3]]}", str(scenes[kind]))
        for kind in sorted(common, key=lambda kind: (kind[:3], -kinds[kind], kind))
    ]
    rest = len(kinds) - len(lines)
    heading = ("Task", "Architecture", "Learnt from", "What failed", "Scenes", "First scene")
    return Section(
        "policies",
        "Why policies failed",
        lead="Conditions of success that did not hold at the end, and what happened before.",
        texts=Texts(heading, tuple(lines)) if lines else None,
        notes=(f"{rest} rarer kinds are in the result rows.",) if rest else (),
    )


def _failures(results: Results, suite: Suite) -> Section:
    reasons: Counter[tuple[str, str, str]] = Counter()
    tried: Counter[tuple[str, str]] = Counter()
    for row in results.generation:
        made = row.task, row.constraints + f", in {row.variation}" * (row.variation != UNVARIED)
        tried[made] += 1
        if not row.success:
            reasons[(*made, row.account.kind)] += 1
    lines = [
        (title_of(task, suite), constraints, reason, f"{count} of {tried[task, constraints]}")
        for (task, constraints, reason), count in reasons.most_common(REASONS)
    ]
    rest = len(reasons) - len(lines)
    return Section(
        "failures",
        "Why attempts failed",
        texts=Texts(("Task", "Constraints", "Reason", "Seeds"), tuple(lines)) if lines else None,
        notes=(f"{rest} rarer reasons are in the result rows.",) if rest else (),
    )
