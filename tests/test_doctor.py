"""The doctor on this machine, and on machines with real faults."""

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from rf_exp import command, doctor
from rf_exp.robots import DEFAULT, cache_folder
from tests.children import read_only

ROOT = Path(__file__).parents[1]


def install(folder: Path, name: str, version: str, *requires: str) -> None:
    """Writes the metadata of an installed distribution to a folder."""
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    lines = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}"]
    (info / "METADATA").write_text("\n".join([*lines, *(f"Requires-Dist: {text}" for text in requires), ""]))


def test_a_line_holds_state_name_effect_and_remedy() -> None:
    check = doctor.Check("disk", "missing", "1 GB free", "all results", "out=FOLDER")
    assert str(check) == "missing disk      1 GB free; affects: all results; fix: out=FOLDER"
    assert str(doctor.Check("gpu", "ok", "two")) == "ok      gpu       two"


def test_this_python_is_supported() -> None:
    assert doctor.python().state == "ok"
    assert sys.executable in doctor.python().detail


def test_an_unsupported_python_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PYTHONS", ((3, 99),))
    check = doctor.python()
    assert check.state == "missing"
    assert "3.11 or 3.12 is needed" in check.detail
    assert check.remedy == "install Python 3.11, then PYTHON=python3.11 scripts/setup.sh"


def test_all_packages_of_this_environment_are_installed() -> None:
    check = doctor.packages()
    assert check.state == "ok", check


def test_a_distribution_that_is_not_installed() -> None:
    check = doctor.packages("rf_exp_nowhere")
    assert (check.state, check.detail) == ("missing", "rf_exp_nowhere is not installed")
    assert check.remedy == "scripts/setup.sh"


def test_every_unmet_requirement_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "present", "2.13.0+cpu")
    requirements = ["present==2.13.0", "present>=2.11,<2.14", "present[all]", "present>=2.14", "present<2.13"]
    requirements += ["absent>=1", 'extra_only>=1; extra == "dev"', "present==2.12", "absent2", "absent3"]
    install(tmp_path, "broken", "1.0", *requirements)
    monkeypatch.syspath_prepend(str(tmp_path))
    check = doctor.packages("broken")
    assert check.state == "missing"
    assert check.detail == (
        "present is 2.13.0+cpu, needed is >=2.14, present is 2.13.0+cpu, needed is <2.13, "
        "absent is not installed, present is 2.13.0+cpu, needed is ==2.12 and 2 more"
    )


def test_two_builds_of_opencv_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "opencv_python", "5.0.0")
    install(tmp_path, "uses_it", "1.0")
    monkeypatch.syspath_prepend(str(tmp_path))
    check = doctor.packages("uses_it")
    assert check.state == "note"
    assert check.detail == "opencv-python 5.0.0 is installed over the headless build"
    assert check.remedy == "scripts/setup.sh"


def test_a_missing_module_is_named() -> None:
    imported, _ = doctor.imports(("json", "no_such_module"))
    assert imported.state == "missing"
    assert imported.detail == "no_such_module: ModuleNotFoundError: No module named 'no_such_module'"


