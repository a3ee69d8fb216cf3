"""What a release carries beside the code: trained policies, ready to act, in one file below 5 MB each.

    python scripts/release.py outputs/policies/lift_barrier/full/separate_local/fast-50-0 [--to build]

The file is the part of `outputs/` that evaluation needs: the policies of all agents, their matrices in
bfloat16, and the expert's rows, from which the step limit follows. With it policies act without learning:

    unzip lift_barrier-separate_local-fast-50-0.zip -d outputs/released
    python -m rf_exp.run out=outputs/released training.draft_steps=5000 stages=[evaluate,report]

That is for the demo's; others want the keys with which they were learned.
"""

import argparse
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rf_exp.command import guarded
from rf_exp.errors import ArgumentError
from rf_exp.policy import MODEL, write_small
from rf_exp.progress import console

LARGEST_MB = 5.0


def release(folder: Path, to: Path) -> Path:
    """Pack the policies in a folder of `outputs/policies/TASK/CONSTRAINTS/ARCH/`; returns the file.

    Raises ArgumentError for another folder, one without policies, and where more than LARGEST_MB comes out.
    """
    folder = folder.resolve()
    found = sorted(path.parent for path in folder.glob(f"*/{MODEL}"))
    if not found or folder.parents[3].name != "policies":
        raise ArgumentError(
            f"{folder} is not the folder of trained policies; "
            "expected one such as outputs/policies/TASK/CONSTRAINTS/ARCH/fast-50-0"
        )
    out, (task, constraints, arch) = folder.parents[4], folder.parts[-4:-1]
    with TemporaryDirectory(prefix="rf_exp-") as draft:
        for policy in found:
            write_small(policy, Path(draft) / policy.relative_to(out))
        rows = out / "results" / "generate" / task
        for path in (*rows.glob(f"{constraints}.*"), *rows.glob(f"{constraints}-disturbed*")):
            target = Path(draft) / path.relative_to(out)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        to.mkdir(parents=True, exist_ok=True)
        name = "-".join((task, *(() if constraints == "full" else (constraints,)), arch, folder.name))
        packed = Path(shutil.make_archive(str(to / name), "zip", draft))
    size_mb = packed.stat().st_size / 1e6
    if size_mb > LARGEST_MB:
        packed.unlink()
        raise ArgumentError(f"{folder} takes {size_mb:.1f} MB; a release carries at most {LARGEST_MB:g}")
    console.print(f"{packed}: {len(found)} policies, {size_mb:.1f} MB")
    return packed


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
