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
from rf_exp.experiment import read_experiment

ROOT = Path(__file__).parents[1]


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
    rows = published(rows_file(row.task, row.constraints, row.arch, row.recipe, row.demos))
    if row.train_seed not in rows.made:
        return "-", "not recorded"
    generator = rows.made[row.train_seed]["data"]["identity"]["generator"].partition(".")[0]
    then, now = flat(rows.asked), today(row.recipe.partition("+")[0])
    told = [f"`{key}` {then[key]}" for key in sorted(then) if key not in now or then[key] != now[key]]
    if missing := [f"`{key}`" for key in sorted(now.keys() - then.keys())]:
        told.append(f"without {', '.join(missing)}")
    return generator, ", ".join(told)


@cache
def published(rows: Path) -> Published[EvaluationRow]:
    return read_published(ROOT / rows.with_suffix(PUBLISHED), EvaluationRow)


@cache
def today(recipe: str) -> Mapping[str, Any]:
    """The recipe as it is in conf/."""
    with initialize_config_dir(str(ROOT / "conf"), version_base=None):
        config = compose("config", [f"policy={recipe}", f"recipe={recipe}", "profile=laptop"])
    experiment = read_experiment(OmegaConf.to_container(config, resolve=True))  # pyright: ignore
    return flat({"policy": experiment.policy.identity, "training": experiment.training.identity})


def flat(node: Mapping[str, Any]) -> Mapping[str, Any]:
    """What decides policy and training, by dotted keys."""
    return {
        f"{part}.{key}": list(value) if isinstance(value, tuple) else value
        for part in ("policy", "training")
        for key, value in node[part].items()
        if key != "seed"
    }
