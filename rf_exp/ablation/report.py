"""The report: every table beside the paper's, plots, pictures and where it all came from, in one file."""

import base64
import io
import json
import platform
import re
from collections import Counter
from datetime import datetime
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rf_exp.ablation import formats, page, plots, tables
from rf_exp.ablation.paper import paper
from rf_exp.ablation.rollouts import FILM, PICTURE, kind_of, rollout_file
from rf_exp.ablation.rows import EvaluationRow, Results, load
from rf_exp.ablation.suite import Suite, configured
from rf_exp.ablation.tables import Table, title_of
from rf_exp.artifacts.provenance import commit, installed
from rf_exp.errors import RfError, StageError
from rf_exp.store import Store
from rf_exp.types import CONTROL_DT_S

PACKAGES = (
    *("rf_exp", "mani-skill", "sapien", "torch", "diffusers", "hydra-core", "numpy", "zarr", "pin", "coal"),
    *("toppra", "rerun-sdk"),
)
PICTURES, CURVES, RECORDINGS = 24, 24, 40  # at most so many in one report; more are counted
ROLLOUTS = 32  # the same of rollouts, shared by the tasks
REASONS = 30
PICTURE_WIDTH = 720  # pixels
STRIP = 4  # frames of a demonstration


def publish(out: Path, suite: Suite) -> tuple[dict[str, Table], Path]:
    """Tables and report from the result rows below `out` and what is known of the tasks. Returns both."""
    results = load(out)
    built = tables.build(results, suite)
    for table in built.values():
        formats.write(table, out / "tables")
    return built, _write(out, results, built, suite)


def write_report(out: Path) -> Path:
    """`out/report.html`: self-contained but for films, which lie beside it; no script, no network.

    Raises StageError when it cannot be written.
    """
    results, suite = load(out), configured()
    return _write(out, results, tables.build(results, suite), suite)


def _write(out: Path, results: Results, built: dict[str, Table], suite: Suite) -> Path:
    sections = [
        ("summary", "Summary", _summary(results)),
        *(
            (name, table.title, _table_section(table))
            for name, table in built.items()
            if name != "comparison"
        ),
        ("policies", "Why policies failed", _policy_failures(results, suite)),
        ("rollouts", "Rollouts", _rollouts(out, results, suite)),
        ("failures", "Why attempts failed", _failures(results, suite)),
        ("training", "Training curves", _curves(out)),
        ("data", "Demonstrations", _data(out)),
        ("pictures", "Pictures", _pictures(out, results)),
        ("comparison", built["comparison"].title, page.table_html(built["comparison"])),
        ("recordings", "Recordings", _recordings(out)),
        ("provenance", "Provenance", _provenance(out, results)),
    ]
    lead = (
        '<p class="soft"><span class="key"></span> ours, strict success criteria, 95 % intervals &nbsp; '
        f'<span class="key paper"></span> the paper: {escape(paper().source)}</p>'
    )
    text = page.document("RoboFactory experiments", [part for part in sections if part[2]], lead)
    path = out / "report.html"
    try:
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    except OSError as error:
        raise StageError(f"cannot write the report to {path}: {error.strerror or error}") from error
    return path


def _summary(results: Results) -> str:
    made, tried = sum(row.success for row in results.generation), len(results.generation)
    hours = sum(row.wall_s for row in results.generation) / 3600
    rollouts = []
    for kind in ("rollouts", "shielded rollouts"):
        rows = [row for row in results.evaluation if row.shield is (kind != "rollouts")]
        if not rows and kind != "rollouts":
            continue
        policies = {(r.task, r.arch, r.constraints, r.recipe, r.demos, r.train_seed) for r in rows}
        rollouts += [
            (
                f"{sum(r.success for r in rows)} of {len(rows)}",
                f"{kind} of {len(policies)} policies succeeded",
            ),
            (
                f"{sum(r.violations > 0 for r in rows)} of {len(rows)}",
                f"{kind} had a violation: arms touched",
            ),
        ]
    items = [
        (f"{made} of {tried}", "scene seeds gave a demonstration, all rows of constraints together"),
        (f"{made / hours:,.0f}" if hours else "missing", "demonstrations an hour of one worker's time"),
        *rollouts,
        (str(len({row.task for row in (*results.generation, *results.evaluation)})), "tasks with results"),
    ]
    empty = (
        ""
        if tried or results.evaluation
        else "<p>No result rows yet: run <code>python -m rf_exp.run</code>.</p>"
    )
    return empty + page.tiles(items) + page.bullets(list(results.notes))


