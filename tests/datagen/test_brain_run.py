"""Complete runs with a language model: recording, replay without the model, and no API key below outputs."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hydra.core.global_hydra import GlobalHydra

from rf_exp.command import run_guarded
from rf_exp.datagen.brain import to_json
from rf_exp.run import main
from rf_exp.statements import Proposal
from tests.datagen.language_server import LanguageServer, completion, failure
from tests.scenes import start_scene

ROOT = Path(__file__).parents[2]
KEY = "sk-test-0123456789abcdefghij"
GENERATE = ("stages=[generate]", "render=false", "episodes=2", "recordings=1", "workers=1", "wandb=disabled")


def run(*arguments, key=KEY):
    environment = {**os.environ, "OPENAI_API_KEY": key, "NO_PROXY": "127.0.0.1"}
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.run", *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def files_containing(folder, text):
    return [path for path in folder.rglob("*") if path.is_file() and text.encode() in path.read_bytes()]


def episode_replies(task, count):
    scene = start_scene(task, 0)
    proposals = [
        task.module.plan(each, task) for each in (scene, replace(scene, held=("barrier", "barrier")))
    ]
    return [completion(to_json(each)) for each in (*proposals, Proposal((), ()))] * count


@pytest.mark.slow
def test_a_run_with_a_model_is_replayed_without_it_and_stores_no_key(lift_barrier, tmp_path):
    live_folder, replay_folder = tmp_path / "live", tmp_path / "again"
    with LanguageServer([failure(401, f"wrong key {KEY}"), *episode_replies(lift_barrier, 2)]) as server:
        live_run = run(*GENERATE, "brain=openai", f"brain.base_url={server.url}", f"out={live_folder}")
    assert live_run.returncode == 0, live_run.stderr
    assert set(server.keys) == {f"Bearer {KEY}"}
    rows = [
        json.loads(line)
        for line in (live_folder / "results/generate/lift_barrier/full-disturbed-by-openai+gpt-4o.jsonl")
        .read_text()
        .splitlines()
    ]
    assert [(row["brain"], row["success"], row["attempts"]) for row in rows] == [
        ("openai+gpt-4o", True, 2),
        ("openai+gpt-4o", True, 1),
    ]
    answers = [[(each["round"], each["code"]) for each in row["dialogue"]["answers"]] for row in rows]
    assert answers == [[(1, "unreached"), (1, ""), (2, ""), (3, "")], [(1, ""), (2, ""), (3, "")]]
    assert "1 repairs, 1 refusals: unreached 1" in live_run.stdout
    assert f"exchanges in {live_folder}/exchanges/openai+gpt-4o/lift_barrier/full" in live_run.stdout
    assert len(server.requests) == 7  # the recording repeated the first episode without requests
    assert (live_folder / "recordings/lift_barrier/full/generate-fast-by-openai+gpt-4o-0.rrd").exists()
    assert files_containing(live_folder, "wrong key [key]") and not files_containing(live_folder, KEY)
    assert KEY not in live_run.stdout + live_run.stderr

    replayed = run(
        *GENERATE,
        "brain=replay",
        f"brain.exchanges={live_folder}/exchanges/openai+gpt-4o",
        f"out={replay_folder}",
        key="",
    )
    assert replayed.returncode == 0, replayed.stderr
    # The names of both stores contain the brain.
    store_paths = [next((out / "data").rglob("*.zarr")) for out in (live_folder, replay_folder)]
    arrays = [path.relative_to(store_paths[0]) for path in store_paths[0].rglob("c/*") if path.is_file()]
    arrays = [path for path in arrays if "certificate" not in path.parts]  # contains the name of the brain
    assert arrays and all(len({(store / path).read_bytes() for store in store_paths}) == 1 for path in arrays)


def test_a_key_on_the_command_line_is_refused_before_anything_is_written(monkeypatch, capsys, tmp_path):
    arguments = [*GENERATE, "brain=openai", f"+brain.api_key={KEY}", f"out={tmp_path}"]
    monkeypatch.setattr(sys, "argv", ["rf_exp.run", *arguments])
    GlobalHydra.instance().clear()
    assert run_guarded(main) == 2
    output = "".join(capsys.readouterr())
    assert "environment variable" in output and KEY not in output and not files_containing(tmp_path, KEY)
