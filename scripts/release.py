"""Packs trained policies for a release, for evaluation without training, in one file below 5 MB each.

    python scripts/release.py outputs/policies/lift_barrier/full/separate_local/fast-50-0 [--to build]

The file is the part of `outputs/` that evaluation needs: the policies of all agents, with matrices in
bfloat16, and the expert's rows, from which the step limit follows. It also holds an experiment with the keys
of training, so that the policies are evaluated with

    python -m rf_exp.run --config-dir lift_barrier-separate_local-fast-50-0.zip experiment=released scenes=100
"""

import argparse
import re
import shutil
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

from omegaconf import OmegaConf

from rf_exp.artifacts import atomic_path, plain
from rf_exp.command import run_guarded
from rf_exp.errors import ArgumentError
from rf_exp.policy import MODEL, PolicyConfig, provenance, write_small
from rf_exp.progress import console
from rf_exp.release import EXPERIMENT, GROUPS, read_release

MAX_MB = 5.0
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # of all files, so that the bytes of the zip depend on their content only
HEADER = (
    "# @package _global_\n# The policies in this folder act in scenes that they have never seen:\n"
    "#   python -m rf_exp.run --config-dir FOLDER experiment=released out=FOLDER\n"
)
FOLDER_NAME = re.compile(r"([^+]+)-(\d+)-(\d+)")  # recipe, demonstrations, seed; no policies after correction


def release(folder: Path, output_folder: Path) -> Path:
    """Packs the policies of a folder of `outputs/policies/TASK/CONSTRAINTS/ARCH/`; returns the file.

    Raises ArgumentError for another folder, one without policies, and a file larger than MAX_MB.
    """
    folder = folder.resolve()
    policies = sorted(path.parent for path in folder.glob(f"*/{MODEL}"))
    match = FOLDER_NAME.fullmatch(folder.name)
    if not policies or not match or folder.parents[3].name != "policies":
        raise ArgumentError(
            f"{folder} is not the folder of trained policies; "
            "expected one such as outputs/policies/TASK/CONSTRAINTS/ARCH/fast-50-0"
        )
    out, parts = folder.parents[4], folder.parts[-4:-1]
    task, constraints, arch = parts
    name = "-".join((task, *(() if constraints == "full" else (constraints,)), arch, folder.name))
    archive = output_folder / f"{name}.zip"
    with atomic_path(archive) as draft:
        content = draft.with_name("content")
        for policy in policies:
            write_small(policy, content / policy.relative_to(out))
        rows = out / "results" / "generate" / task
        for path in (*rows.glob(f"{constraints}.*"), *rows.glob(f"{constraints}-disturbed*")):
            target = content / path.relative_to(out)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        experiment_file = content / EXPERIMENT
        experiment_file.parent.mkdir()
        experiment_file.write_text(
            experiment(policies[0], dict(zip(GROUPS, parts, strict=True)), *match.groups()), "utf-8"
        )
        read_release(content)
        pack(content, draft)
        size_mb = draft.stat().st_size / 1e6
        if size_mb > MAX_MB:
            raise ArgumentError(f"{folder} takes {size_mb:.1f} MB; a release carries at most {MAX_MB:g}")
    console.print(f"{archive}: {len(policies)} policies, {size_mb:.1f} MB")
    return archive


def pack(folder: Path, target: Path) -> None:
    """Writes the files of a folder to a zip whose bytes do not depend on when they were written."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(each for each in folder.rglob("*") if each.is_file()):
            entry = zipfile.ZipInfo(str(path.relative_to(folder)), ZIP_DATE)
            entry.external_attr = 0o644 << 16
            file.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)


def experiment(folder: Path, groups: Mapping[str, str], recipe: str, demos: str, seed: str) -> str:
    """YAML text of an experiment that evaluates policies trained as the one in this folder."""
    training_provenance = provenance(folder)
    policy = PolicyConfig.read(training_provenance["policy"], training_provenance["acting"]).complete
    training = {key: value for key, value in training_provenance["train"].items() if key != "seed"}
    config = {
        "defaults": [{f"override /{group}": value} for group, value in groups.items()],
        "stages": ["evaluate", "report"],
        "recipe": recipe,
        "demos": int(demos),
        "train_seed": int(seed),
        **{
            key: training_provenance["data"]["identity"].get(key, 0.0)
            for key in ("disturbance_rad", "delay_s")
        },
        "picture": {side: policy.pop(side) for side in ("width", "height")},
        "policy": policy,
        "training": training,
    }
    return HEADER + OmegaConf.to_yaml(plain(config))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of policies: outputs/policies/TASK/CONSTRAINTS/ARCH/NAME")
    parser.add_argument("--to", type=Path, default=Path("build"), help="folder of the file")
    arguments = parser.parse_args()
    release(arguments.folder, arguments.to)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
