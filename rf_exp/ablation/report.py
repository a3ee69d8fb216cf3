"""The report: every table beside the paper's, plots, content of the output folder, and its provenance."""

import base64
import io
import json
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from PIL import Image

from rf_exp.ablation import page, plots
from rf_exp.ablation.formats import write
from rf_exp.ablation.page import Panel, Section
from rf_exp.ablation.results import FILM, PICTURE, Results, load, rollout_file
from rf_exp.ablation.rows import EvaluationRow, grouped
from rf_exp.ablation.tables import build
from rf_exp.ablation.tables.counting import without_final, without_foreign, without_variation
from rf_exp.ablation.tables.inputs import Suite, paper, title_of
from rf_exp.ablation.tables.table import Table
from rf_exp.artifacts import code_version, package_versions, read_json, write_text
from rf_exp.errors import RfError, StageError
from rf_exp.store import Store
from rf_exp.types import CONTROL_DT_S, FOREIGN, UNVARIED

MAX_REASONS = 30  # most in one report; further ones are counted
PACKAGES = (
    *("rf_exp", "mani-skill", "sapien", "torch", "diffusers", "hydra-core", "numpy", "zarr", "pin", "coal"),
    *("toppra", "rerun-sdk"),
)
MAX_PICTURES, MAX_CURVES, MAX_RECORDINGS = 24, 24, 40  # most in one report; further ones are counted
MAX_ROLLOUTS = 32  # most in one report, shared by the tasks
PICTURE_WIDTH, FRAME_WIDTH = 720, 240  # pixels
STRIP_FRAMES = 4  # frames of a demonstration
ROBUSTNESS_LEAD = (
    "What was executed, judged in signal temporal logic: the margin left where it was least, for each unit. "
    "Below zero it is a violation."
)
RTAMT_MISSING = "needs rtamt: pip install 'rf_exp[stl]', and make the demonstration again"


def publish(out: Path, suite: Suite) -> tuple[dict[str, Table], Path]:
    """Writes tables and `out/report.html` from the result rows below `out` and the facts about the tasks.

    The report is self-contained but for films, which are files beside it; no script, no network. Returns the
    tables and its path. Raises StageError when something cannot be written.
    """
    results = load(out)
    tables = build(results, suite)
    for table in tables.values():
        write(table, out / "tables")
    comparison = tables["comparison"]
    sections = [
        _summary(results),
        *(_table(table) for table in tables.values() if table is not comparison and table.lines),
        _policy_failures(results, suite),
        _rollouts(out, results, suite),
        _failures(results, suite),
        _curves(out),
        _data(out),
        margins(out, suite),
        _pictures(out, results),
        Section(comparison.name, comparison.title, table=page.layout(comparison)),
        _recordings(out),
        _provenance(out, results),
    ]
    path = out / "report.html"
    try:
        write_text(path, page.document("RoboFactory experiments", paper().source, sections))
    except OSError as error:
        raise StageError(f"cannot write the report to {path}: {error.strerror or error}") from error
    return tables, path


def _summary(results: Results) -> Section:
    tiles: list[tuple[str, str]] = []
    if attempts := len(results.generation):
        succeeded = sum(row.success for row in results.generation)
        hours = sum(row.wall_s for row in results.generation) / 3600
        caption = "scene seeds gave a demonstration, all rows of constraints together"
        tiles.append((f"{succeeded} of {attempts}", caption))
        if hours:
            tiles.append((f"{succeeded / hours:,.0f}", "demonstrations an hour of one worker's time"))
    own = without_variation(without_final(without_foreign(results))).evaluation
    for kind, shield in (("rollouts", False), ("shielded rollouts", True)):
        if rows := [row for row in own if row.shield is shield]:
            policies = {(r.task, r.arch, r.constraints, r.recipe, r.demos, r.train_seed) for r in rows}
            policy_count = "one policy" if len(policies) == 1 else f"{len(policies)} policies"
            won, violated = sum(r.success for r in rows), sum(r.violations > 0 for r in rows)
            tiles.append((f"{won} of {len(rows)}", f"{kind} of {policy_count} succeeded"))
            tiles.append((f"{violated} of {len(rows)}", f"{kind} had a violation: arms touched"))
    if varied := [row for row in results.evaluation if row.variation != UNVARIED]:
        won = sum(row.success for row in varied)
        tiles.append((f"{won} of {len(varied)}", "rollouts in scenes that vary succeeded"))
    tasks = {row.task for row in (*results.generation, *results.evaluation)}
    tiles.append((str(len(tasks)), f"{'task' if len(tasks) == 1 else 'tasks'} with results"))
    command = "" if attempts or results.evaluation else "python -m rf_exp.run"
    return Section("summary", "Summary", command, tuple(tiles), notes=results.notes)


