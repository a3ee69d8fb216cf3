"""Choice of the Vulkan driver, on file trees of typical machines, and a rendered picture."""

import json
import os
import platform
from pathlib import Path

import pytest

from rf_exp.errors import StageError
from rf_exp.sim import vulkan

LAVAPIPE = "usr/share/vulkan/icd.d/lvp_icd.json"
NVIDIA = "usr/lib/x86_64-linux-gnu/libGLX_nvidia.so.570.86"
NOWHERE = "/nonexistent/driver.json"


def machine(root: Path, *files: str) -> Path:
    """A root folder with these empty files."""
    for name in files:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


@pytest.mark.parametrize("variable", vulkan.VARIABLES)
def test_the_users_variable_wins_over_everything(tmp_path: Path, variable: str) -> None:
    root = machine(tmp_path, LAVAPIPE, "dev/nvidiactl", NVIDIA)
    driver = vulkan.find_driver({variable: NOWHERE}, root)
    assert driver.description == f"{variable}={NOWHERE}, set by you"
    assert driver.variable == variable and driver.manifest is None


def test_a_machine_without_gpu_takes_the_software_driver(tmp_path: Path) -> None:
    root = machine(tmp_path, LAVAPIPE, "usr/share/vulkan/icd.d/radeon_icd.json")
    driver = vulkan.find_driver({}, root)
    assert driver.manifest == root / LAVAPIPE
    assert driver.description == f"software, {root / LAVAPIPE}"


def test_the_name_of_the_manifest_may_contain_the_architecture(tmp_path: Path) -> None:
    expected = f"usr/share/vulkan/icd.d/lvp_icd.{platform.machine()}.json"
    root = machine(tmp_path, "usr/share/vulkan/icd.d/lvp_icd.i686.json", expected)
    assert vulkan.software_manifest(root) == root / expected


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ((LAVAPIPE, "dev/nvidiactl", NVIDIA), "the driver of the NVIDIA GPU"),
        ((LAVAPIPE, "dev/nvidiactl", "usr/lib64/libGLX_nvidia.so.0"), "the driver of the NVIDIA GPU"),
        ((LAVAPIPE, "dev/dri/renderD128"), "the driver of the GPU at {root}/dev/dri/renderD128"),
    ],
)
def test_a_gpu_with_its_driver_is_left_to_the_loader(
    tmp_path: Path, files: tuple[str, ...], words: str
) -> None:
    driver = vulkan.find_driver({}, machine(tmp_path, *files))
    assert driver.manifest is None and driver.variable is None
    assert driver.description == words.format(root=tmp_path)


def test_an_nvidia_gpu_that_only_computes_takes_the_software_driver(tmp_path: Path) -> None:
    root = machine(tmp_path, LAVAPIPE, "dev/nvidiactl", "dev/dri/renderD128")
    assert vulkan.find_driver({}, root).manifest == root / LAVAPIPE


def test_a_bare_machine_has_no_driver(tmp_path: Path) -> None:
    driver = vulkan.find_driver({}, tmp_path)
    assert driver.description == "none found: no GPU with a Vulkan driver, no Mesa software driver"
    assert driver.manifest is None


def test_selecting_sets_the_variable_of_the_loader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VK_DRIVER_FILES", "")
    monkeypatch.delenv("VK_ICD_FILENAMES", raising=False)
    expected = vulkan.find_driver({})
    assert vulkan.select_driver() == expected.description
    assert vulkan.os.environ["VK_DRIVER_FILES"] == str(expected.manifest or "")


def test_selecting_twice_gives_the_same_driver(tmp_path: Path) -> None:
    root = machine(tmp_path, LAVAPIPE)
    first = vulkan.find_driver({}, root)
    assert vulkan.find_driver({"VK_DRIVER_FILES": str(first.manifest)}, root) == first


def test_the_software_driver_may_be_chosen_despite_a_gpu(tmp_path: Path) -> None:
    root = machine(tmp_path, LAVAPIPE, "dev/nvidiactl", NVIDIA)
    driver = vulkan.find_driver({"VK_DRIVER_FILES": str(root / LAVAPIPE)}, root)
    assert driver.description == f"software, {root / LAVAPIPE}"


def test_selecting_leaves_the_users_choice_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VK_DRIVER_FILES", NOWHERE)
    assert vulkan.select_driver() == f"VK_DRIVER_FILES={NOWHERE}, set by you"
    assert vulkan.os.environ["VK_DRIVER_FILES"] == NOWHERE


def test_the_probe_gives_the_reason_for_a_missing_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VK_DRIVER_FILES", NOWHERE)
    probe = vulkan.render_probe()
    assert not probe.ok
    assert probe.reason == "there is no such file"
    assert probe.remedy == "unset VK_DRIVER_FILES, then python -m rf_exp.doctor"


def test_a_driver_that_cannot_be_loaded_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SAPIEN raises an error or crashes, depending on the environment."""
    manifest = {
        "file_format_version": "1.0.0",
        "ICD": {"library_path": "/nowhere.so", "api_version": "1.3.0"},
    }
    (tmp_path / "bad.json").write_text(json.dumps(manifest))
    monkeypatch.setenv("VK_DRIVER_FILES", f"{NOWHERE}{os.pathsep}{tmp_path / 'bad.json'}")
    reason = vulkan.render_probe().reason
    assert reason.startswith(
        ("RuntimeError: failed to find a rendering device", "the driver ended the process")
    )


def test_rendering_without_a_device_is_refused_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("VK_DRIVER_FILES", NOWHERE)
    with pytest.raises(StageError) as error:
        vulkan.require_rendering()
    assert str(error.value) == (
        "rendering was requested, but SAPIEN has no Vulkan device: "
        "there is no such file "
        f"(driver: VK_DRIVER_FILES={NOWHERE}, set by you). "
        "Fix: unset VK_DRIVER_FILES, then python -m rf_exp.doctor; or go without pictures: render=false"
    )


def test_a_driver_that_ends_the_process_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sapien.py").write_text("import os\nos.abort()\n")  # imported instead by the child process
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    probe = vulkan.render_probe()
    assert probe.reason == "the driver ended the process with SIGABRT"


def test_a_driver_that_ended_the_process_once_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sapien.py").write_text(
        "import os, pathlib\n"
        "asked = pathlib.Path(__file__).with_name('asked')\n"
        "if not asked.exists():\n"
        "    asked.touch()\n"
        "    os.abort()\n"
        "raise RuntimeError('no device at all')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert vulkan.render_probe().reason == "RuntimeError: no device at all"


@pytest.mark.slow
def test_a_driver_that_hangs_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sapien.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert vulkan.render_probe(timeout_s=0.5).reason == "no answer from the driver in 0.5 s"


@pytest.mark.parametrize(
    ("driver", "remedy"),
    [
        (
            vulkan.Driver("", variable="VK_ICD_FILENAMES"),
            "unset VK_ICD_FILENAMES, then python -m rf_exp.doctor",
        ),
        (vulkan.Driver("", manifest=Path(LAVAPIPE)), "scripts/setup.sh (installs Mesa's software Vulkan)"),
    ],
)
def test_the_remedy_is_a_command(driver: vulkan.Driver, remedy: str) -> None:
    assert vulkan.Probe(driver, "", 0.0, "no device").remedy == remedy


@pytest.mark.render
def test_a_picture_is_rendered() -> None:
    probe = vulkan.render_probe()
    assert probe.ok, probe.reason
    assert probe.device
    vulkan.require_rendering()
