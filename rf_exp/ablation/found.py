"""Sections of the report on what lies in the output folder: films, curves, data, robustness, recordings."""

import base64
import io
import json
import platform
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rf_exp.ablation import plots
from rf_exp.ablation.page import Panel, Section, Texts
from rf_exp.ablation.results import Results
from rf_exp.ablation.rollouts import FILM, PICTURE, learnt_from, rollout_file
from rf_exp.ablation.rows import EvaluationRow
from rf_exp.ablation.suite import Suite
from rf_exp.ablation.tables import title_of
from rf_exp.artifacts import code, installed, read_json
from rf_exp.errors import RfError, StageError
from rf_exp.store import Store
from rf_exp.types import CONTROL_DT_S

PACKAGES = (
    *("rf_exp", "mani-skill", "sapien", "torch", "diffusers", "hydra-core", "numpy", "zarr", "pin", "coal"),
    *("toppra", "rerun-sdk"),
)
PICTURES, CURVES, RECORDINGS = 24, 24, 40  # at most so many in one report; more are counted
ROLLOUTS = 32  # the same of rollouts, shared by the tasks
PICTURE_WIDTH, FRAME_WIDTH = 720, 240  # pixels
STRIP = 4  # frames of a demonstration
ROBUSTNESS = ("Task", "Scene", "Constraints judged", "Least robustness", "Of the formula")
JUDGED = (
    "What was executed, judged in signal temporal logic: the margin left where it was least, for each unit. "
    "Below zero it is a violation."
)
UNJUDGED = "needs rtamt: pip install 'rf_exp[stl]', and make the demonstration again"


def rollouts(out: Path, results: Results, suite: Suite) -> Section:
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
            try:
                drawn.append(_rollout(out, row, suite))
            except OSError as error:
                notes.append(f"{out / rollout_file(row, PICTURE)}: no picture: {error}")
        notes += [f"{task}: {len(rows) - share} more are below recordings/."] if len(rows) > share else []
    lead = (
        "The last moment of each. A ring in a view is where a policy sees its agent go next, dots are what "
        "else it sees."
    )
    shown = tuple(drawn), tuple(notes)
    return Section("rollouts", "Rollouts", lead=lead if drawn else "", panels=shown[0], notes=shown[1])


def _rollout(out: Path, row: EvaluationRow, suite: Suite) -> Panel:
    with Image.open(out / rollout_file(row, PICTURE)) as image:
        picture = _image(image, PICTURE_WIDTH)
    film = rollout_file(row, FILM)
    return Panel(
        f"{title_of(row.task, suite)}, {row.arch}, {learnt_from(row)}, scene {row.scene_seed}",
        picture=picture,
        caption=f"succeeded after {row.steps * CONTROL_DT_S:.1f} s" if row.success else row.reason,
        film=quote(film.as_posix()) if (out / film).exists() else "",
    )


def curves(out: Path) -> Section:
    files = sorted((out / "policies").rglob("curves.csv"))
    drawn, notes = [], []
    for path in files[:CURVES]:
        name = path.relative_to(out / "policies").parent.as_posix()
        try:
            drawn.append(Panel(name, plots.curves(plots.read_curves(path), name)))
        except (ValueError, OSError) as error:
            notes.append(f"{path}: cannot be drawn: {error}")
    notes += _more(files, CURVES, "policies/")
    return Section("training", "Training curves", panels=tuple(drawn), notes=tuple(notes))


def data(out: Path) -> Section:
    """Every data set with frames of its first episode."""
    drawn, notes = [], []
    for path in sorted((out / "data").glob("*/*/*.zarr")):
        try:
            store = Store.open(path)
            frames: tuple[str, ...] = ()
            if len(store) and "global" in store.cameras:
                steps = np.linspace(0, store.episode_ends[0] - 1, STRIP).round().astype(int)
                pictures = (np.asarray(store.images["global"][int(step)]) for step in steps)
                frames = tuple(_image(picture, FRAME_WIDTH) for picture in pictures)
            text = f"{len(store)} episodes, {store.steps} control steps, {len(store.cameras)} cameras"
            drawn.append(Panel(path.relative_to(out / "data").as_posix(), strip=frames, caption=text))
        except RfError as error:
            notes.append(str(error))
    return Section("data", "Demonstrations", panels=tuple(drawn), notes=tuple(notes))


