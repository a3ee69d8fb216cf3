"""The report: one file, without network and scripts, that shows everything in the output folder."""

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rf_exp.ablation import append_row, configured, paper, plots, publish
from rf_exp.ablation.__main__ import main
from rf_exp.errors import StageError
from rf_exp.findings import Account, Closest, Lost, Unmet
from rf_exp.store import Store
from rf_exp.types import Episode
from tests.ablation.conftest import evaluation, generation, write_report

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Balance(HTMLParser):
    """Parser that fails on tags that are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_the_report_is_self_contained(out: Path) -> None:
    path = write_report(out)
    assert path == out / "report.html"
    text = path.read_text("utf-8")
    parser = Balance()
    parser.feed(text)
    assert parser.open == []
    assert "script" not in parser.seen
    assert not re.findall(r'(?:src|href)="(?!#|data:)', re.sub(r'xlink:href="#', '"', text))
    for part in ("prefers-color-scheme: dark", "width=device-width", "paper 97.5 %", "[31.3, 83.2] n=10"):
        assert part in text


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="there is no browser to measure with")
def test_the_widest_table_fits_1400_pixels(out: Path) -> None:
    """With every field of the table of tasks measured, for each of the paper's numbers of demonstrations."""
    for task in paper().levels:
        for row in generation(task, "full", 16, 4, loose=3, violations=(0, 1, 3), first=1000, steps=1000):
            append_row(out / f"results/generate/{task}/full.jsonl", row)
        for demos in paper().demos:
            for row in evaluation(task, "separate_local", demos, 12, 8, violations=(0, 170)):
                append_row(out / f"results/evaluate/{task}/separate_local/full-{demos}.jsonl", row)
    wide = "[...document.querySelectorAll('.wide')].filter(e => e.scrollWidth > e.clientWidth)"
    wider = f"{wide}.map(e => `${{e.closest('section').id}} ${{e.scrollWidth}} px`)"
    measured = out / "measured.html"
    text = write_report(out).read_text("utf-8")
    measured.write_text(
        text.replace("</body>", f"<script>document.title = 'wider: ' + {wider}</script></body>")
    )
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    browser += [f"--user-data-dir={out / 'browser'}", "--window-size=1400,2000", "--dump-dom"]
    done = subprocess.run([*browser, measured.as_uri()], capture_output=True, text=True, timeout=120)
    assert re.findall("<title>(.*)</title>", done.stdout) == ["wider: "]


@pytest.mark.slow
def test_the_summary_counts_the_rollouts_with_a_violation(out: Path) -> None:
    for row in evaluation("place_food", "separate_local", 150, 2, 3, violations=(0, 0, 1, 40, 0)):
        append_row(out / "results/evaluate/place_food/separate_local/full-150.jsonl", row)
    text = write_report(out).read_text("utf-8")
    assert "<b>2 of 45</b>" in text  # the other forty had none


def test_the_report_without_any_result(tmp_path: Path) -> None:
    text = write_report(tmp_path / "new").read_text("utf-8")
    assert "No result rows yet" in text
    assert "paper 97.5 %" in text


@pytest.mark.slow
def test_the_summary_of_rollouts_alone_says_nothing_of_generation(tmp_path: Path) -> None:
    for row in evaluation("place_food", "separate_local", 50, 1, 2):
        append_row(tmp_path / "results/evaluate/place_food/separate_local/full-50.jsonl", row)
    text = write_report(tmp_path).read_text("utf-8")
    assert "rollouts of one policy succeeded" in text
    assert "0 of 0" not in text and "demonstrations an hour" not in text and "shielded" not in text


@pytest.mark.slow
def test_failures_of_one_kind_are_counted_together_whatever_their_numbers(out: Path) -> None:
    for row in generation("new_task", "logical", 1, 3, violations=(2,)):
        append_row(out / "results/generate/new_task/logical.jsonl", row)
    text = write_report(out).read_text("utf-8")
    assert "lifted</td><td>4 of 10</td>" in text and "lifted</td><td>3 of 3</td>" in text
    assert "lifted; Agent_1 and Agent_2: touch</td><td>3 of 4</td>" in text


