"""Vulkan: choice of the driver, and a probe whether it renders a picture.

SAPIEN takes whatever the Vulkan loader offers. Without a GPU that is a list of drivers for absent
hardware, so the software driver (Mesa's lavapipe) is selected before SAPIEN is imported; with a GPU
the loader is left alone. This file also runs by itself, before rf_exp is installed:
`python rf_exp/sim/vulkan.py` prints in a line whether a picture was rendered, and exits 0 if it was.
"""

import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

VARIABLES = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")  # the first takes precedence in the loader
MANIFESTS = ("etc/vulkan/icd.d", "usr/local/share/vulkan/icd.d", "usr/share/vulkan/icd.d")
NVIDIA_DRIVERS = (
    "usr/lib*/libGLX_nvidia.so.*",
    "usr/lib*/*/libGLX_nvidia.so.*",
    "usr/local/nvidia/lib*/*GLX*",
)
SETUP_SCRIPT = Path(__file__).parents[2] / "scripts" / "setup.sh"  # in a checkout only
WITHOUT_RENDERING = "no pictures; render=false still makes states and actions"


@dataclass(frozen=True)
class Driver:
    """The Vulkan driver to use, and the reason."""

    description: str
    manifest: Path | None = None  # of the software driver, where the loader needs it
    variable: str | None = None  # environment variable by which the user has chosen the driver


@dataclass(frozen=True)
class Probe:
    """Result of rendering one picture. `reason` is empty for success."""

    driver: Driver
    device: str
    seconds: float
    reason: str

    @property
    def ok(self) -> bool:
        return not self.reason

    def __str__(self) -> str:
        if self.ok:
            return f"rendered a picture on {self.device} in {self.seconds:.1f} s ({self.driver.description})"
        return f"{self.reason} (driver: {self.driver.description})"

    @property
    def remedy(self) -> str:
        """A command that may solve the problem."""
        if self.driver.variable:
            return f"unset {self.driver.variable}, then python -m rf_exp.doctor"
        software = software_manifest()
        if software and not self.driver.manifest:
            return f"export VK_DRIVER_FILES={software}"
        if SETUP_SCRIPT.is_file():
            return "scripts/setup.sh (installs Mesa's software Vulkan)"
        of_debian_12 = "24.3 or later, which Debian 12 has in bookworm-backports"
        return f"apt-get install mesa-vulkan-drivers libvulkan1 ({of_debian_12})"


def software_manifest(root: Path = Path("/")) -> Path | None:
    """The loader's manifest of Mesa's software driver, or None where it is not installed."""
    for folder in MANIFESTS:
        for name in ("lvp_icd.json", f"lvp_icd.{platform.machine()}.json"):
            if (root / folder / name).is_file():
                return root / folder / name
    return None


def find_driver(environment: Mapping[str, str], root: Path = Path("/")) -> Driver:
    """Decide which driver to use, from `environment` and the files under `root`; changes nothing.

    A variable set by the user wins, then a GPU that has a Vulkan driver, then the software driver.
    """
    manifest = software_manifest(root)
    software = Driver(f"software, {manifest}", manifest=manifest)
    for variable in VARIABLES:
        if value := environment.get(variable):
            if value == str(manifest):  # as after `select_driver`
                return software
            return Driver(f"{variable}={value}, set by you", variable=variable)
    # An NVIDIA GPU in a container often lacks the rendering part of its driver.
    nvidia = (root / "dev/nvidiactl").exists() and any(any(root.glob(pattern)) for pattern in NVIDIA_DRIVERS)
    render_nodes = [node for node in root.glob("dev/dri/renderD*") if os.access(node, os.R_OK | os.W_OK)]
    if nvidia:
        return Driver("the driver of the NVIDIA GPU")
    if render_nodes and not (root / "dev/nvidiactl").exists():
        return Driver(f"the driver of the GPU at {render_nodes[0]}")
    if manifest:
        return software
    return Driver("none found: no GPU with a Vulkan driver, no Mesa software driver")


