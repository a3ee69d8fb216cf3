"""Start of the command: help and wrong arguments without slow imports, console script, shell completion."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import rf_exp

ROOT = Path(__file__).parents[1]
# Slow imports that parsing a command line does not need. numpy, SciPy and shapely are not among them: tasks
# consist of poses and outlines.
HEAVY = {
    *("torch", "diffusers", "mani_skill", "sapien", "gymnasium", "pinocchio", "coal", "toppra"),
    *("trimesh", "zarr", "matplotlib", "rerun", "wandb", "openai", "joblib", "cv2", "jinja2"),
}
LIST_MODULES = "import atexit, json, runpy, sys\n" + (
    "atexit.register(lambda: json.dump(sorted(sys.modules), open(sys.argv[0], 'w')))\n"
    "path, sys.argv = sys.argv[1], sys.argv[1:]\n"
    "runpy.run_module('rf_exp.run', run_name='__main__')\n"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "message", "also_absent"),
    [
        (["--help"], 0, "Configuration groups", {"numpy"}),
        (["demoz=3"], 2, "demoz", {"numpy"}),
        (["task=juggle"], 2, "lift_barrier", {"numpy"}),
        (["brain.api_key=sk-12345678"], 2, "brain.api_key is not taken", {"numpy"}),
        (["stages=[bake]"], 2, "unknown stage 'bake'", set()),
        (["training.steps=-5"], 2, "steps is -5", set()),
        (
            ["policy.encoder.name=vit"],
            2,
            "unknown encoder 'vit'; available: compact, keypoints, privileged, resnet18",
            set(),
        ),
        (["brain=openai", "brain.retries=-1"], 2, "brain.retries is -1", set()),
        (["task.lift_barrier.objects.barrier.asset=lamp"], 2, "unknown asset 'lamp'", set()),
    ],
)
def test_help_and_wrong_arguments_skip_slow_imports(arguments, code, message, also_absent, tmp_path):
    modules = tmp_path / "modules.json"
    command = [sys.executable, "-c", LIST_MODULES, str(modules), *arguments]
    if code:
        command.append(f"hydra.run.dir={tmp_path}")
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert result.returncode == code, result.stderr
    assert message in result.stdout + result.stderr
    assert not (HEAVY | also_absent) & set(json.loads(modules.read_text()))


IMPORTS_OF_STAGES = """
import json, sys
from rf_exp import stages

def there(*wanted):
    return [getattr(stages, name) for name in wanted] and sorted({heavy} & set(sys.modules))

print(json.dumps([there("check_cameras", "print_estimate", "generate_data"), there("train_policies")]))
"""


@pytest.mark.slow
def test_stages_skip_imports_that_only_workers_need() -> None:
    """Simulator and networks, which take seconds to import, are imported only where they are used."""
    result = subprocess.run(
        [sys.executable, "-c", IMPORTS_OF_STAGES.replace("{heavy}", repr(HEAVY))],
        **{"cwd": ROOT, "capture_output": True, "text": True, "check": True},
    )
    generating, learning = json.loads(result.stdout)
    simulator = {"mani_skill", "sapien", "toppra", "matplotlib"}
    assert not simulator & {*generating, *learning}
    assert "torch" not in generating and "diffusers" not in learning


@pytest.fixture
def script(tmp_path) -> Path:
    """The console script as pip writes it, from its entry in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    module, _, function = project["scripts"]["rf-exp"].partition(":")
    path = tmp_path / "bin" / "rf-exp"
    path.parent.mkdir()
    path.write_text(
        f"#!{sys.executable}\nimport sys\nfrom {module} import {function}\nsys.exit({function}())\n"
    )
    path.chmod(0o755)
    return path


def environment(script: Path) -> dict[str, str]:
    return {**os.environ, "PATH": f"{script.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--help"], ["stages=[bake]"]])
def test_the_console_script_equals_the_module(script, arguments, tmp_path):
    results = [
        subprocess.run(
            [*command, *arguments], cwd=tmp_path, env=environment(script), capture_output=True, text=True
        )
        for command in (["rf-exp"], [sys.executable, "-m", "rf_exp.run"])
    ]
    assert results[0].returncode == results[1].returncode
    assert results[0].stdout.replace("rf-exp", "rf_exp.run") == results[1].stdout
    assert results[0].stderr == results[1].stderr


