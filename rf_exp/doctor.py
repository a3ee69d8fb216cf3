"""`python -m rf_exp.doctor`: what this machine can do, and how to fix what it cannot.

Prints one line per check. Exit code 0 only if the main job (`python -m rf_exp.run`) can run here.
Needs only the standard library, so that it also works where nothing is installed yet.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from rf_exp.installed import CHECKED_OUT
from rf_exp.texts import shown

# Not `make setup`, which does nothing while its stamp file is current.
SETUP_COMMAND = "scripts/setup.sh" if CHECKED_OUT else "pip install --force-reinstall and rf_exp's wheel"
HEADLESS = "pip uninstall -y opencv-python; pip install --force-reinstall --no-deps opencv-python-headless"
# Fixes that pip does not make by itself; the set-up script does.
MANUAL_FIXES = {} if CHECKED_OUT else {"cv2": HEADLESS, "pinocchio": "apt-get install libgomp1"}
PYTHONS = ((3, 11), (3, 12))
# Modules with native code, whose import may fail although they are installed. Torch is the last: it loads
# libraries (libgomp) whose absence would otherwise go unnoticed in the others.
MODULES = ("pinocchio", "coal", "numpy", "cv2", "toppra", "sapien", "rerun", "mani_skill", "torch")
IMPORT_TIMEOUT_S = 300.0
MAX_LISTED = 4  # problems named on one line
RECIPE = "++recipe=fast"  # in a run it comes from Hydra's runtime choices
QUICK_GB, PAPER_GB = 1.0, 10.0  # free disk space for the main job, and for one task with profile=paper

State = Literal["ok", "note", "missing"]


@dataclass(frozen=True)
class Check:
    """The result of one check. Only state `missing` keeps the main job from running."""

    name: str
    state: State
    detail: str
    affects: str = ""  # what does not work, or only slowly
    remedy: str = ""  # the command that fixes it

    def __str__(self) -> str:
        parts = [self.detail]
        parts += [f"affects: {self.affects}"] if self.affects else []
        parts += [f"fix: {self.remedy}"] if self.remedy else []
        return f"{self.state:8}{self.name:10}{'; '.join(parts)}"


def python() -> Check:
    """Checks the version of the running interpreter."""
    version = sys.version.split()[0]
    detail = f"{version} at {sys.executable}"
    if sys.version_info[:2] in PYTHONS:
        return Check("python", "ok", detail)
    remedy = f"install Python 3.11, then PYTHON=python3.11 {SETUP_COMMAND}"
    return Check("python", "missing", f"{detail}; 3.11 or 3.12 is needed", "everything", remedy)


def packages(distribution: str = "rf_exp") -> Check:
    """Checks that everything that `distribution` requires is installed, in a version it accepts."""
    try:
        required = metadata.requires(distribution) or []
    except metadata.PackageNotFoundError:
        return Check("packages", "missing", f"{distribution} is not installed", "everything", SETUP_COMMAND)
    required_here = [text for text in required if "extra ==" not in text]
    unmet = [problem for text in required_here if (problem := _unmet(text))]
    if unmet:
        detail = ", ".join(unmet[:MAX_LISTED]) + (
            f" and {len(unmet) - MAX_LISTED} more" if unmet[MAX_LISTED:] else ""
        )
        return Check("packages", "missing", detail, "everything that uses them", SETUP_COMMAND)
    try:
        detail = f"opencv-python {metadata.version('opencv-python')} is installed over the headless build"
        return Check(
            "packages",
            "note",
            detail,
            "cv2 on machines without libGL",
            MANUAL_FIXES.get("cv2", SETUP_COMMAND),
        )
    except metadata.PackageNotFoundError:
        pass
    return Check("packages", "ok", f"{len(required_here)} required, all installed")


def _unmet(requirement: str) -> str:
    """What is wrong with one requirement; empty if it is met. Parses `name>=1.2,<3` and `==`."""
    match = re.match(r"([A-Za-z0-9._-]+)(?:\[[^]]*])?\s*([^;]*)", requirement)
    if match is None:
        return f"{requirement} (not understood)"
    name, bounds = match.groups()
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"{name} is not installed"
    have = _numbers(version)
    for operator, bound in re.findall(r"(==|>=|<)\s*([0-9.]+)", bounds):
        want = _numbers(bound)
        met = {"==": have[: len(want)] == want, ">=": have >= want, "<": have < want}[operator]
        if not met:
            return f"{name} is {version}, needed is {bounds.strip()}"
    return ""


def _numbers(version: str) -> tuple[int, ...]:
    """The release part: `2.13.0+cpu` is (2, 13, 0)."""
    return tuple(int(part) for part in re.findall(r"\d+", re.split(r"[^0-9.]", version)[0]))


def imports(modules: Iterable[str] = MODULES) -> tuple[Check, Check]:
    """The checks `imports`, in a child process, and `gpu`; names a module that ends the process."""
    names = tuple(modules)
    code = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]:\n"
        "    print('try', name, flush=True)\n"
        "    importlib.import_module(name)\n"
        "    print('got', name, flush=True)\n"
        "if 'torch' in sys.argv[1:]:\n"
        "    import torch\n"
        "    for k in range(torch.cuda.device_count()):\n"
        "        free, total = torch.cuda.mem_get_info(k)\n"
        "        print('gpu', torch.cuda.get_device_name(k) + f', {total / 1e9:.0f} GB', flush=True)\n"
    )
    try:
        child = subprocess.run(
            [sys.executable, "-c", code, *names], capture_output=True, text=True, timeout=IMPORT_TIMEOUT_S
        )
        output, errors = child.stdout, child.stderr.strip().splitlines()
        errors = errors or [f"the process ended with {child.returncode}"]
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode() if isinstance(error.stdout, bytes) else error.stdout or ""
        errors = [f"no answer in {IMPORT_TIMEOUT_S:g} s"]
    lines: dict[str, list[str]] = {"try": [], "got": [], "gpu": []}
    for line in output.splitlines():
        key, _, value = line.partition(" ")
        lines.get(key, []).append(value)
    broken = [name for name in lines["try"] if name not in lines["got"]]
    imported_names, affects = " ".join(lines["got"]), "every stage that uses it"
    imported = Check("imports", "ok", imported_names)
    if broken:
        remedy = MANUAL_FIXES.get(broken[0], SETUP_COMMAND)
        imported = Check("imports", "missing", f"{broken[0]}: {errors[-1]}", affects, remedy)
    return imported, _gpu(lines["gpu"])


def _gpu(names: list[str]) -> Check:
    if names:
        return Check("gpu", "ok", "; ".join(names))
    detail, remedy = f"none; {os.cpu_count()} CPU cores", "use a machine with an NVIDIA GPU"
    if Path("/dev/nvidiactl").exists():
        detail = "an NVIDIA GPU is present, but torch cannot use it"
        remedy = "install a CUDA build of torch and an NVIDIA driver that fits it"
    return Check(
        "gpu", "note", detail, "nothing for profile=quick; training with profile=paper is slow", remedy
    )


def vulkan() -> Check:
    """Renders a picture with SAPIEN."""
    try:
        from rf_exp.sim import WITHOUT_RENDERING, render_probe
    except ImportError as error:
        return Check("vulkan", "missing", f"not tried: {error}", "pictures", SETUP_COMMAND)
    probe = render_probe()
    if probe.ok:
        return Check("vulkan", "ok", str(probe))
    return Check("vulkan", "missing", str(probe), WITHOUT_RENDERING, probe.remedy)


def disk(out: Path = Path("outputs")) -> Check:
    """Checks free disk space and write access where results are written."""
    folder, refusal = _writable_folder(out)
    if refusal:
        return Check("disk", "missing", refusal, "all results", "choose another: out=FOLDER")
    free_gb = shutil.disk_usage(folder).free / 1e9
    detail = f"{free_gb:.1f} GB free for {out}"
    if free_gb < QUICK_GB:
        detail, remedy = (
            f"{detail}, {QUICK_GB:g} GB are needed",
            "free some, or choose another disk: out=FOLDER",
        )
        return Check("disk", "missing", detail, "all results", remedy)
    if free_gb < PAPER_GB:
        affects = f"profile=paper may want {PAPER_GB:g} GB a task"
        return Check("disk", "note", detail, affects, "out=FOLDER on another disk")
    return Check("disk", "ok", detail)


def _writable_folder(folder: Path) -> tuple[Path, str]:
    """The nearest existing folder at or above `folder`, and why it cannot be written to; empty if it can."""
    folder = folder.absolute()
    while not os.path.exists(folder):  # also False without permission to look
        folder = folder.parent
    writable = folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
    return folder, "" if writable else f"{folder} cannot be written to"


def cache() -> Check:
    """Checks that the robot's decimated meshes, which every simulation loads, are cached or can be made."""
    affects, remedy = "every simulation", "set XDG_CACHE_HOME to a writable folder"
    try:
        from rf_exp.errors import StageError
        from rf_exp.robots import DEFAULT, cache_folder, has_simplified_meshes
    except ImportError as error:
        return Check("cache", "missing", f"not tried: {error}", affects, SETUP_COMMAND)
    try:
        folder = cache_folder(DEFAULT)
    except StageError as error:
        return Check("cache", "missing", str(error).partition("; ")[0], affects, remedy)
    if has_simplified_meshes(DEFAULT, folder):
        return Check("cache", "ok", f"meshes are in {folder}")
    _, refusal = _writable_folder(folder)
    if refusal:
        return Check("cache", "missing", f"{refusal}, and the meshes are not in {folder}", affects, remedy)
    return Check("cache", "ok", f"meshes will be made in {folder}")