def select_driver() -> str:
    """Set the Vulkan driver for the loader, before SAPIEN is imported; returns the choice in words."""
    driver = find_driver(os.environ)
    if driver.manifest:
        os.environ["VK_DRIVER_FILES"] = str(driver.manifest)
    return driver.description


def render_probe(picture: bool = True, timeout_s: float = 120.0) -> Probe:
    """Request a device from SAPIEN and, with `picture`, render 32 x 32 pixels on it.

    Runs in a process of its own, because a bad driver can crash it; a crash is retried once, because
    SAPIEN rarely crashes where it finds no device. About half a second for the device; the first
    picture of the software driver takes 1 to 4 s.
    """
    # -P: this folder must not shadow the standard library in the child.
    command = [sys.executable, "-P", __file__, "draw" if picture else "device"]
    driver = find_driver(os.environ)
    if driver.variable and not any(map(os.path.exists, os.environ[driver.variable].split(os.pathsep))):
        # SAPIEN would fail or crash on it without giving the reason.
        return Probe(driver, "", 0.0, "there is no such file")
    begin = time.perf_counter()
    run_child = partial(subprocess.run, command, capture_output=True, text=True, timeout=timeout_s)
    try:
        child = run_child()
        if child.returncode < 0:
            child = run_child()
    except subprocess.TimeoutExpired:
        return Probe(driver, "", timeout_s, f"no answer from the driver in {timeout_s:g} s")
    seconds = time.perf_counter() - begin
    outcome, _, detail = (child.stdout.strip().splitlines() or [""])[-1].partition(" ")
    if outcome == "drew":
        return Probe(driver, detail, seconds, "")
    if outcome == "failed":
        return Probe(driver, "", seconds, detail)
    if child.returncode < 0:
        name = signal.Signals(-child.returncode).name
        return Probe(driver, "", seconds, f"the driver ended the process with {name}")
    return Probe(driver, "", seconds, (child.stderr.strip().splitlines() or ["no answer"])[-1])


def require_rendering() -> None:
    """Fail before any work is lost: raises StageError where SAPIEN finds no device to render with."""
    from rf_exp.errors import StageError  # not above: this file also runs before rf_exp is installed

    probe = render_probe(picture=False)
    if not probe.ok:
        raise StageError(
            f"rendering was requested, but SAPIEN has no Vulkan device: {probe}. "
            f"Fix: {probe.remedy}; or go without pictures: render=false"
        )


def _draw(picture: bool) -> str:
    """Render a lit box on an empty background if `picture`; returns the name of the device."""
    import sapien

    scene = sapien.Scene()
    device = scene.render_system.device.name
    if picture:
        builder = scene.create_actor_builder()
        builder.add_box_visual(half_size=(0.5, 0.5, 0.5))
        builder.build_static(name="box")
        scene.set_ambient_light([1.0, 1.0, 1.0])
        camera = scene.add_camera("probe", 32, 32, fovy=1.0, near=0.1, far=10.0)
        camera.set_local_pose(sapien.Pose([-2.0, 0.0, 0.0]))
        scene.update_render()
        camera.take_picture()
        pixels = camera.get_picture("Color")  # (32, 32, 4), alpha 0 for background
        if not pixels[16, 16, :3].mean() > 0.1 or pixels[0, 0, 3] != 0.0:
            raise RuntimeError(f"the picture of {device} does not show the box in front of the camera")
    return device


def _probe_in_child(picture: bool) -> int:
    """Runs in the child process: tries to render, prints the result for the probe, returns the exit code."""
    select_driver()
    try:
        answer = f"drew {_draw(picture)}"
    except Exception as error:
        answer = f"failed {type(error).__name__}: {error}"
    print(answer, flush=True)
    return 0 if answer.startswith("drew") else 1


if __name__ == "__main__":
    if sys.argv[1:]:
        os._exit(_probe_in_child(sys.argv[1] == "draw"))  # without a device SAPIEN may crash at exit
    probe = render_probe()
    print(probe)
    sys.exit(0 if probe.ok else 1)