def _table_section(table: Table) -> str:
    if not table.lines:
        return ""
    if table.name == "benchmark":
        drawn = [
            (line.title, plots.over_demos(line, table.columns, f"{table.name}-{line.key}"))
            for line in table.lines
            if line.title != "Average" and plots.measured(line.cells)
        ]
    elif table.name == "tasks":
        drawn = []  # its figures are drawn with the other tables
    else:
        drawn = plots.panels(table)
    return page.table_html(table) + page.panels(drawn)


def _policy_failures(results: Results, suite: Suite) -> str:
    """Failures of one kind are counted together, for each policy."""
    kinds: Counter[tuple[str, ...]] = Counter()
    tried: Counter[tuple[str, ...]] = Counter()
    scenes: dict[tuple[str, ...], int] = {}
    for row in results.evaluation:
        policy = (row.task, row.arch, _learnt_from(row))
        tried[policy] += 1
        if not row.success:
            kind = (*policy, kind_of(row.reason))
            kinds[kind] += 1
            scenes[kind] = min(row.scene_seed, scenes.get(kind, row.scene_seed))
    if not kinds:
        return ""
    order = sorted(kinds, key=lambda kind: (kind[:3], -kinds[kind], kind))
    lines = [
        [title_of(kind[0], suite), *kind[1:], f"{kinds[kind]} of {tried[kind[:3]]}", str(scenes[kind])]
        for kind in order[:REASONS]
    ]
    rest = len(order) - len(lines)
    more = page.bullets([f"{rest} more kinds are in the result rows."] if rest else [])
    heading = ["Task", "Architecture", "Learnt from", "What failed", "Scenes", "First scene"]
    lead = "<p class='soft'>Conditions of success that did not hold at the end, and what happened before.</p>"
    return lead + page.plain_table(heading, lines) + more


def _learnt_from(row: EvaluationRow) -> str:
    trained = f", training seed {row.train_seed}" if row.train_seed else ""
    recipe = f", recipe {row.recipe}" if row.recipe != "paper" else ""
    return f"{row.constraints}, {row.demos} demonstrations{recipe}{trained}{', shielded' * row.shield}"


