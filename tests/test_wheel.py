"""What is installed: the configuration comes along, and there is nothing beside the package."""

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
    """A copy of what is built, as a build leaves files beside it."""
    # Not imported: that fails where something has imported the standard library's distutils before.
    there = [each.version for each in metadata.distributions(name="setuptools")]
    if not there or int(there[0].split(".")[0]) < 77:
        pytest.skip("setuptools 77 builds a wheel; it is not installed")
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for name in ("rf_exp", "conf"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def built(checkout: Path, how: str) -> Path:
    """The folder in which pip would have put a wheel."""
    made, site = checkout / how, checkout / f"{how}-site"
    made.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", BUILD, how, str(made)], cwd=checkout, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (wheel,) = made.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    return site


@pytest.fixture(scope="module")
def site(checkout: Path) -> Path:
    return built(checkout, "build_wheel")


def run(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command of an installation, in another folder."""
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
    ours, theirs = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (ROOT / "conf", site / "rf_exp/conf")
    )
    assert ours == theirs and len(ours) > 50


@pytest.mark.slow
def test_an_installation_holds_the_stubs_that_list_what_rooms_give(site: Path) -> None:
    ours, theirs = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.pyi")}
        for folder in (ROOT / "rf_exp", site / "rf_exp")
    )
    assert ours == theirs and ours


@pytest.mark.slow
def test_an_installation_is_run_from_an_empty_folder(site: Path, tmp_path: Path) -> None:
    """Whatever another package has put beside it."""
    foreign = site / "conf/task"
    foreign.mkdir(parents=True)
    (foreign.parent / "config.yaml").write_text("somebody: else\n")
    (foreign / "juggle.yaml").write_text("somebody: else\n")
    helped = run(site, tmp_path / "empty", "--help")
    assert helped.returncode == 0, helped.stderr
    assert "task: all, camera_alignment" in helped.stdout and "juggle" not in helped.stdout
    shown = run(site, tmp_path / "empty", "-c", "job", "task=place_food")
    assert shown.returncode == 0, shown.stderr
    assert "place_food:" in shown.stdout and "disturbance_rad: 0.05" in shown.stdout
    assert not list((tmp_path / "empty").iterdir())
    wrong = run(site, tmp_path / "empty", "demoz=3")
    assert wrong.returncode == 2
    assert f"did you mean demos? The keys are in {site}/rf_exp/conf/config.yaml and" in wrong.stderr
    shutil.rmtree(site / "conf")


@pytest.mark.slow
def test_an_installation_makes_demonstrations(site: Path, tmp_path: Path) -> None:
    """Though it has no commit to name in their rows."""
    small = ("stages=[generate]", "episodes=1", "render=false", "recordings=0", "workers=1", "wandb=disabled")
    made = run(site, tmp_path, *small, "out=made")
    assert made.returncode == 0, made.stderr
    (rows,) = (tmp_path / "made/results/generate").rglob("*.jsonl")
    assert f'"commit": "rf_exp-{metadata.version("rf_exp")}"' in rows.read_text()


@pytest.mark.slow
def test_an_installation_to_be_edited_reads_the_configuration_of_the_checkout(
    checkout: Path, tmp_path: Path
) -> None:
    site = built(checkout, "build_editable")
    assert not (site / "conf").exists() and not (site / "rf_exp").exists()
    asks = "import site, sys; site.addsitedir(sys.argv[1]); from rf_exp.installed import CONF; print(CONF)"
    found = subprocess.run(
        [sys.executable, "-S", "-c", asks, str(site)], cwd=tmp_path, capture_output=True, text=True
    )
    assert found.stdout == f"{checkout / 'conf'}\n", found.stderr
