"""Unknown keys are refused, with the nearest known key and the file that contains them."""

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
    """The configuration with all tasks, rows and architectures."""
    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        choices = ["task=all", "arch=all", "constraints=all", f"brain={brain}", "recipe=test", "policy=fast"]
        return OmegaConf.to_container(compose("config", choices))


def misspelt(word: str) -> Iterator[str]:
    """Words with one error: a letter missing, doubled, replaced, or two letters swapped."""
    for index in {0, len(word) // 2, len(word) - 1}:
        yield word[:index] + word[index + 1 :]
        yield word[:index] + word[index] + word[index:]
        yield word[:index] + ("q" if word[index] != "q" else "k") + word[index + 1 :]
        if index + 1 < len(word) and word[index] != word[index + 1]:
            yield word[:index] + word[index + 1] + word[index] + word[index + 2 :]


def with_misspelt(node: Any, key: list[str], wrong: str) -> Any:
    """A copy that also has the key with its last part misspelt; of a mapping, with its last entry only."""
    if isinstance(node, list):
        index = int(key[0])
        return [*node[:index], with_misspelt(node[index], key[1:], wrong), *node[index + 1 :]]
    if len(key) > 1:
        return node | {key[0]: with_misspelt(node.get(key[0], {}), key[1:], wrong)}
    value = node.get(key[0])
    return node | {wrong: dict([list(value.items())[-1]]) if isinstance(value, dict) else value}


@pytest.mark.slow
@pytest.mark.parametrize("brain", BRAINS)
def test_every_key_with_a_wrong_letter_is_refused_and_the_right_one_proposed(brain: str) -> None:
    node = composed(brain)
    keys = known_keys(node, OWN_TASKS)
    assert list(unknown_keys(node, keys)) == []
    existing = list(possible_keys(node, keys))
    assert len(existing) > 900 and {key.split(".")[1] for key in existing if key.startswith("task.")} == set(
        TASKS
    )
    tested = [key for key in existing if brain == "scripted" or key.startswith("brain.")]
    for number, dotted in enumerate(tested):
        key, misspellings = dotted.split("."), list(misspelt(dotted.rpartition(".")[2]))
        for wrong in misspellings if key[0] != "task" else {misspellings[number % len(misspellings)]}:
            wrong_key = ".".join((*key[:-1], wrong))
            if wrong_key in existing or key[-1].isdecimal():  # an existing key, or an index of a list
                continue
            changed = with_misspelt({key[0]: node[key[0]]}, key, wrong)
            assert list(unknown_keys(changed, keys)) == [wrong_key]
            proposals = nearest(wrong_key, existing)
            assert dotted in proposals and len(proposals) <= 4, (wrong_key, proposals)


def test_the_nearest_key_may_have_another_parent() -> None:
    existing = [
        "picture.width",
        "policy.head.regression.hidden",
        "seed",
        "training.steps",
        "randomisation.mass_scale",
        "task.mass_scale",
    ]
    assert nearest("policy.width", existing) == ["picture.width"]
    assert nearest("randomization.mass_scale", existing) == ["randomisation.mass_scale"]
    assert nearest("training.seed", existing) == ["seed"]
    assert nearest("xyzzy", existing) == []


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
def user_conf(tmp_path: Path) -> Path:
    """A user's configuration folder with a misspelt key in every file."""
    for name, text in FILES.items():
        path = tmp_path / f"conf/{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "conf"


def refusal(result: subprocess.CompletedProcess[str]) -> str:
    """The last error line of a command that refused its arguments."""
    assert result.returncode == 2, result.stdout + result.stderr
    assert "Traceback" not in result.stderr
    return result.stderr.strip().splitlines()[-1]


@pytest.mark.slow
def test_a_misspelt_key_is_refused_with_its_file(command, user_conf, tmp_path) -> None:
    arguments = ["+launch=mine", "task=[lift_barrier,push_button]", f"hydra.searchpath=[file://{user_conf}]"]
    arguments += [
        f"{group}=mine" for group in ("policy", "experiment", "profile", "arch", "constraints", "brain")
    ]
    message = refusal(command(*arguments, f"out={tmp_path / 'out'}"))
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
        assert f"here is no key {key!r} in {user_conf / file}.yaml; did you mean {near}?" in message
    assert message.count("no key") == 11
    assert message.endswith(
        "The keys are in conf/config.yaml and conf/policy/paper.yaml, those of tasks in conf/task, "
        "those of scenes that vary in conf/variation/none.yaml"
    )
    assert not list(tmp_path.glob("out/data/*"))


@pytest.mark.slow
def test_a_recipe_without_the_global_package_is_refused_with_advice(command, user_conf, tmp_path) -> None:
    message = refusal(
        command(f"hydra.searchpath=[file://{user_conf}]", "policy=plain", f"out={tmp_path / 'out'}")
    )
    where = f"in {user_conf}/policy/plain.yaml: its first line must be '# @package _global_'."
    assert f"there is no key 'policy.disturbance_rad' {where}" in message


@pytest.mark.slow
def test_a_misspelt_key_of_the_command_line_is_refused_with_any_prefix(command, tmp_path) -> None:
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
    message = refusal(command("task=[lift_barrier,place_food]", *added, f"out={tmp_path / 'out'}"))
    for override, hint in added.items():
        key = override.lstrip("+").partition("=")[0]
        key = key.replace(".mass_scale", "").replace("barier.step_limit", "barier")
        assert f"here is no key {key!r} on the command line{hint}" in message
    message = refusal(command("brain.temperature=1", f"out={tmp_path / 'out'}"))
    assert "there is no key 'brain.temperature'; it comes with brain=openai." in message
    message = refusal(command("variation.light_intensty=0.3", f"out={tmp_path / 'out'}"))
    assert "did you mean variation.light_intensity?" in message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
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
def test_missing_keys_and_values_of_a_wrong_type_are_refused(
    command, user_conf, tmp_path, arguments, message
) -> None:
    result = command(f"hydra.searchpath=[file://{user_conf}]", *arguments, f"out={tmp_path / 'out'}")
    assert refusal(result).startswith(f"wrong argument: {message}")


def test_every_old_key_has_its_new_name() -> None:
    node = composed("scripted")
    keys = set(possible_keys(node, known_keys(node, OWN_TASKS)))
    assert set(RENAMED.values()) <= keys
    assert {old for old in RENAMED if old in keys} == {"policy.encoder"}  # its value was a word


@pytest.mark.slow
def test_an_old_key_is_refused_with_its_new_name(command, user_conf, tmp_path) -> None:
    (user_conf / "policy/old.yaml").write_text(
        HEADED + "defaults: [fast, _self_]\ntraining: {draft_steps: 3}\n"
    )
    for arguments, message in (
        (["policy.hold_rad=0.1"], "there is no key 'policy.hold_rad'; it is policy.acting.deadband_rad now."),
        (["+training.going=1"], "'training.going' on the command line; it is training.active_agent_sampling"),
        (["policy=old"], "policy/old.yaml; it is policy.head.refined.regression_steps now."),
        (
            ["policy.encoder=heatmaps"],
            "policy.encoder is 'heatmaps'; expected keys below it: name, keypoints; its value is",
        ),
    ):
        folder = f"hydra.searchpath=[file://{user_conf}]"
        assert message in refusal(command(folder, *arguments, f"out={tmp_path / 'out'}"))


@pytest.mark.slow
def test_a_key_of_a_sweep_is_refused_in_each_of_its_processes(user_conf, tmp_path) -> None:
    command = [
        sys.executable,
        "-m",
        "rf_exp.run",
        "-m",
        "hydra/launcher=joblib",
        "task=lift_barrier,place_food",
    ]
    command += [f"hydra.searchpath=[file://{user_conf}]", "experiment=mine", f"out={tmp_path / 'out'}"]
    result = subprocess.run(command, cwd=CONF.parent, capture_output=True, text=True, timeout=120)
    assert result.returncode == 2, result.stderr
    assert (
        f"There is no key 'sceens' in {user_conf}/experiment/mine.yaml; did you mean scenes?" in result.stderr
    )
    assert not list(tmp_path.glob("out/data/*"))


@pytest.mark.slow
def test_names_that_users_may_choose_are_accepted(command, tmp_path) -> None:
    """Rows, architectures, objects, options of factories and engines."""
    arguments = ["+constraints.space={logical: true, spatial: true, temporal: false}"]
    arguments += ["+arch.mine={shared_policy: true, global_view: false}", "training.log_every=5"]
    arguments += ["+task.lift_barrier.objects.cube={asset: cube, x_m: 0.6}", "foreign.name=hold"]
    arguments += ["foreign.factory=examples.foreign.hold:make", "+foreign.options.steps=8"]
    result = command(*arguments, "stages=[bake]", f"out={tmp_path / 'out'}")
    assert "unknown stage 'bake'" in result.stderr  # checked after the keys


@pytest.mark.slow
def test_keys_of_a_foreign_policy_need_a_foreign_policy(command, tmp_path) -> None:
    result = command("foreign.action_steps=4", f"out={tmp_path / 'out'}")
    assert result.returncode == 2
    assert (
        "foreign.action_steps is given, and no policy is: foreign.name with foreign.factory or"
        in result.stderr
    )


def test_a_missing_threshold_of_a_task_is_named() -> None:
    path = CONF.parent / "tests/tutorial/conf/task/push_button.yaml"
    node: Any = OmegaConf.to_container(OmegaConf.load(path))
    success = node["push_button"]["success"]
    success["psh_n"] = success.pop("push_n")
    task = load_task("push_button", node["push_button"])
    scene = start_scene(task, 0)
    message = "the task's module reads success.push_n, which its file does not have; it has hold_steps, psh_n"
    with pytest.raises(ArgumentError, match=re.escape(message)):
        SuccessEvaluator(task, scene)(scene)


def test_the_help_describes_each_key_with_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text, default = keys_help(), OmegaConf.load(CONF / "config.yaml")
    lines = text.splitlines()
    for key in set(map(str, default)) - {"defaults", "hydra"}:
        assert any(line.startswith(f"{key}:") for line in lines), key
    index = lines.index("attempts: 4")
    assert lines[index + 1].strip() == "proposals for one episode before it counts as failed"
    assert "  connect_s: 30" in lines and "-- evaluation" in lines
    assert "recipe: $${file_name:" in text  # a single $ would be interpolated
    assert all(len(line) <= 80 for line in lines)
