"""A key that nobody reads is refused, with the nearest one and the file that it stands in."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.command import CONF, register_all_tasks
from rf_exp.errors import ArgumentError
from rf_exp.keys import RENAMED, keys_help
from rf_exp.keys.known import known_keys, possible_keys, unknown_keys
from rf_exp.keys.refusal import config_content, nearest
from rf_exp.tasks import SuccessEvaluator, load_task
from tests.conftest import TASKS
from tests.scenes import start_scene

BRAINS = sorted(path.stem for path in (CONF / "brain").glob("*.yaml"))
OWN_TASKS = {path.stem: config_content(path)[path.stem] for path in (CONF / "task").glob("*.yaml")}


def composed(brain: str) -> Any:
    """Everything at once: all tasks, rows and architectures."""
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        choices = ["task=all", "arch=all", "constraints=all", f"brain={brain}", "recipe=test", "policy=fast"]
        return OmegaConf.to_container(compose("config", choices))


def misspelt(word: str) -> Iterator[str]:
    """One letter wrong: left out, doubled, another one, two of them swapped."""
    for at in {0, len(word) // 2, len(word) - 1}:
        yield word[:at] + word[at + 1 :]
        yield word[:at] + word[at] + word[at:]
        yield word[:at] + ("q" if word[at] != "q" else "k") + word[at + 1 :]
        if at + 1 < len(word) and word[at] != word[at + 1]:
            yield word[:at] + word[at + 1] + word[at] + word[at + 2 :]


def with_misspelt(node: Any, key: list[str], wrong: str) -> Any:
    """A copy in which the last part of a key stands misspelt as well, of a whole entry with a part of it."""
    if isinstance(node, list):
        at = int(key[0])
        return [*node[:at], with_misspelt(node[at], key[1:], wrong), *node[at + 1 :]]
    if len(key) > 1:
        return node | {key[0]: with_misspelt(node.get(key[0], {}), key[1:], wrong)}
    value = node.get(key[0])
    return node | {wrong: dict([list(value.items())[-1]]) if isinstance(value, dict) else value}


@pytest.mark.slow
@pytest.mark.parametrize("brain", BRAINS)
def test_of_every_key_a_wrong_letter_is_missed_and_the_right_one_proposed(brain: str) -> None:
    node = composed(brain)
    keys = known_keys(node, OWN_TASKS)
    assert list(unknown_keys(node, keys)) == []
    there = list(possible_keys(node, keys))
    assert len(there) > 900 and {key.split(".")[1] for key in there if key.startswith("task.")} == set(TASKS)
    judged = [key for key in there if brain == "scripted" or key.startswith("brain.")]
    for number, dotted in enumerate(judged):
        key, ways = dotted.split("."), list(misspelt(dotted.rpartition(".")[2]))
        for wrong in ways if key[0] != "task" else {ways[number % len(ways)]}:
            said = ".".join((*key[:-1], wrong))
            if said in there or key[-1].isdecimal():  # another key by now, and the place in a list
                continue
            changed = with_misspelt({key[0]: node[key[0]]}, key, wrong)
            assert list(unknown_keys(changed, keys)) == [said]
            proposed = nearest(said, there)
            assert dotted in proposed and len(proposed) <= 4, (said, proposed)


def test_a_key_that_is_most_like_one_of_another_parent() -> None:
    there = [
        "picture.width",
        "policy.head.regression.hidden",
        "seed",
        "training.steps",
        "randomisation.mass_scale",
        "task.mass_scale",
    ]
    assert nearest("policy.width", there) == ["picture.width"]
    assert nearest("randomization.mass_scale", there) == ["randomisation.mass_scale"]
    assert nearest("training.seed", there) == ["seed"]
    assert nearest("xyzzy", there) == []


HEADED = "# @package _global_\n"
FILES = {
    "policy/mine": HEADED
    + "defaults: [fast, _self_]\ndisturbance: 0.0\ndelays_s: 0.0\npolicy: {unet_chanels: [32]}\n",
    "policy/bare": HEADED + "policy: {horizon: 16}\n",
    "policy/plain": "disturbance_rad: 0.0\n",
    "experiment/mine": HEADED + "sceens: 3\ntask: {lift_barrier: {success: {lft_m: 0.1}}}\n",
    "profile/mine": HEADED + "render: false\ndagger: {round: 1}\n",
    "arch/mine": "mine: {shared_policy: false, global_view: true, coordinate: true}\n",
    "constraints/mine": "mine: {logical: true, spatial: true, temporal: true, spacial: false}\n",
    "brain/mine": "defaults: [openai, _self_]\ntempratur: 1.0\n",
    "launch/mine": "engin: loky\n",
    "task/push_button": (CONF.parent / "tests/tutorial/conf/task/push_button.yaml").read_text()
    + "  step_limits: 100\n",
}


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder of a person's own configuration, with a misspelt key in every file."""
    for name, text in FILES.items():
        path = tmp_path / f"conf/{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "conf"