def test_a_module_that_ends_the_process_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "dies.py").write_text("import os\nos.kill(os.getpid(), 9)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    imported, _ = doctor.imports(("json", "dies", "csv"))
    assert imported.detail == "dies: the process ended with -9"


@pytest.mark.slow
def test_a_module_that_hangs_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hangs.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(doctor, "IMPORT_TIMEOUT_S", 1.0)
    imported, _ = doctor.imports(("json", "hangs"))
    assert imported.detail == "hangs: no answer in 1 s"


def test_cv2_imports_on_a_machine_without_a_screen() -> None:
    imported, gpu = doctor.imports(("cv2",))
    assert (imported.state, imported.detail) == ("ok", "cv2")
    assert gpu.state == "note"  # torch was not imported


@pytest.mark.slow
def test_no_gpu_is_a_note_and_says_what_it_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    imported, gpu = doctor.imports(("torch",))
    assert (imported.state, gpu.state) == ("ok", "note")
    assert gpu.affects == "nothing for profile=quick; training with profile=paper is slow"


def test_no_vulkan_device_costs_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent.json")
    check = doctor.vulkan()
    assert check.state == "missing"
    assert check.detail == "there is no such file (driver: VK_DRIVER_FILES=/nonexistent.json, set by you)"
    assert check.affects == "no pictures; render=false still makes states and actions"
    assert check.remedy == "unset VK_DRIVER_FILES, then python -m rf_exp.doctor"


def test_results_need_a_folder_that_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    check = doctor.disk(tmp_path / "file" / "outputs")
    assert (check.state, check.detail) == ("missing", f"{tmp_path / 'file'} cannot be written to")
    assert check.remedy == "choose another: out=FOLDER"


def test_results_need_disk_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PAPER_GB", 0.0)
    monkeypatch.setattr(doctor, "QUICK_GB", 0.0)
    assert doctor.disk(tmp_path / "not" / "yet").state == "ok"
    monkeypatch.setattr(doctor, "PAPER_GB", 1e9)
    assert doctor.disk(tmp_path).state == "note"
    monkeypatch.setattr(doctor, "QUICK_GB", 1e9)
    check = doctor.disk(tmp_path)
    assert check.state == "missing"
    assert check.detail.endswith(f"free for {tmp_path}, 1e+09 GB are needed")


def test_the_mesh_cache_exists_or_can_be_created(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    existing = cache_folder(DEFAULT)
    assert (doctor.cache().state, doctor.cache().detail) == ("ok", f"meshes are in {existing}")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    planned = tmp_path / "new" / "rf_exp" / existing.name
    assert (doctor.cache().state, doctor.cache().detail) == ("ok", f"meshes will be made in {planned}")
    assert not list(tmp_path.iterdir())


def test_an_unwritable_mesh_cache_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = cache_folder(DEFAULT).name
    (tmp_path / "file").touch()
    with read_only(tmp_path / "locked") as locked:
        for home in (tmp_path / "file", locked):
            monkeypatch.setenv("XDG_CACHE_HOME", str(home))
            check = doctor.cache()
            folder = home / "rf_exp" / name
            message = f"{home} cannot be written to, and the meshes are not in {folder}"
            assert (check.state, check.detail) == ("missing", message)
            assert check.remedy == "set XDG_CACHE_HOME to a writable folder"


def test_a_user_without_a_home_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)  # a user that the machine does not know
    check = doctor.cache()
    assert check.state == "missing" and check.detail.startswith("there is no place for the mesh cache: ")
    assert check.remedy == "set XDG_CACHE_HOME to a writable folder"


def test_the_default_configuration_is_found() -> None:
    check = doctor.configuration()
    assert (check.state, check.detail) == ("ok", "the default is lift_barrier"), check


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("config.yaml", "Cannot find primary config 'config'"),
        ("task/lift_barrier.yaml", "Could not find 'task/lift_barrier'"),
        ("profile", "Could not find 'profile/quick'"),
        (".", "Primary config directory not found"),
        ("foreign", "no task chosen"),  # config.yaml exists, but of another package
    ],
)
def test_missing_parts_of_the_configuration_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str, message: str
) -> None:
    conf = tmp_path / "conf"
    shutil.copytree(command.CONF, conf)
    if missing == "foreign":
        (conf / "config.yaml").write_text("defaults: [_self_]\nwanted: by another package\n")
    elif (conf / missing).is_dir():
        shutil.rmtree(conf / missing)
    else:
        (conf / missing).unlink()
    monkeypatch.setattr(command, "CONF", conf)
    check = doctor.configuration()
    assert check.state == "missing" and message in check.detail, check
    assert check.affects == "every command" and "install rf_exp again" in check.remedy
    assert doctor.brain(["brain=openai"]).state == "missing"
    monkeypatch.undo()
    assert doctor.configuration().state == "ok"


def test_an_empty_environment_cannot_run_the_main_job(tmp_path: Path) -> None:
    venv.create(tmp_path / "bare", with_pip=False)
    (tmp_path / "rf_exp").symlink_to(ROOT / "rf_exp")
    command = [str(tmp_path / "bare/bin/python"), "-m", "rf_exp.doctor", "--out", str(tmp_path)]
    result = subprocess.run(command, cwd=tmp_path, env={"PATH": ""}, capture_output=True, text=True)
    lines = result.stdout.splitlines()
    assert result.returncode == 1, result.stderr
    assert [line.split()[1] for line in lines[:-1]] == [
        "python",
        "packages",
        "imports",
        "gpu",
        "vulkan",
        "disk",
        "cache",
        "config",
    ]
    assert lines[1].startswith("missing packages  rf_exp is not installed")
    assert lines[2].startswith("missing imports   pinocchio: ModuleNotFoundError")
    assert lines[4].startswith("missing vulkan    not tried: No module named")
    assert lines[6].startswith("missing cache     not tried: No module named")
    assert lines[7].startswith("missing config    not tried: No module named")
    assert lines[-1] == "The main job cannot run here; fix first: packages, imports, vulkan, cache, config."


@pytest.mark.render
def test_this_machine_can_run_the_main_job(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rf_exp.doctor", "--out", str(tmp_path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.splitlines()[-1] == "The main job can run: python -m rf_exp.run"
