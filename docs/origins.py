"""Provenance of policies: the generator of their demonstrations, and changed keys of their recipe."""

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rf_exp.ablation import (
    BASELINE_ARCH,
    PUBLISHED,
    EvaluationRow,
    Published,
    configured,
    read_published,
    rows_file,
    title_of,
)
from rf_exp.artifacts import leaves, plain
from rf_exp.experiment import read_experiment
from rf_exp.keys import RENAMED

ROOT = Path(__file__).parents[1]
ORIGIN_COLUMNS = ("demonstrations by generator", "values when measured; keys added since", "policies")
VALUES_WHEN_ABSENT = {  # later keys were not recorded where they were off
    "policy.acting.transition_integrator": 0.0,
    "policy.encoder.keypoints.downsample": 1,
    "policy.encoder.keypoints.crop_refinement": 0,
    "policy.encoder.keypoints.photometric": 0.0,
    "training.active_agent_sampling": 0.0,
}


def origins(rows: Iterable[EvaluationRow]) -> list[tuple[str, str, str]]:
    """(generator, changes of the recipe since then, policies) for each provenance, newest generator first."""
    policies_by_origin: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if not row.shield:  # shielded rows are of the same policies
            policy = f"{title_of(row.task, configured())} {row.demos}"
            qualifiers = [
                word for word, default in ((row.arch, BASELINE_ARCH), (row.recipe, "fast")) if word != default
            ]
            policies_by_origin.setdefault(origin(row), []).append(
                f"{policy} ({', '.join(qualifiers)})" if qualifiers else policy
            )
    return [(*key, "; ".join(policies_by_origin[key])) for key in sorted(policies_by_origin, reverse=True)]


def origin(row: EvaluationRow) -> tuple[str, str]:
    """The generator of a policy's demonstrations, and the changes of its recipe since then."""
    rows = _published(row)
    if row.train_seed not in rows.made:
        return "-", "not recorded"
    generator = rows.made[row.train_seed]["data"]["identity"]["generator"].partition(".")[0]
    recorded, current = with_current_keys(rows.asked), current_recipe(row.recipe.partition("+")[0])
    changes = [
        f"`{key}` {recorded[key]}"
        for key in sorted(recorded)
        if key in current and recorded[key] != current[key]
    ]
    if missing := [
        f"`{key}`"
        for key in sorted(current.keys() - recorded.keys())
        if current[key] != VALUES_WHEN_ABSENT.get(key)
    ]:
        changes.append(f"without {', '.join(missing)}")
    return generator, ", ".join(changes)


def learned_with(row: EvaluationRow, key: str) -> Any:
    """The value of a key in the recipe of one policy; None where the key did not exist yet."""
    rows = _published(row)
    return with_current_keys(rows.asked).get(key) if rows.asked else None


def _published(row: EvaluationRow) -> Published[EvaluationRow]:
    policies = row.task, row.constraints, row.arch, row.recipe, row.demos
    return published(rows_file(*policies, row.shield, row.variation))


@cache
def published(rows: Path) -> Published[EvaluationRow]:
    return read_published(ROOT / rows.with_suffix(PUBLISHED), EvaluationRow)


@cache
def current_recipe(recipe: str) -> Mapping[str, Any]:
    """The present values of a recipe of conf/, by dotted keys."""
    choice = (
        f"ablation/{recipe}"
        if (ROOT / "conf" / "policy" / "ablation" / f"{recipe}.yaml").exists()
        else recipe
    )
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        config = compose("config", [f"policy={choice}", f"recipe={recipe}", "profile=laptop"])
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore
    return recipe_values({"policy": experiment.policy.identity, "training": experiment.training.identity})


def recipe_values(node: Mapping[str, Any]) -> dict[str, Any]:
    """Values that determine policy and training, by dotted keys."""
    values = leaves(plain({part: node[part] for part in ("policy", "training")}))
    return {key: value for key, value in values.items() if key != "training.seed"}


def with_current_keys(node: Mapping[str, Any]) -> Mapping[str, Any]:
    """Recorded values by present keys, also from before encoder and head had their own sections."""
    recorded = recipe_values(node)
    if isinstance(node["policy"]["encoder"], Mapping):
        return recorded
    observation, has_draft = recorded.pop("policy.observation", "pictures"), recorded.get("policy.draft")
    renamed = {RENAMED.get(key, key): value for key, value in recorded.items()}
    encoder = {"heatmaps": "keypoints"}.get(renamed["policy.encoder.name"], renamed["policy.encoder.name"])
    renamed["policy.encoder.name"] = "privileged" if observation == "state" else encoder
    renamed["policy.head.name"] = "refined" if has_draft else "diffusion"
    return {**renamed, "policy.phase_dropout": recorded.get("policy.dropout", 0.0)}