def told(done: subprocess.CompletedProcess[str]) -> str:
    """The last line of a command that has refused its arguments."""
    assert done.returncode == 2, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr.strip().splitlines()[-1]


@pytest.mark.slow
def test_a_misspelt_key_is_refused_with_the_file_it_stands_in(command, own, tmp_path) -> None:
    arguments = ["+launch=mine", "task=[lift_barrier,push_button]", f"hydra.searchpath=[file://{own}]"]
    arguments += [
        f"{group}=mine" for group in ("policy", "experiment", "profile", "arch", "constraints", "brain")
    ]
    said = told(command(*arguments, f"out={tmp_path / 'out'}"))
    for key, file, near in (
        ("policy.unet_chanels", "policy/mine", "policy.head.diffusion.channels"),
        ("disturbance", "policy/mine", "disturbance_rad"),
        ("delays_s", "policy/mine", "delay_s"),
        ("sceens", "experiment/mine", "scenes"),
        ("task.lift_barrier.success.lft_m", "experiment/mine", "task.lift_barrier.success.lift_m"),
        ("dagger.round", "profile/mine", "dagger.rounds"),
        ("arch.mine.coordinate", "arch/mine", "arch.mine.coordinated"),
        ("constraints.mine.spacial", "constraints/mine", "constraints.mine.spatial"),
        ("brain.tempratur", "brain/mine", "brain.temperature"),
        ("launch.engin", "launch/mine", "launch.engine"),
        ("task.push_button.step_limits", "task/push_button", "task.push_button.step_limit"),
    ):
        assert f"here is no key {key!r} in {own / file}.yaml; did you mean {near}?" in said
    assert said.count("no key") == 11
    assert said.endswith(
        "The keys are in conf/config.yaml and conf/policy/paper.yaml, those of tasks in conf/task, "
        "those of scenes that vary in conf/variation/none.yaml"
    )
    assert not list(tmp_path.glob("out/data/*"))


@pytest.mark.slow
def test_a_recipe_that_forgets_to_be_global_is_told_so(command, own, tmp_path) -> None:
    said = told(command(f"hydra.searchpath=[file://{own}]", "policy=plain", f"out={tmp_path / 'out'}"))
    where = f"in {own}/policy/plain.yaml: its first line must be '# @package _global_'."
    assert f"there is no key 'policy.disturbance_rad' {where}" in said


@pytest.mark.slow
def test_a_misspelt_key_of_the_command_line_is_refused_whatever_stands_before_it(command, tmp_path) -> None:
    added = {
        "+episode=1": "; did you mean episodes?",
        "++sceens=3": "; did you mean scenes?",
        "+randomization.mass_scale=1": "; did you mean randomisation?",
        "+policy.width=64": "; did you mean picture.width?",
        "+training.seed=1": "; did you mean seed?",
        "+brain.temperature=1": "; it comes with brain=openai.",
        "+task.lift_barier.step_limit=9": "; did you mean task.lift_barrier?",
        "++task.place_food.success.insid_m=1": "; did you mean task.place_food.success.inside_m?",
        "+xyzzy=1": ".",
    }
    said = told(command("task=[lift_barrier,place_food]", *added, f"out={tmp_path / 'out'}"))
    for override, hint in added.items():
        key = override.lstrip("+").partition("=")[0]
        key = key.replace(".mass_scale", "").replace("barier.step_limit", "barier")
        assert f"here is no key {key!r} on the command line{hint}" in said
    said = told(command("brain.temperature=1", f"out={tmp_path / 'out'}"))
    assert "there is no key 'brain.temperature'; it comes with brain=openai." in said
    said = told(command("variation.light_intensty=0.3", f"out={tmp_path / 'out'}"))
    assert "did you mean variation.light_intensity?" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["~demos", "~picture.width"],
            "the configuration lacks demos, picture.width; a recipe begins with 'defaults:",
        ),
        (
            ["policy=bare"],
            "the configuration lacks picture, delay_s, disturbance_rad and more; a recipe begins with",
        ),
        (["picture=3"], "picture is 3; expected keys below it: width, height"),
        (
            ["arch.separate_local=3"],
            "arch.separate_local is 3; expected keys below it: shared_policy, global_view",
        ),
        (["demos=null"], "demos is None; expected int"),
        (
            ["policy.head.refined.regression_steps=many"],
            "policy.head.refined.regression_steps is 'many'; expected int",
        ),
        (["~brain"], "no brain chosen; use brain=NAME"),
        (
            ["policy=chunks_of_16"],
            "there is no policy=chunks_of_16; did you mean policy=ablation/chunks_of_16?",
        ),
        (["+arch=all"], "arch is chosen already; choose another one with arch=NAME, without +"),
    ],
)
def test_a_key_that_lacks_or_holds_something_else_is_told(command, own, tmp_path, arguments, said) -> None:
    done = command(f"hydra.searchpath=[file://{own}]", *arguments, f"out={tmp_path / 'out'}")
    assert told(done).startswith(f"wrong argument: {said}")