def margins(out: Path, suite: Suite) -> Section:
    """Of every demonstration below `out/demonstrations`; empty where there is none.

    Read from what lies beside its page, so nothing is judged again, and rtamt is not needed here.
    """
    lines: list[tuple[str, ...]] = []
    notes = []
    for path in sorted((out / "demonstrations").glob("*.json")):
        task, _, scene = path.stem.rpartition("-")
        try:
            plans = read_json(path, "make the demonstration again")["stl"]
            found = list(_least([check for plan in plans for check in plan["checks"]]))
        except (StageError, KeyError, TypeError, OSError) as error:
            notes.append(f"{path}: cannot be read: {error!r}")
            continue
        lines += [(title_of(task, suite), scene, *each) for each in found]
    return Section(
        "margins",
        "Robustness of demonstrations",
        lead=JUDGED if lines else "",
        texts=Texts(ROBUSTNESS, tuple(lines)) if lines else None,
        notes=tuple(notes),
    )


def _least(checks: list[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """For each unit how many constraints were judged, the least robustness, and the formula that has it."""
    formulas = [(check["check"], formula) for check in checks for formula in check["formulas"]]
    if formulas and all(formula["holds"] is None for _, formula in formulas):
        yield "none", UNJUDGED, ""
        return
    judged = [(name, formula) for name, formula in formulas if formula["robustness"] is not None]
    for unit in sorted({formula["unit"] for _, formula in judged}):
        of_unit = [(name, formula) for name, formula in judged if formula["unit"] == unit]
        name, least = min(of_unit, key=lambda each: each[1]["robustness"])
        constraints = len({name for name, _ in of_unit})
        yield str(constraints), f"{least['robustness']:.3g} {unit}", f"{name}: {least['stl']}"


def pictures(out: Path, results: Results) -> Section:
    """Pictures beside the recordings, but for those of rollouts, which are shown with their films."""
    shown = {out / rollout_file(row, PICTURE) for row in results.evaluation}
    files = sorted({*(out / "recordings").rglob("*.png")} - shown)
    drawn, notes = [], []
    for path in files[:PICTURES]:
        try:
            with Image.open(path) as image:
                picture = _image(image, PICTURE_WIDTH)
            drawn.append(Panel(path.relative_to(out).as_posix(), picture=picture))
        except OSError as error:
            notes.append(f"{path}: no picture: {error}")
    notes += _more(files, PICTURES, "recordings/")
    return Section("pictures", "Pictures", panels=tuple(drawn), notes=tuple(notes))


def recordings(out: Path) -> Section:
    files = [path.as_posix() for path in sorted((out / "recordings").rglob("*.rrd"))]
    more = (f"{len(files) - RECORDINGS} more.",) if len(files) > RECORDINGS else ()
    return Section("recordings", "Recordings", recordings=tuple(files[:RECORDINGS]), notes=more)


def provenance(out: Path, results: Results) -> Section:
    """Which code and which packages, where, by which criteria, and from which configurations."""
    versions = Counter((row.task, row.version) for row in (*results.generation, *results.evaluation))
    criteria = ", ".join(f"{task} {version} ({n} rows)" for (task, version), n in sorted(versions.items()))
    facts = (
        ("Written", datetime.now().astimezone().isoformat(" ", "seconds")),
        ("Code", code()),
        ("Success criteria", criteria or "no rows"),
        ("Packages", ", ".join(f"{name} {version}" for name, version in installed(PACKAGES).items())),
        ("Machine", f"{platform.platform()}, {platform.machine()}"),
        ("Made again by", f"python -m rf_exp.ablation --out {out.as_posix()}"),
    )
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
    return Section("provenance", "Provenance", texts=Texts(("", ""), facts), folded=tuple(made.items()))


def _more(files: Sequence[Path], most: int, folder: str) -> list[str]:
    return [f"{len(files) - most} more are below {folder}."] if len(files) > most else []


def _image(image: Image.Image | NDArray[np.uint8], width: int) -> str:
    """A picture as the data URL of a JPEG of at most that width, px."""
    picture = (Image.fromarray(image) if isinstance(image, np.ndarray) else image).convert("RGB")
    picture.thumbnail((width, 4 * width))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode()}"