def _table(table: Table) -> Section:
    if table.name == "benchmark":
        first = table.cell(table.lines[0].key, "recipe")  # the table `recipes` plots the others
        plotted = [
            (line.title, plots.over_demos(line, table.columns, f"{table.name}-{line.key}"))
            for line in table.lines
            if not line.average and plots.has_values(line.cells)
            if table.cell(line.key, "recipe") == first
        ]
    elif table.name == "robustness":
        plotted = plots.success_maps(table)
    elif table.name == "tasks":
        plotted = []  # its figures are plotted with the other tables
    else:
        plotted = plots.panels(table)
    panels = tuple(Panel(title, svg) for title, svg in plotted)
    return Section(table.name, table.title, table=page.layout(table), panels=panels)


def _policy_failures(results: Results, suite: Suite) -> Section:
    """Section of the failures of each policy, counted by kind."""
    kinds: Counter[tuple[str, ...]] = Counter()
    attempts: Counter[tuple[str, ...]] = Counter()
    scenes: dict[tuple[str, ...], int] = {}
    for row in results.evaluation:
        policy = (row.task, row.arch, learnt_from(row))
        attempts[policy] += 1
        if not row.success:
            kind = (*policy, row.account.kind)
            kinds[kind] += 1
            scenes[kind] = min(row.scene_seed, scenes.get(kind, row.scene_seed))
    most_common = sorted(kinds, key=lambda kind: (-kinds[kind] / attempts[kind[:3]], kind))[:MAX_REASONS]
    lines = [
        (title_of(kind[0], suite), *kind[1:], f"{kinds[kind]} of {attempts[kind[:3]]}", str(scenes[kind]))
        for kind in sorted(most_common, key=lambda kind: (kind[:3], -kinds[kind], kind))
    ]
    omitted = len(kinds) - len(lines)
    return Section(
        "policies",
        "Why policies failed",
        lead="Conditions of success that did not hold at the end, and what happened before.",
        titles=("Task", "Architecture", "Learnt from", "What failed", "Scenes", "First scene"),
        rows=lines,
        notes=(f"{omitted} rarer kinds are in the result rows.",) if omitted else (),
    )


def _failures(results: Results, suite: Suite) -> Section:
    reasons: Counter[tuple[str, str, str]] = Counter()
    attempts: Counter[tuple[str, str]] = Counter()
    for row in results.generation:
        condition = row.task, row.constraints + f", in {row.variation}" * (row.variation != UNVARIED)
        attempts[condition] += 1
        if not row.success:
            reasons[(*condition, row.account.kind)] += 1
    lines = [
        (title_of(task, suite), constraints, reason, f"{count} of {attempts[task, constraints]}")
        for (task, constraints, reason), count in reasons.most_common(MAX_REASONS)
    ]
    omitted = len(reasons) - len(lines)
    return Section(
        "failures",
        "Why attempts failed",
        titles=("Task", "Constraints", "Reason", "Seeds"),
        rows=lines,
        notes=(f"{omitted} rarer reasons are in the result rows.",) if omitted else (),
    )


def learnt_from(row: EvaluationRow) -> str:
    """The training data and recipe of a rollout's policies, and where they acted, in words."""
    trained = f", training seed {row.train_seed}" if row.train_seed else ""
    acting = ", shielded" * row.shield
    if row.variation != UNVARIED:
        acting += f", in scenes of {row.variation}"
    if row.arch == FOREIGN.name:
        return f"a policy of others, {row.recipe}{trained}{acting}"
    recipe = f", recipe {row.recipe}" if row.recipe != "paper" else ""
    return f"{row.constraints}, {row.demos} demonstrations{recipe}{trained}{acting}"