def test_every_old_key_has_its_new_name() -> None:
    node = composed("scripted")
    keys = set(possible_keys(node, known_keys(node, OWN_TASKS)))
    assert set(RENAMED.values()) <= keys
    assert {old for old in RENAMED if old in keys} == {"policy.encoder"}  # which was a word


@pytest.mark.slow
def test_an_old_key_is_refused_with_its_new_name(command, own, tmp_path) -> None:
    (own / "policy/old.yaml").write_text(HEADED + "defaults: [fast, _self_]\ntraining: {draft_steps: 3}\n")
    for arguments, said in (
        (["policy.hold_rad=0.1"], "there is no key 'policy.hold_rad'; it is policy.acting.deadband_rad now."),
        (["+training.going=1"], "'training.going' on the command line; it is training.active_agent_sampling"),
        (["policy=old"], "policy/old.yaml; it is policy.head.refined.regression_steps now."),
        (
            ["policy.encoder=heatmaps"],
            "policy.encoder is 'heatmaps'; expected keys below it: name, keypoints; its value is",
        ),
    ):
        folder = f"hydra.searchpath=[file://{own}]"
        assert said in told(command(folder, *arguments, f"out={tmp_path / 'out'}"))


@pytest.mark.slow
def test_a_key_of_a_sweep_is_refused_in_each_of_its_processes(own, tmp_path) -> None:
    command = [
        sys.executable,
        "-m",
        "rf_exp.run",
        "-m",
        "hydra/launcher=joblib",
        "task=lift_barrier,place_food",
    ]
    command += [f"hydra.searchpath=[file://{own}]", "experiment=mine", f"out={tmp_path / 'out'}"]
    done = subprocess.run(command, cwd=CONF.parent, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stderr
    assert f"There is no key 'sceens' in {own}/experiment/mine.yaml; did you mean scenes?" in done.stderr
    assert not list(tmp_path.glob("out/data/*"))


@pytest.mark.slow
def test_what_is_a_person_s_own_to_name_is_taken(command, tmp_path) -> None:
    """Rows, architectures, objects, options of factories and engines."""
    arguments = ["+constraints.space={logical: true, spatial: true, temporal: false}"]
    arguments += ["+arch.mine={shared_policy: true, global_view: false}", "training.log_every=5"]
    arguments += ["+task.lift_barrier.objects.cube={asset: cube, x_m: 0.6}", "foreign.name=hold"]
    arguments += ["foreign.factory=examples.foreign.hold:make", "+foreign.options.steps=8"]
    done = command(*arguments, "stages=[bake]", f"out={tmp_path / 'out'}")
    assert "unknown stage 'bake'" in done.stderr  # which is looked at behind keys


@pytest.mark.slow
def test_what_is_said_of_a_foreign_policy_needs_one(command, tmp_path) -> None:
    done = command("foreign.action_steps=4", f"out={tmp_path / 'out'}")
    assert done.returncode == 2
    assert (
        "foreign.action_steps is given, and no policy is: foreign.name with foreign.factory or" in done.stderr
    )


def test_a_threshold_that_a_task_lacks_is_told() -> None:
    path = CONF.parent / "tests/tutorial/conf/task/push_button.yaml"
    node: Any = OmegaConf.to_container(OmegaConf.load(path))
    success = node["push_button"]["success"]
    success["psh_n"] = success.pop("push_n")
    task = load_task("push_button", node["push_button"])
    scene = start_scene(task, 0)
    said = "the task's module reads success.push_n, which its file does not have; it has hold_steps, psh_n"
    with pytest.raises(ArgumentError, match=re.escape(said)):
        SuccessEvaluator(task, scene)(scene)


def test_help_says_of_each_key_what_it_is_with_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    told, default = keys_help(), OmegaConf.load(CONF / "config.yaml")
    lines = told.splitlines()
    for key in set(map(str, default)) - {"defaults", "hydra"}:
        assert any(line.startswith(f"{key}:") for line in lines), key
    at = lines.index("attempts: 4")
    assert lines[at + 1].strip() == "proposals for one episode before it counts as failed"
    assert "  connect_s: 30" in lines and "-- evaluation" in lines
    assert "recipe: $${file_name:" in told  # a single one would be filled in
    assert all(len(line) <= 80 for line in lines)
