"""What a release carries beside the code: trained policies, ready to act, in one file below 5 MB each.

    python scripts/release.py outputs/policies/lift_barrier/full/separate_local/fast-50-0 [--to build]

The file is the part of `outputs/` that evaluation needs: the policies of all agents, their matrices in
bfloat16, and the expert's rows, from which the step limit follows. An experiment in it says how they have
learned, so that they act with

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

from rf_exp.artifacts import plain, whole
from rf_exp.command import guarded
from rf_exp.errors import ArgumentError
from rf_exp.policy import MODEL, PolicyConfig, provenance, write_small
from rf_exp.progress import console
from rf_exp.release import EXPERIMENT, GROUPS, read_release

LARGEST_MB = 5.0
WRITTEN = (1980, 1, 1, 0, 0, 0)  # as all files in a zip say, whose bytes then are those of their content
HEAD = (
    "# @package _global_\n# The policies in this folder act in scenes that they have never seen:\n"
    "#   python -m rf_exp.run --config-dir FOLDER experiment=released out=FOLDER\n"
)
NAME = re.compile(r"([^+]+)-(\d+)-(\d+)")  # recipe, demonstrations, seed; of what was never corrected


def release(folder: Path, to: Path) -> Path:
    """Pack the policies in a folder of `outputs/policies/TASK/CONSTRAINTS/ARCH/`; returns the file.

    Raises ArgumentError for another folder, one without policies, and where more than LARGEST_MB comes out.
    """
    folder = folder.resolve()
    found = sorted(path.parent for path in folder.glob(f"*/{MODEL}"))
    named = NAME.fullmatch(folder.name)
    if not found or not named or folder.parents[3].name != "policies":
        raise ArgumentError(
            f"{folder} is not the folder of trained policies; "
            "expected one such as outputs/policies/TASK/CONSTRAINTS/ARCH/fast-50-0"
        )
    out, chosen = folder.parents[4], folder.parts[-4:-1]
    task, constraints, arch = chosen
    name = "-".join((task, *(() if constraints == "full" else (constraints,)), arch, folder.name))
    packed = to / f"{name}.zip"
    with whole(packed) as draft:
        content = draft.with_name("content")
        for policy in found:
            write_small(policy, content / policy.relative_to(out))
        rows = out / "results" / "generate" / task
        for path in (*rows.glob(f"{constraints}.*"), *rows.glob(f"{constraints}-disturbed*")):
            target = content / path.relative_to(out)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        says = content / EXPERIMENT
        says.parent.mkdir()
        says.write_text(
            experiment(found[0], dict(zip(GROUPS, chosen, strict=True)), *named.groups()), "utf-8"
        )
        read_release(content)
        pack(content, draft)
        size_mb = draft.stat().st_size / 1e6
        if size_mb > LARGEST_MB:
            raise ArgumentError(f"{folder} takes {size_mb:.1f} MB; a release carries at most {LARGEST_MB:g}")
    console.print(f"{packed}: {len(found)} policies, {size_mb:.1f} MB")
    return packed


def pack(folder: Path, to: Path) -> None:
    """The files in a folder as a zip: the same files, the same bytes, whenever they were written."""
    with zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(each for each in folder.rglob("*") if each.is_file()):
            entry = zipfile.ZipInfo(str(path.relative_to(folder)), WRITTEN)
            entry.external_attr = 0o644 << 16
            file.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)


def experiment(folder: Path, chosen: Mapping[str, str], recipe: str, demos: str, seed: str) -> str:
    """An experiment in which policies act that were learned as the one in this folder."""
    made = provenance(folder)
    policy = PolicyConfig.read(made["policy"], made["acting"]).whole
    training = {key: value for key, value in made["train"].items() if key != "seed"}
    said = {
        "defaults": [{f"override /{group}": value} for group, value in chosen.items()],
        "stages": ["evaluate", "report"],
        "recipe": recipe,
        "demos": int(demos),
        "train_seed": int(seed),
        **{key: made["data"]["identity"].get(key, 0.0) for key in ("disturbance_rad", "delay_s")},
        "picture": {side: policy.pop(side) for side in ("width", "height")},
        "policy": policy,
        "training": training,
    }
    return HEAD + OmegaConf.to_yaml(plain(said))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of policies: outputs/policies/TASK/CONSTRAINTS/ARCH/NAME")
    parser.add_argument("--to", type=Path, default=Path("build"), help="folder of the file")
    arguments = parser.parse_args()
    release(arguments.folder, arguments.to)


if __name__ == "__main__":
    sys.exit(guarded(main))