def _rollouts(out: Path, results: Results, suite: Suite) -> Section:
    """Section of films with a picture of the last moment, some of each task, failures first."""
    ordered = sorted(results.evaluation, key=lambda row: (row.success, *map(str, row.identity)))
    with_picture = (row for row in ordered if (out / rollout_file(row, PICTURE)).exists())
    by_task = grouped(with_picture, lambda row: row.task)
    panels, notes = [], []
    for task, rows in sorted(by_task.items()):
        share = max(2, MAX_ROLLOUTS // len(by_task))
        successes = [row for row in rows if row.success][: share // 2]
        for row in (*[row for row in rows if not row.success][: share - len(successes)], *successes):
            try:
                panels.append(_rollout_panel(out, row, suite))
            except OSError as error:
                notes.append(f"{out / rollout_file(row, PICTURE)}: no picture: {error}")
        notes += [f"{task}: {len(rows) - share} more are below recordings/."] if len(rows) > share else []
    lead = (
        "The last moment of each. A ring in a view marks where a policy detects the next goal of its agent, "
        "dots mark its other detected keypoints."
    )
    return Section(
        "rollouts", "Rollouts", lead=lead if panels else "", panels=tuple(panels), notes=tuple(notes)
    )


def _rollout_panel(out: Path, row: EvaluationRow, suite: Suite) -> Panel:
    with Image.open(out / rollout_file(row, PICTURE)) as image:
        picture = _image(image, PICTURE_WIDTH)
    film = rollout_file(row, FILM)
    return Panel(
        f"{title_of(row.task, suite)}, {row.arch}, {learnt_from(row)}, scene {row.scene_seed}",
        picture=picture,
        caption=f"succeeded after {row.steps * CONTROL_DT_S:.1f} s" if row.success else row.reason,
        film=quote(film.as_posix()) if (out / film).exists() else "",
    )


def _curves(out: Path) -> Section:
    def draw(path: Path) -> Panel:
        name = path.relative_to(out / "policies").parent.as_posix()
        return Panel(name, plots.curves(plots.read_curves(path), name))

    files = sorted((out / "policies").rglob("curves.csv"))
    panels, notes = _draw_panels(files, draw, MAX_CURVES, "policies/", "cannot be drawn")
    return Section("training", "Training curves", panels=panels, notes=notes)


def _pictures(out: Path, results: Results) -> Section:
    """Section of pictures beside the recordings, except those of rollouts, shown with their films."""

    def draw(path: Path) -> Panel:
        with Image.open(path) as image:
            return Panel(path.relative_to(out).as_posix(), picture=_image(image, PICTURE_WIDTH))

    excluded = {out / rollout_file(row, PICTURE) for row in results.evaluation}
    files = sorted({*(out / "recordings").rglob("*.png")} - excluded)
    panels, notes = _draw_panels(files, draw, MAX_PICTURES, "recordings/", "no picture")
    return Section("pictures", "Pictures", panels=panels, notes=notes)


def _draw_panels(
    files: Sequence[Path], draw: Callable[[Path], Panel], limit: int, folder: str, failed: str
) -> tuple[tuple[Panel, ...], tuple[str, ...]]:
    """Panels of the first files, and notes about files that cannot be drawn or are left out."""
    panels, notes = [], []
    for path in files[:limit]:
        try:
            panels.append(draw(path))
        except (ValueError, OSError) as error:
            notes.append(f"{path}: {failed}: {error}")
    notes += [f"{len(files) - limit} more are below {folder}."] if len(files) > limit else []
    return tuple(panels), tuple(notes)


def _data(out: Path) -> Section:
    """Section of the data sets, with frames of the first episode of each."""
    panels, notes = [], []
    for path in sorted((out / "data").glob("*/*/*.zarr")):
        try:
            store = Store.open(path)
            frames: tuple[str, ...] = ()
            if len(store) and "global" in store.cameras:
                steps = np.linspace(0, store.episode_ends[0] - 1, STRIP_FRAMES).round().astype(int)
                pictures = (Image.fromarray(np.asarray(store.images["global"][int(step)])) for step in steps)
                frames = tuple(_image(picture, FRAME_WIDTH) for picture in pictures)
            text = f"{len(store)} episodes, {store.steps} control steps, {len(store.cameras)} cameras"
            panels.append(Panel(path.relative_to(out / "data").as_posix(), strip=frames, caption=text))
        except RfError as error:
            notes.append(str(error))
    return Section("data", "Demonstrations", panels=tuple(panels), notes=tuple(notes))


def margins(out: Path, suite: Suite) -> Section:
    """Section of the robustness of every demonstration below `out/demonstrations`; empty without one.

    Read from the JSON beside its page, so nothing is judged again, and rtamt is not needed here.
    """
    lines: list[tuple[str, ...]] = []
    notes = []
    for path in sorted((out / "demonstrations").glob("*.json")):
        task, _, scene = path.stem.rpartition("-")
        try:
            plans = read_json(path, "make the demonstration again")["stl"]
            smallest = list(_smallest_margins([check for plan in plans for check in plan["checks"]]))
        except (StageError, KeyError, TypeError, OSError) as error:
            notes.append(f"{path}: cannot be read: {error!r}")
            continue
        lines += [(title_of(task, suite), scene, *each) for each in smallest]
    return Section(
        "margins",
        "Robustness of demonstrations",
        lead=ROBUSTNESS_LEAD if lines else "",
        titles=("Task", "Scene", "Constraints judged", "Least robustness", "Of the formula"),
        rows=lines,
        notes=tuple(notes),
    )


def _smallest_margins(checks: list[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """Yields for each unit the number of judged constraints, the least robustness, and its formula."""
    formulas = [(check["check"], formula) for check in checks for formula in check["formulas"]]
    if formulas and all(formula["holds"] is None for _, formula in formulas):
        yield "none", RTAMT_MISSING, ""
        return
    judged = [(name, formula) for name, formula in formulas if formula["robustness"] is not None]
    for unit in sorted({formula["unit"] for _, formula in judged}):
        of_unit = [(name, formula) for name, formula in judged if formula["unit"] == unit]
        name, smallest = min(of_unit, key=lambda each: each[1]["robustness"])
        constraints = len({name for name, _ in of_unit})
        yield str(constraints), f"{smallest['robustness']:.3g} {unit}", f"{name}: {smallest['stl']}"


def _recordings(out: Path) -> Section:
    files = [path.as_posix() for path in sorted((out / "recordings").rglob("*.rrd"))]
    note = (f"{len(files) - MAX_RECORDINGS} more.",) if len(files) > MAX_RECORDINGS else ()
    return Section("recordings", "Recordings", recordings=tuple(files[:MAX_RECORDINGS]), notes=note)


def _provenance(out: Path, results: Results) -> Section:
    versions = Counter((row.task, row.version) for row in (*results.generation, *results.evaluation))
    criteria = ", ".join(f"{task} {version} ({n} rows)" for (task, version), n in sorted(versions.items()))
    facts = (
        ("Written", datetime.now().astimezone().isoformat(" ", "seconds")),
        ("Code", code_version()),
        ("Success criteria", criteria or "no rows"),
        ("Packages", ", ".join(f"{name} {version}" for name, version in package_versions(PACKAGES).items())),
        ("Machine", f"{platform.platform()}, {platform.machine()}"),
        ("Made again by", f"python -m rf_exp.ablation --out {out.as_posix()}"),
    )
    files = {
        path.relative_to(out).as_posix(): path.read_text("utf-8", "replace")
        for path in sorted((out / "runs").rglob(".hydra/config.yaml"))[-3:]
    }
    for path in sorted((out / "data").glob("*/*/*.zarr/zarr.json")):
        try:
            attributes = json.loads(path.read_text("utf-8"))["attributes"]
        except (ValueError, KeyError, OSError):
            continue  # a damaged store is reported with the data
        files[path.parent.relative_to(out).as_posix()] = json.dumps(attributes, indent=1)
    return Section("provenance", "Provenance", titles=("", ""), rows=facts, collapsed=tuple(files.items()))


def _image(image: Image.Image, width: int) -> str:
    """A picture as the data URL of a JPEG of at most `width` px."""
    picture = image.convert("RGB")
    picture.thumbnail((width, 4 * width))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode()}"