# Completes each line as bash does for Tab at its end, and prints one line of completions for each.
COMPLETE = r"""
eval "$(rf-exp -sc install=bash)"
complete=$(complete -p rf-exp | sed -E 's/.* -F ([^ ]+).*/\1/')
for COMP_LINE; do
    COMP_POINT=${#COMP_LINE} COMP_WORDS=($COMP_LINE)
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
    $complete
    echo "${COMPREPLY[@]}"
done
"""


@pytest.mark.slow
def test_the_shell_completes_arguments(script, tmp_path):
    completions = {
        "task=": {"task=all", "task=lift_barrier", "task=place_food"},
        "task=li": {"task=lift_barrier"},
        "arch=s": {"arch=shared_global", "arch=separate_local"},
        "constraints=logical_": {"constraints=logical_temporal", "constraints=logical_spatial"},
        "trai": {"training.", "train_seed="},
    }
    lines = [f"rf-exp seed=3 {prefix}" for prefix in completions]
    result = subprocess.run(
        ["bash", "-c", COMPLETE, "bash", *lines],
        **{"cwd": tmp_path, "env": environment(script), "capture_output": True, "text": True, "timeout": 60},
    )
    answers = result.stdout.splitlines()
    assert len(answers) == len(completions), result.stderr
    for (prefix, expected), answer in zip(completions.items(), answers, strict=True):
        assert expected <= set(answer.split())
        assert all(choice.startswith(prefix) for choice in answer.split())


PRINT_KERNELS = """
import ctypes, rf_exp, numpy, pathlib
maps = pathlib.Path("/proc/self/maps").read_text().splitlines()
library = ctypes.CDLL(next(line.split()[-1] for line in maps if "openblas" in line))
name = next(n for n in ("scipy_openblas_get_corename64_", "openblas_get_corename") if hasattr(library, n))
tell = getattr(library, name)
tell.restype = ctypes.c_char_p
print(tell().decode(), *numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", ()))
"""
ALL_KERNELS = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"  # all optional kernels of NumPy


@pytest.mark.skipif(
    not Path("/proc/cpuinfo").exists() or " avx2 " not in Path("/proc/cpuinfo").read_text(),
    reason="the kernels are those of x86-64 processors with AVX2",
)
@pytest.mark.parametrize(
    ("variables", "kernels"),
    [
        ({}, "Haswell X86_V3"),
        ({"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": ALL_KERNELS}, "Nehalem"),
    ],
)
def test_the_same_kernels_are_selected_on_each_processor(variables: dict[str, str], kernels: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in rf_exp.KERNELS}
    result = subprocess.run(
        [sys.executable, "-c", PRINT_KERNELS],
        env=environment | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.split() == kernels.split()


HELP_TEXTS = {
    "run": "generates demonstrations, trains and evaluates policies",
    "gallery": "a contact sheet and a film of each chosen task",
    "demonstration": "generates one episode as a page with a recording",
    "client": "with synthetic observations",
    "rescue": "outputs/data/lift_barrier/full/fast.zarr",
    "data": "COMMAND --help",
    "doctor": "what this machine can do",
    "ablation": "folder with results/",
    "compose": "two arms put both cubes into the bowl",
    "laws": "checks the laws of each chosen task",
    "verify": "Verify published rows of demonstrations",
    "tasks.assets": "one of barrier, box, box_lid, camera",
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "text"), HELP_TEXTS.items())
def test_every_command_has_its_own_help(name: str, text: str) -> None:
    result = subprocess.run(
        [sys.executable, "-m", f"rf_exp.{name}", "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 0 and not result.stderr
    head = result.stdout.splitlines()[0]
    assert head.removeprefix("usage: ").startswith(f"python -m rf_exp.{name} ["), head
    assert text in result.stdout
    assert "powered by Hydra" not in result.stdout and "quick.zarr" not in result.stdout
    others = set(HELP_TEXTS) - {name, "run", "tasks.assets"}  # run and tasks.assets may be named
    assert not [other for other in others if f"rf_exp.{other}" in head]


def test_the_help_of_every_command_is_tested() -> None:
    commands = {
        ".".join(path.relative_to(ROOT / "rf_exp").with_suffix("").parts).removesuffix(".__main__")
        for path in (ROOT / "rf_exp").rglob("*.py")
        if '__name__ == "__main__"' in path.read_text("utf-8")
    }
    assert commands - set(HELP_TEXTS) == {"sim.vulkan"}  # for the set-up, without arguments