DROPPED = Account(
    unmet=(Unmet("lifted", 0.0, 0.1, 0.1, 0.15, "m", True),),
    closest=Closest(3, 4, 1.05, 0),
    lost=(Lost("barrier", "dropped", 1.1),),
)
FELL = replace(DROPPED, closest=Closest(2, 4, 2.2, 0), lost=(Lost("barrier", "dropped", 0.9),))


@pytest.mark.slow
def test_why_policies_failed_is_counted_by_kind(out: Path) -> None:
    for row in evaluation("place_food", "separate_local", 50, 3, 5):
        account = Account() if row.success else DROPPED if row.scene_seed % 2 else FELL
        append_row(
            out / "results/evaluate/place_food/separate_local/full-50.jsonl", replace(row, account=account)
        )
    text = write_report(out).read_text("utf-8")
    section = text[text.index('<section id="policies">') :]
    kind = "<td>lifted; barrier dropped</td><td>5 of 8</td><td>1000003</td>"
    assert f"<th>Place Food</th><td>separate_local</td><td>full, 50 demonstrations</td>{kind}" in section


@pytest.mark.slow
def test_of_many_kinds_of_failure_the_most_common_are_shown(tmp_path: Path) -> None:
    path = tmp_path / "results/evaluate/place_food/separate_local/full-50.jsonl"
    for place, row in enumerate(evaluation("place_food", "separate_local", 50, 0, 40)):
        kind = "a" * (place + 1) if place < 35 else "upright"  # the common one comes last in the alphabet
        unmet = Unmet(kind, 0.0, 0.1, 0.1, 0.15, "m", True)
        append_row(path, replace(row, account=Account(unmet=(unmet,))))
    text = write_report(tmp_path).read_text("utf-8")
    assert "<td>upright</td><td>5 of 40</td>" in text and "6 rarer kinds are in the result rows." in text


@pytest.mark.slow
def test_rollouts_have_a_film_or_a_picture_with_the_whole_reason(out: Path) -> None:
    folder = out / "recordings/place_food/full"
    folder.mkdir(parents=True)
    for row in evaluation("place_food", "separate_local", 50, 1, 2):
        account = Account() if row.success else DROPPED
        append_row(
            out / "results/evaluate/place_food/separate_local/full-50.jsonl", replace(row, account=account)
        )
        name = f"evaluate-separate_local-paper-50-{row.scene_seed}"
        Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(folder / f"{name}.png")
        if row.scene_seed != 1_000_002:
            (folder / f"{name}.mp4").write_bytes(b"film")
    text = write_report(out).read_text("utf-8")
    parser = Balance()
    parser.feed(text)
    assert parser.open == [] and "video" in parser.seen
    films = re.findall(r'<video controls preload="none" src="([^"]*)"', text)
    assert [(out / film).read_bytes() for film in films] == [b"film"] * 2  # relative to the report
    assert text.count("data:image/jpeg;base64,") == 3
    assert text.count(f'<figcaption class="soft">{DROPPED.reason.replace(">", "&gt;")}') == 2
    assert "succeeded after 5.0 s" in text
    assert '<section id="pictures">' not in text  # each is shown once


@pytest.mark.slow
def test_everything_in_the_output_folder_is_shown(out: Path) -> None:
    curves = out / "policies/lift_barrier/full/separate_local/150-0/curves.csv"
    curves.parent.mkdir(parents=True)
    curves.write_text("step,train_loss,learning_rate\n1,1.0,0.1\n2,0.5,\n3,0.25,0.1\n")
    (curves.parents[1] / "50-0").mkdir()
    (curves.parents[1] / "50-0/curves.csv").write_text("step\n1\n")
    recordings = out / "recordings/lift_barrier/full"
    recordings.mkdir(parents=True)
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(recordings / "generate-0.png")
    (recordings / "broken.png").write_bytes(b"no picture")
    (recordings / "generate-0.rrd").write_bytes(b"")
    zeros = np.zeros((5, 2, 9), np.float32)
    frames = np.zeros((5, 6, 8, 3), np.uint8)
    identity = {"task": "lift_barrier", "version": "1", "colour": "<teal>"}
    with Store.create(out / "data/lift_barrier/full/quick.zarr", identity, 2, ["global"], 6, 8) as store:
        store.append(Episode("lift_barrier", 0, zeros, zeros, zeros[..., :8], {"global": frames}))
    (out / "data/lift_barrier/full/empty.zarr").mkdir()
    (out / "data/lift_barrier/full/broken.zarr/meta/certificate").mkdir(parents=True)

    text = write_report(out).read_text("utf-8")
    assert "lift_barrier/full/separate_local/150-0" in text
    assert "50-0/curves.csv: cannot be drawn: no column named after a loss; columns: step" in text
    assert "train loss" in text
    assert text.count("data:image/jpeg;base64,") == 1 + 4
    assert "broken.png: no picture" in text
    assert f"rerun {recordings}/generate-0.rrd" in text
    assert "1 episodes, 5 control steps, 1 cameras" in text
    assert "&lt;teal&gt;" in text and "<teal>" not in text
    assert "broken.zarr is damaged" in text
    assert "empty.zarr is an empty folder; nothing is wrong with it" in text