def configuration() -> Check:
    """Checks that all files of the default configuration exist and belong to this version."""
    affects, remedy = (
        "every command",
        f"install rf_exp again: {SETUP_COMMAND}, or its wheel with pip --force-reinstall",
    )
    try:
        from rf_exp.experiment import read_experiment

        experiment = read_experiment(_composed([RECIPE]))
    except ImportError as error:
        return Check("config", "missing", f"not tried: {error}", affects, SETUP_COMMAND)
    except Exception as error:  # files of another version may cause any error
        problem = f"no key {error} in it" if isinstance(error, KeyError) else " ".join(str(error).split())
        return Check("config", "missing", problem or type(error).__name__, affects, remedy)
    return Check("config", "ok", f"the default is {', '.join(task.name for task in experiment.tasks)}")


def _composed(overrides: list[str]) -> Any:
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    from rf_exp.command import CONF, register_all_tasks

    register_all_tasks()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_container(compose("config", overrides), resolve=True)


def brain(overrides: list[str]) -> Check:
    """Checks whether the model server of `brain=openai` and its options enforces a schema on answers."""
    try:
        from rf_exp.command import ARGUMENT_ERRORS
        from rf_exp.datagen.brain import OpenAISpec, probe, read_brain
        from rf_exp.secrets import refuse_keys
        from rf_exp.tasks import load_task
    except ImportError as error:
        return Check("brain", "missing", f"not tried: {error}", "runs with a model", SETUP_COMMAND)
    try:
        refuse_keys(overrides)
        composed = _composed([RECIPE, *overrides])
        spec = read_brain(composed["brain"])
        if not isinstance(spec, OpenAISpec):
            return Check("brain", "ok", f"{spec.name} asks no server")
        result = probe(spec, load_task(*next(iter(composed["task"].items()))))
    except ARGUMENT_ERRORS as error:
        return Check("brain", "missing", " ".join(str(error).split()), "runs with this brain", "correct it")
    shorter_thinking = "brain.extra_body where it thinks too long"
    affects, remedy = {
        "honoured": ("", ""),
        "unknown": ("perhaps failed attempts", f"brain.max_tokens, or {shorter_thinking}"),
        "ignored": ("failed attempts", "a server that takes response_format json_schema"),
        "refused": ("every answer, with brain.structured=true", "brain.structured=false"),
        "unreachable": ("every answer", "start the server, or correct brain.base_url"),
    }[result.verdict]
    unusable = result.verdict == "unreachable" or (result.verdict == "refused" and spec.structured)
    state = "missing" if unusable else "note" if affects else "ok"
    return Check("brain", state, result.message, affects, remedy)


def examine(out: Path, overrides: list[str]) -> Iterator[Check]:
    """Yields every check as soon as it is done; that of the brain only with `overrides`."""
    yield python()
    yield packages()
    yield from imports()
    yield vulkan()
    yield disk(out)
    yield cache()
    yield configuration()
    if overrides:
        yield brain(overrides)


def main(arguments: list[str] | None = None) -> int:
    """Prints one line per check and returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m rf_exp.doctor", description=__doc__)
    out_help = "where results go (default: outputs)"
    parser.add_argument("--out", type=Path, default=Path("outputs"), help=out_help)
    overrides_help = (
        "which brain a run would have, as in brain=openai brain.base_url=...: its server is asked once"
    )
    parser.add_argument("overrides", nargs="*", metavar="key=value", help=overrides_help)
    args = parser.parse_args(arguments)
    missing = []
    for check in examine(args.out, args.overrides):
        print(shown(str(check)), flush=True)
        missing += [check.name] if check.state == "missing" else []
    if missing:
        print(shown(f"The main job cannot run here; fix first: {', '.join(missing)}."))
        return 1
    print("The main job can run: python -m rf_exp.run")
    return 0


if __name__ == "__main__":
    sys.exit(main())
