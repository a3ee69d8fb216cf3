"""What policies were made of: the generator of their demonstrations, and changed keys of their recipe."""

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
ORIGIN = ("demonstrations by generator", "what is otherwise in the recipe now", "policies")
UNUSED = {  # what came later was not recorded where it was not used
    "policy.acting.transition_integrator": 0.0,
    "policy.encoder.keypoints.downsample": 1,
    "policy.encoder.keypoints.crop_refinement": 0,
    "policy.encoder.keypoints.photometric": 0.0,
    "training.active_agent_sampling": 0.0,
}


def origins(rows: Iterable[EvaluationRow]) -> list[tuple[str, str, str]]:
    """Generator, what is otherwise in the recipe now, and the policies of which it is so; newest first."""
    found: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if not row.shield:  # the same policies
            of = f"{title_of(row.task, configured())} {row.demos}"
            how = [word for word, known in ((row.arch, BASELINE_ARCH), (row.recipe, "fast")) if word != known]
            found.setdefault(origin(row), []).append(f"{of} ({', '.join(how)})" if how else of)
    return [(*key, "; ".join(found[key])) for key in sorted(found, reverse=True)]


def origin(row: EvaluationRow) -> tuple[str, str]:
    """Of one policy: the generator, and what is otherwise now."""
    rows = _published(row)
    if row.train_seed not in rows.made:
        return "-", "not recorded"
    generator = rows.made[row.train_seed]["data"]["identity"]["generator"].partition(".")[0]
    then, now = as_now(rows.asked), today(row.recipe.partition("+")[0])
    told = [f"`{key}` {then[key]}" for key in sorted(then) if key in now and then[key] != now[key]]
    if missing := [f"`{key}`" for key in sorted(now.keys() - then.keys()) if now[key] != UNUSED.get(key)]:
        told.append(f"without {', '.join(missing)}")
    return generator, ", ".join(told)


def learned_with(row: EvaluationRow, key: str) -> Any:
    """The value of a key of the recipe of one policy; None where it was not there yet."""
    rows = _published(row)
    return as_now(rows.asked).get(key) if rows.asked else None


def _published(row: EvaluationRow) -> Published[EvaluationRow]:
    policies = row.task, row.constraints, row.arch, row.recipe, row.demos
    return published(rows_file(*policies, row.shield, row.variation))


@cache
def published(rows: Path) -> Published[EvaluationRow]:
    return read_published(ROOT / rows.with_suffix(PUBLISHED), EvaluationRow)


@cache
def today(recipe: str) -> Mapping[str, Any]:
    """The recipe as it is in conf/."""
    choice = (
        f"ablation/{recipe}"
        if (ROOT / "conf" / "policy" / "ablation" / f"{recipe}.yaml").exists()
        else recipe
    )
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        config = compose("config", [f"policy={choice}", f"recipe={recipe}", "profile=laptop"])
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore
    return flat({"policy": experiment.policy.identity, "training": experiment.training.identity})


def flat(node: Mapping[str, Any]) -> dict[str, Any]:
    """What decides policy and training, by dotted keys."""
    found = leaves(plain({part: node[part] for part in ("policy", "training")}))
    return {key: value for key, value in found.items() if key != "training.seed"}


def as_now(node: Mapping[str, Any]) -> Mapping[str, Any]:
    """What was recorded, by the keys of now: when encoder and head had no sections of their own, too."""
    then = flat(node)
    if isinstance(node["policy"]["encoder"], Mapping):
        return then
    seen, drafted = then.pop("policy.observation", "pictures"), then.get("policy.draft")
    found = {RENAMED.get(key, key): value for key, value in then.items()}
    encoder = {"heatmaps": "keypoints"}.get(found["policy.encoder.name"], found["policy.encoder.name"])
    found["policy.encoder.name"] = "privileged" if seen == "state" else encoder
    found["policy.head.name"] = "refined" if drafted else "diffusion"
    return {**found, "policy.phase_dropout": then.get("policy.dropout", 0.0)}
