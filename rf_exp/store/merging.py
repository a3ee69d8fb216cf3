"""Merging of stores of one configuration with different seeds into one store."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from rf_exp.artifacts import atomic_path, find_differences, write_text
from rf_exp.errors import StageError
from rf_exp.store.cards import card
from rf_exp.store.layout import empty_like
from rf_exp.store.store import Store

PROVENANCE = ("commit", "versions")  # of the part with the first seeds, as in a store that is appended to


def merge_order(stores: Sequence[Store]) -> list[tuple[int, Store, int]]:
    """(seed, store, index in it) of every episode, ordered by seed.

    Raises StageError for stores of different configurations, and for a seed that occurs twice.
    """
    first = stores[0]
    for other in stores[1:]:
        if differences := find_differences(_compared(first.attrs), _compared(other.attrs)):
            raise StageError(
                f"{first.path} and {other.path} were made from different configurations "
                f"({'; '.join(differences)}); only stores of one configuration can be merged"
            )
    seeds = [enumerate(store.seeds.tolist()) for store in stores]
    episodes = sorted(
        (seed, number, index) for number, numbered_seeds in enumerate(seeds) for index, seed in numbered_seeds
    )
    for (seed, first_store, _), (next_seed, second_store, _) in pairwise(episodes):
        if seed == next_seed:
            raise StageError(
                f"seed {seed} is in {stores[first_store].path} and in {stores[second_store].path}; "
                "stores that are merged hold different seeds"
            )
    return [(seed, stores[number], index) for seed, number, index in episodes]


def merge(stores: Sequence[Store], to: Path, advance: Callable[[], object] = lambda: None) -> None:
    """Writes the store `to` atomically, with the same bytes as if made in one run, and its card beside it.

    `advance` is called after each episode. Raises StageError as `merge_order` does, and where `to` exists.
    """
    if to.exists():
        raise StageError(f"{to} exists already; nothing is written over it: name another store")
    episodes = merge_order(stores)
    earliest = min(stores, key=lambda store: store.identity.get("first_seed", 0))
    with atomic_path(to) as draft:
        empty_like(draft, earliest.attrs)
        with Store.open(draft, writable=True) as store:
            for _, source, index in episodes:
                store.append(source.episode(index))
                advance()
        write_text(to.with_suffix(".md"), card(Store.open(draft)))


def _compared(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes that must be equal in merged stores."""
    identity = {name: value for name, value in attributes["identity"].items() if name != "first_seed"}
    values = {name: value for name, value in attributes.items() if name not in PROVENANCE}
    return {**values, "identity": identity}
