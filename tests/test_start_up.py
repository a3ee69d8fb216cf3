"""How the command begins: help and wrong arguments without the slow libraries, its script, completion."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import rf_exp

ROOT = Path(__file__).parents[1]
# What takes long to import and is no help in understanding a command line. numpy, SciPy and shapely are
# not among them: tasks are made of poses and outlines.
HEAVY = {
    *("torch", "diffusers", "mani_skill", "sapien", "gymnasium", "pinocchio", "coal", "toppra"),
    *("trimesh", "zarr", "matplotlib", "rerun", "wandb", "openai", "joblib", "cv2", "jinja2"),
}
LISTING = "import atexit, json, runpy, sys\n" + (
    "atexit.register(lambda: json.dump(sorted(sys.modules), open(sys.argv[0], 'w')))\n"
    "path, sys.argv = sys.argv[1], sys.argv[1:]\n"
    "runpy.run_module('rf_exp.run', run_name='__main__')\n"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "message", "also_spared"),
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
def test_help_and_wrong_arguments_import_nothing_heavy(arguments, code, message, also_spared, tmp_path):
    modules = tmp_path / "modules.json"
    command = [sys.executable, "-c", LISTING, str(modules), *arguments]
    if code:
        command.append(f"hydra.run.dir={tmp_path}")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == code, done.stderr
    assert message in done.stdout + done.stderr
    assert not (HEAVY | also_spared) & set(json.loads(modules.read_text()))


SPARED = """
import json, sys
from rf_exp import stages

def there(*wanted):
    return [getattr(stages, name) for name in wanted] and sorted({heavy} & set(sys.modules))

print(json.dumps([there("check_cameras", "print_estimate", "generate_data"), there("train_policies")]))
"""


@pytest.mark.slow
def test_who_only_starts_processes_at_work_does_without_what_they_need() -> None:
    """Simulator and networks are imported where somebody simulates and learns: that takes seconds."""
    ran = subprocess.run(
        [sys.executable, "-c", SPARED.replace("{heavy}", repr(HEAVY))],
        **{"cwd": ROOT, "capture_output": True, "text": True, "check": True},
    )
    generating, learning = json.loads(ran.stdout)
    simulator = {"mani_skill", "sapien", "toppra", "matplotlib"}
    assert not simulator & {*generating, *learning}
    assert "torch" not in generating and "diffusers" not in learning


@pytest.fixture
def script(tmp_path) -> Path:
    """The console script as pip writes it, from what pyproject.toml says of it."""
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
def test_the_console_script_is_the_module(script, arguments, tmp_path):
    done = [
        subprocess.run(
            [*command, *arguments], cwd=tmp_path, env=environment(script), capture_output=True, text=True
        )
        for command in (["rf-exp"], [sys.executable, "-m", "rf_exp.run"])
    ]
    assert done[0].returncode == done[1].returncode
    assert done[0].stdout.replace("rf-exp", "rf_exp.run") == done[1].stdout
    assert done[0].stderr == done[1].stderr


# As bash does when the tabulator is pressed at the end of a line; a line of answers for each.
PRESS = r"""
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
    offered = {
        "task=": {"task=all", "task=lift_barrier", "task=place_food"},
        "task=li": {"task=lift_barrier"},
        "arch=s": {"arch=shared_global", "arch=separate_local"},
        "constraints=logical_": {"constraints=logical_temporal", "constraints=logical_spatial"},
        "trai": {"training.", "train_seed="},
    }
    lines = [f"rf-exp seed=3 {begun}" for begun in offered]
    done = subprocess.run(
        ["bash", "-c", PRESS, "bash", *lines],
        **{"cwd": tmp_path, "env": environment(script), "capture_output": True, "text": True, "timeout": 60},
    )
    answers = done.stdout.splitlines()
    assert len(answers) == len(offered), done.stderr
    for (begun, wanted), answer in zip(offered.items(), answers, strict=True):
        assert wanted <= set(answer.split())
        assert all(choice.startswith(begun) for choice in answer.split())


CORE = """
import ctypes, rf_exp, numpy, pathlib
maps = pathlib.Path("/proc/self/maps").read_text().splitlines()
library = ctypes.CDLL(next(line.split()[-1] for line in maps if "openblas" in line))
name = next(n for n in ("scipy_openblas_get_corename64_", "openblas_get_corename") if hasattr(library, n))
tell = getattr(library, name)
tell.restype = ctypes.c_char_p
print(tell().decode(), *numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", ()))
"""
EVERY = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"  # kernels that NumPy has beyond those of any processor


@pytest.mark.skipif(
    not Path("/proc/cpuinfo").exists() or " avx2 " not in Path("/proc/cpuinfo").read_text(),
    reason="the kernels are those of x86-64 processors with AVX2",
)
@pytest.mark.parametrize(
    ("chosen", "used"),
    [
        ({}, "Haswell X86_V3"),
        ({"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": EVERY}, "Nehalem"),
    ],
)
def test_numbers_are_computed_alike_on_each_processor(chosen: dict[str, str], used: str) -> None:
    own = {name: value for name, value in os.environ.items() if name not in rf_exp.KERNELS}
    ran = subprocess.run(
        [sys.executable, "-c", CORE], env=own | chosen, capture_output=True, text=True, check=True
    )
    assert ran.stdout.split() == used.split()


HELPED = {
    "run": "demonstrations, policies that learn from them",
    "gallery": "a contact sheet and a film of each chosen task",
    "demonstration": "one episode on a page, with its recording",
    "client": "asked with made-up observations",
    "rescue": "outputs/data/lift_barrier/full/fast.zarr",
    "data": "COMMAND --help",
    "doctor": "what this machine can do",
    "ablation": "folder with results/",
    "compose": "two arms put both cubes into the bowl",
    "laws": "a line a law for each chosen task",
    "verify": "Published rows of demonstrations, made again",
    "tasks.assets": "one of barrier, box, box_lid, camera",
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "says"), HELPED.items())
def test_the_help_of_a_command_is_its_own(name: str, says: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", f"rf_exp.{name}", "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0 and not done.stderr
    head = done.stdout.splitlines()[0]
    assert head.removeprefix("usage: ").startswith(f"python -m rf_exp.{name} ["), head
    assert says in done.stdout
    assert "powered by Hydra" not in done.stdout and "quick.zarr" not in done.stdout
    others = set(HELPED) - {name, "run", "tasks.assets"}  # what comes after it may be named
    assert not [other for other in others if f"rf_exp.{other}" in head]


def test_every_command_is_asked_for_its_help() -> None:
    commands = {
        ".".join(path.relative_to(ROOT / "rf_exp").with_suffix("").parts).removesuffix(".__main__")
        for path in (ROOT / "rf_exp").rglob("*.py")
        if '__name__ == "__main__"' in path.read_text("utf-8")
    }
    assert commands - set(HELPED) == {"sim.vulkan"}  # of the set-up, without arguments