def _rollouts(out: Path, results: Results, suite: Suite) -> str:
    """Films with the picture of their last moment, some of each task, failures first."""
    by_task: dict[str, list[EvaluationRow]] = {}
    for row in sorted(results.evaluation, key=lambda row: (row.success, *map(str, row.identity))):
        if (out / rollout_file(row, PICTURE)).exists():
            by_task.setdefault(row.task, []).append(row)
    drawn, notes = [], []
    for task, rows in sorted(by_task.items()):
        share = max(2, ROLLOUTS // len(by_task))
        won = [row for row in rows if row.success][: share // 2]
        for row in (*[row for row in rows if not row.success][: share - len(won)], *won):
            title = f"{title_of(task, suite)}, {row.arch}, {_learnt_from(row)}, scene {row.scene_seed}"
            try:
                drawn.append((title, _rollout(out, row)))
            except OSError as error:
                notes.append(f"{out / rollout_file(row, PICTURE)}: no picture: {error}")
        notes += [f"{task}: {len(rows) - share} more are below recordings/."] if len(rows) > share else []
    lead = (
        "<p class='soft'>The last moment of each. A ring in a view is where a policy sees its agent go "
        "next, dots are what else it sees.</p>"
    )
    return (lead if drawn else "") + page.panels(drawn) + page.bullets(notes)


def _rollout(out: Path, row: EvaluationRow) -> str:
    with Image.open(out / rollout_file(row, PICTURE)) as image:
        shown = _image(image, PICTURE_WIDTH)
    words = f"succeeded after {row.steps * CONTROL_DT_S:.1f} s" if row.success else row.reason
    shown += f'<figcaption class="soft">{escape(words)}</figcaption>'
    film = rollout_file(row, FILM)
    if (out / film).exists():
        video = f'<video controls preload="none" src="{quote(film.as_posix())}"></video>'
        shown += f"<details><summary>Film, twice as fast</summary>{video}</details>"
    return shown


def _failures(results: Results, suite: Suite) -> str:
    reasons: Counter[tuple[str, str, str]] = Counter()
    tried: Counter[tuple[str, str]] = Counter()
    for row in results.generation:
        tried[row.task, row.constraints] += 1
        if not row.success:
            # Measured values differ from seed to seed; without them equal reasons are equal.
            reason = re.sub(r"-?\d+\.\d+", "…", row.reason) or "no reason given"
            reasons[row.task, row.constraints, reason] += 1
    if not reasons:
        return ""
    lines = [
        [title_of(task, suite), constraints, reason, f"{count} of {tried[task, constraints]}"]
        for (task, constraints, reason), count in reasons.most_common(REASONS)
    ]
    rest = len(reasons) - len(lines)
    more = page.bullets([f"{rest} rarer reasons are in the result rows."] if rest else [])
    return page.plain_table(["Task", "Constraints", "Reason", "Seeds"], lines) + more


def _curves(out: Path) -> str:
    found = sorted((out / "policies").rglob("curves.csv"))
    drawn, notes = [], []
    for path in found[:CURVES]:
        name = path.relative_to(out / "policies").parent.as_posix()
        try:
            drawn.append((name, plots.curves(plots.read_curves(path), name)))
        except (ValueError, OSError) as error:
            notes.append(f"{path}: cannot be drawn: {error}")
    notes += [f"{len(found) - CURVES} more are below policies/."] if len(found) > CURVES else []
    return page.panels(drawn) + page.bullets(notes)


def _data(out: Path) -> str:
    """Every data set with frames of its first episode."""
    drawn, notes = [], []
    for path in sorted((out / "data").glob("*/*/*.zarr")):
        try:
            store = Store.open(path)
            name = path.relative_to(out / "data").as_posix()
            text = f"{len(store)} episodes, {store.steps} control steps, {len(store.cameras)} cameras"
            strip = ""
            if len(store) and "global" in store.cameras:
                steps = np.linspace(0, store.episode_ends[0] - 1, STRIP).round().astype(int)
                frames = [_image(np.asarray(store.pictures["global"][int(step)]), 240) for step in steps]
                strip = f'<div class="strip">{"".join(frames)}</div>'
            drawn.append((name, f'{strip}<figcaption class="soft">{escape(text)}</figcaption>'))
        except RfError as error:
            notes.append(str(error))
    return page.panels(drawn) + page.bullets(notes)


def _pictures(out: Path, results: Results) -> str:
    """Pictures beside the recordings, but for those of rollouts, which are shown with their films."""
    rollouts = {out / rollout_file(row, PICTURE) for row in results.evaluation}
    found = sorted({*(out / "recordings").rglob("*.png")} - rollouts)
    drawn, notes = [], []
    for path in found[:PICTURES]:
        try:
            with Image.open(path) as image:
                drawn.append((path.relative_to(out).as_posix(), _image(image, PICTURE_WIDTH)))
        except OSError as error:
            notes.append(f"{path}: no picture: {error}")
    notes += [f"{len(found) - PICTURES} more are below recordings/."] if len(found) > PICTURES else []
    return page.panels(drawn) + page.bullets(notes)


def _recordings(out: Path) -> str:
    found = [path.as_posix() for path in sorted((out / "recordings").rglob("*.rrd"))]
    if not found:
        return ""
    lines = "\n".join(f"rerun {path}" for path in found[:RECORDINGS])
    more = page.bullets([f"{len(found) - RECORDINGS} more."] if len(found) > RECORDINGS else [])
    return (
        "<p>Open a recording with the viewer that the suite installs, from the folder the experiment ran in:"
        f"</p><pre>{escape(lines)}</pre>{more}"
    )


def _provenance(out: Path, results: Results) -> str:
    versions = Counter((row.task, row.version) for row in (*results.generation, *results.evaluation))
    criteria = ", ".join(f"{task} {version} ({n} rows)" for (task, version), n in sorted(versions.items()))
    facts = [
        ["Written", datetime.now().astimezone().isoformat(" ", "seconds")],
        ["Code", commit() or "not from a git checkout"],
        ["Success criteria", criteria or "no rows"],
        ["Packages", ", ".join(f"{name} {version}" for name, version in installed(PACKAGES).items())],
        ["Machine", f"{platform.platform()}, {platform.machine()}"],
        ["Made again by", f"python -m rf_exp.ablation --out {out.as_posix()}"],
    ]
    made = {
        path.relative_to(out).as_posix(): path.read_text("utf-8", "replace")
        for path in sorted((out / "runs").rglob(".hydra/config.yaml"))[-3:]
    }
    for path in sorted((out / "data").glob("*/*/*.zarr/zarr.json")):
        try:
            attributes = json.loads(path.read_text("utf-8"))["attributes"]
        except (ValueError, KeyError, OSError):
            continue  # a damaged store is reported with the data
        made[path.parent.relative_to(out).as_posix()] = json.dumps(attributes, indent=1)
    configurations = "".join(
        f"<details><summary>{escape(name)}</summary><pre>{escape(text)}</pre></details>"
        for name, text in made.items()
    )
    return page.plain_table(["", ""], facts) + configurations


def _image(image: Image.Image | NDArray[np.uint8], width: int) -> str:
    """A picture as an inline JPEG of at most that width, px."""
    picture = (Image.fromarray(image) if isinstance(image, np.ndarray) else image).convert("RGB")
    picture.thumbnail((width, 4 * width))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=85)
    return f'<img alt="" src="data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode()}">'
