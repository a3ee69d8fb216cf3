"""Rollouts to look at: which are filmed, and how their files are called."""

from collections.abc import Sequence
from pathlib import Path

from rf_exp.ablation.rows import EvaluationRow
from rf_exp.types import FOREIGN, UNVARIED

FILM, PICTURE = ".mp4", ".png"


def worth_seeing(rows: Sequence[EvaluationRow], count: int) -> tuple[int, ...]:
    """Scene seeds of the first `count` successes and of as many failures, of different kinds first."""
    ordered = sorted(rows, key=lambda row: row.scene_seed)
    won = [row.scene_seed for row in ordered if row.success]
    lost = [row for row in ordered if not row.success and row.steps]  # without steps there is nothing to see
    kinds = {row.account.kind: row.scene_seed for row in reversed(lost)}
    first = sorted(kinds.values())
    others = [row.scene_seed for row in lost if row.scene_seed not in first]
    return (*won[:count], *[*first, *others][:count])


def rows_file(
    task: str,
    constraints: str,
    arch: str,
    recipe: str,
    demos: int,
    shield: bool = False,
    variation: str = UNVARIED,
) -> Path:
    """The rows of policies of all training seeds in scenes of a variation, below the output folder."""
    name = f"{constraints}-{recipe}-{demos}{'-shield' * shield}{_in(variation)}.jsonl"
    return Path("results", "evaluate", task, arch, name)


def of_training_seed(rows: Path, seed: int) -> Path:
    """How what is known of one training seed is called, beside the rows of all."""
    return rows.with_name(f"{rows.stem}-{seed}{rows.suffix}")


def rollout_name(
    arch: str, recipe: str, demos: int, train_seed: int, shield: bool = False, variation: str = UNVARIED
) -> str:
    """How files about the rollouts of a policy begin; `-<scene seed>` follows."""
    seed = f"-t{train_seed}" if train_seed else ""
    return f"evaluate-{arch}-{recipe}-{demos}{seed}{'-shield' * shield}{_in(variation)}"


def _in(variation: str) -> str:
    return "" if variation == UNVARIED else f"-in-{variation}"


def rollout_file(row: EvaluationRow, suffix: str) -> Path:
    """The file about a rollout, below the output folder."""
    how = row.demos, row.train_seed, row.shield, row.variation
    name = rollout_name(row.arch, row.recipe, *how)
    return Path("recordings", row.task, row.constraints, f"{name}-{row.scene_seed}{suffix}")


def learnt_from(row: EvaluationRow) -> str:
    """What the policies of a rollout have learnt from, how, and where they acted, in words."""
    trained = f", training seed {row.train_seed}" if row.train_seed else ""
    acting = ", shielded" * row.shield
    if row.variation != UNVARIED:
        acting += f", in scenes of {row.variation}"
    if row.arch == FOREIGN.name:
        return f"a policy of others, {row.recipe}{trained}{acting}"
    recipe = f", recipe {row.recipe}" if row.recipe != "paper" else ""
    return f"{row.constraints}, {row.demos} demonstrations{recipe}{trained}{acting}"
