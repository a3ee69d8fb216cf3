"""Installations: they include the configuration and install nothing beside the package."""

import os
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BUILD = "import sys; from setuptools import build_meta; getattr(build_meta, sys.argv[1])(sys.argv[2])"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources, because a build leaves files beside them."""
    # Not imported: that fails once the standard library's distutils has been imported.
    versions = [each.version for each in metadata.distributions(name="setuptools")]
    if not versions or int(versions[0].split(".")[0]) < 77:
        pytest.skip("setuptools 77 builds a wheel; it is not installed")
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for name in ("rf_exp", "conf"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def build_site(checkout: Path, hook: str) -> Path:
    """The folder with an unpacked wheel, as pip would install it."""
    wheels, site = checkout / hook, checkout / f"{hook}-site"
    wheels.mkdir()
    result = subprocess.run(
        [sys.executable, "-c", BUILD, hook, str(wheels)], cwd=checkout, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    (wheel,) = wheels.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    return site


@pytest.fixture(scope="module")
def site(checkout: Path) -> Path:
    return build_site(checkout, "build_wheel")


def run(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command of an installation, started in another folder."""
    folder.mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, "-m", "rf_exp.run", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.slow
def test_an_installation_has_the_package_and_nothing_beside_it(site: Path) -> None:
    assert sorted(path.name for path in site.iterdir()) == ["rf_exp", "rf_exp-0.1.0.dist-info"]
    assert (site / "rf_exp-0.1.0.dist-info/top_level.txt").read_text() == "rf_exp\n"


@pytest.mark.slow
def test_an_installation_holds_every_file_of_the_configuration(site: Path) -> None:
    expected, installed = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (ROOT / "conf", site / "rf_exp/conf")
    )
    assert expected == installed and len(expected) > 50


@pytest.mark.slow
def test_an_installation_holds_all_stubs(site: Path) -> None:
    expected, installed = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.pyi")}
        for folder in (ROOT / "rf_exp", site / "rf_exp")
    )
    assert expected == installed and expected


@pytest.mark.slow
def test_an_installation_runs_in_an_empty_folder(site: Path, tmp_path: Path) -> None:
    """Files of another package beside it have no effect."""
    foreign = site / "conf/task"
    foreign.mkdir(parents=True)
    (foreign.parent / "config.yaml").write_text("somebody: else\n")
    (foreign / "juggle.yaml").write_text("somebody: else\n")
    help_result = run(site, tmp_path / "empty", "--help")
    assert help_result.returncode == 0, help_result.stderr
    assert "task: all, camera_alignment" in help_result.stdout and "juggle" not in help_result.stdout
    config_result = run(site, tmp_path / "empty", "-c", "job", "task=place_food")
    assert config_result.returncode == 0, config_result.stderr
    assert "place_food:" in config_result.stdout and "disturbance_rad: 0.05" in config_result.stdout
    assert not list((tmp_path / "empty").iterdir())
    error_result = run(site, tmp_path / "empty", "demoz=3")
    assert error_result.returncode == 2
    assert f"did you mean demos? The keys are in {site}/rf_exp/conf/config.yaml and" in error_result.stderr
    shutil.rmtree(site / "conf")


@pytest.mark.slow
def test_an_installation_generates_demonstrations(site: Path, tmp_path: Path) -> None:
    """Without a commit, their rows name the version."""
    small = ("stages=[generate]", "episodes=1", "render=false", "recordings=0", "workers=1", "wandb=disabled")
    result = run(site, tmp_path, *small, "out=made")
    assert result.returncode == 0, result.stderr
    (rows,) = (tmp_path / "made/results/generate").rglob("*.jsonl")
    assert f'"commit": "rf_exp-{metadata.version("rf_exp")}"' in rows.read_text()


@pytest.mark.slow
def test_an_editable_installation_reads_the_configuration_of_the_checkout(
    checkout: Path, tmp_path: Path
) -> None:
    site = build_site(checkout, "build_editable")
    assert not (site / "conf").exists() and not (site / "rf_exp").exists()
    script = "import site, sys; site.addsitedir(sys.argv[1]); from rf_exp.installed import CONF; print(CONF)"
    result = subprocess.run(
        [sys.executable, "-S", "-c", script, str(site)], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.stdout == f"{checkout / 'conf'}\n", result.stderr