@pytest.mark.slow
def test_unfinished_rows_are_reported(out: Path) -> None:
    with (out / "results/generate/lift_barrier/full.jsonl").open("a") as file:
        file.write('{"task')
    assert "full.jsonl, line 11: unfinished, left by a crash; not counted" in write_report(out).read_text()


@pytest.mark.slow
def test_names_are_escaped(out: Path) -> None:
    (row,) = generation("lift_barrier", "full", 0, 1, first=99)
    append_row(out / "results/generate/lift_barrier/full.jsonl", replace(row, account=Account(ended="<b>&")))
    assert "&lt;b&gt;&amp;" in write_report(out).read_text("utf-8")


@pytest.mark.slow
def test_plots_take_their_colours_from_the_page(out: Path) -> None:
    built, _ = publish(out, configured())
    (title, svg), *_ = plots.panels(built["ablation_success"])
    assert title == "Lift Barrier"
    ElementTree.fromstring(svg)  # well-formed
    colours = set(re.findall(r"#[0-9a-f]{6}\b", svg)) - {"#ffffff"}
    assert not colours
    assert {"var(--ours)", "var(--paper)", "var(--ink)"} <= set(re.findall(r"var\(--\w+\)", svg))
    assert plots.panels(built["ablation_success"])[0][1] == svg  # the same bytes every time
    assert "no violation" not in svg
    for row in generation("lift_barrier", "logical", 4, 0, first=99, violations=(1,)):
        append_row(out / "results/generate/lift_barrier/logical.jsonl", row)
    built, _ = publish(out, configured())
    assert "no violation" in plots.panels(built["ablation_success"])[0][1]


def test_curves_may_have_gaps_and_an_unfinished_row(tmp_path: Path) -> None:
    (tmp_path / "curves.csv").write_text("step,loss,validation_loss\n1,1.0,\n2,0.5,0.7\n3,0.2")
    columns = plots.read_curves(tmp_path / "curves.csv")
    assert columns["loss"] == [1.0, 0.5]
    np.testing.assert_equal(columns["validation_loss"], [np.nan, 0.7])
    assert "validation loss" in plots.curves(columns, "salt")


def test_curves_need_rows(tmp_path: Path) -> None:
    (tmp_path / "curves.csv").write_text("step,loss\n")
    with pytest.raises(ValueError, match="no rows"):
        plots.read_curves(tmp_path / "curves.csv")


@pytest.mark.slow
def test_the_command_rebuilds_from_rows_alone(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(out)]) == 0
    assert len(list((out / "tables").iterdir())) == 27
    first = {path: path.read_bytes() for path in (out / "tables").iterdir()}
    assert main(["--out", str(out)]) == 0
    assert first == {path: path.read_bytes() for path in (out / "tables").iterdir()}
    assert capsys.readouterr().out.rstrip().endswith("report.html")


def test_the_command_names_a_wrong_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(tmp_path)]) == 2
    assert f"error: --out is {tmp_path}; expected a folder with result rows" in capsys.readouterr().err


def test_the_command_names_a_bad_row(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (out / "results/generate/lift_barrier/full.jsonl").open("a") as file:
        file.write("{}\n")
    assert main(["--out", str(out)]) == 1
    assert "full.jsonl, line 11: no GenerationRow: fields missing" in capsys.readouterr().err


def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(StageError, match=r"cannot write the report to .*report\.html: Is a directory"):
        write_report(tmp_path)
