"""Data cards: a Markdown description of a store, from its attributes and data."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from rf_exp.store.store import Store
from rf_exp.texts import LONGEST_LINE, printable
from rf_exp.texts.markdown import block, cell, code, table, text

HEADER = """---
license: {licence}
task_categories:
- robotics
tags:
{tags}
---
"""


def card(store: Store, held: str = "", tags: Iterable[str] = ()) -> str:
    """A data card in Markdown. Texts from the store are untrusted and escaped.

    `held`: Markdown about the format of the data beside the card; by default the store's.
    """
    name = code(store.path.name)
    held = held or f"{name} is a Zarr 3 store; docs/data.md of `rf_exp` says what its arrays are."
    listed = "\n".join(f"- {tag}" for tag in ("robofactory", "multi-arm", *tags))
    lines = HEADER.format(licence="unknown" if imported(store.identity) else "mit", tags=listed)
    title = store.description.language["title"] if store.description else store.attrs["task"]
    heading = f"# {text(title)}: demonstrations of several arms"
    made = _imported(store) or _made(store)
    parts = heading, held, _about(store), _facts(store), made
    return lines + "\n" + "\n\n".join(part for part in parts if part) + "\n"


def _about(store: Store) -> str:
    said = store.description
    if said is None:
        return ""
    success = "".join(f"\n- {text(name)}" for name in said.conditions)
    steps = store.identity.get("scene", {}).get("success", {}).get("hold_steps")
    held = f"{steps:g}" if isinstance(steps, int | float) else "several"
    return (
        f"{text(said.language['description'])} {text(said.language['target_condition'])}\n\n"
        "## Success\n\n"
        f"Criteria of version {text(store.attrs['criteria_version'])}; all of them held for "
        f"{held} control steps at the end of every demonstration:\n{success}"
    )


def facts(store: Store) -> dict[str, Any]:
    """Facts about the data, by name; values are plain, texts are one printable line."""
    lengths = np.diff(store.episode_ends, prepend=0)
    seeds = store.seeds
    row = store.identity.get("constraint_set", {})
    counted = Counter(model.title for model in store.models)
    robots = ", ".join(f"{count} x {title}" for title, count in counted.items())
    picture = f"{store.attrs['width']} x {store.attrs['height']} px" if store.cameras else "none"
    found = {
        "task": store.attrs["task"],
        "constraints": row.get("name", "not known"),
        "robots": f"{robots}, in simulation (ManiSkill 3, SAPIEN)",
        "episodes": len(store),
        "steps": store.steps,
        "steps an episode": f"{lengths.min()} to {lengths.max()}" if len(store) else "none",
        "control rate": f"{store.attrs['control_hz']} Hz",
        "minutes of motion": round(store.steps / store.attrs["control_hz"] / 60, 2),
        "scene seeds": f"{seeds.min()} to {seeds.max()}" if len(store) else "none",
        "cameras": ", ".join(store.cameras) or "none",
        "pictures": picture,
        "depth, segmentation": ", ".join(store.extra_names) or "none",
        "objects": ", ".join(store.objects) or "none",
        "disturbed": "yes: executed differs from action" if store.disturbed else "no",
    }
    if said := imported(store.identity):
        missing = said.get("missing")
        found["imported from"] = str(said.get("format"))
        names = ", ".join(map(str, missing)) if isinstance(missing, Mapping) else ""
        found["missing"] = names or "nothing"
    return {
        name: printable(value, LONGEST_LINE) if isinstance(value, str) else value
        for name, value in found.items()
    }


def _facts(store: Store) -> str:
    rows = [(name, cell(value)) for name, value in facts(store).items()]
    return (
        f"## The data\n\n{table(('what', 'value'), rows)}\n\n"
        "Units are metres, radians, seconds; the world frame has its z axis up and the top of the\n"
        "table at z = 0; quaternions are w, x, y, z. A gripper command goes from -1, closed, to 1,\n"
        "open. A row is what was measured before its action; the conditions of success are what the\n"
        "action has led to."
    )


def _imported(store: Store) -> str:
    """Section about the source of imported demonstrations and what missing data prevents; else empty."""
    said = imported(store.identity)
    if not said:
        return ""
    missing, notes = said.get("missing"), said.get("notes")
    lacks = [(cell(what), cell(so)) for what, so in missing.items()] if isinstance(missing, Mapping) else []
    told = [f"- {text(note)}" for note in notes] if isinstance(notes, list) else []
    parts = (
        "## Where it is from",
        f"Imported from {text(said.get('format'))} by `rf_exp`, code "
        f"{text(store.attrs.get('commit') or 'not known')}. The certificate of each episode names its "
        "source.\nWhose the data are, and under which licence, their source says.",
        "\n".join(told),
        "## What is missing",
        table(("what", "so"), lacks) if lacks else "Nothing.",
    )
    return "\n\n".join(part for part in parts if part)


def imported(identity: Mapping[str, Any]) -> Mapping[str, Any]:
    """The entry about its source in the identity of an imported store; empty for the suite's own stores."""
    said = identity.get("imported")
    return said if isinstance(said, Mapping) else {}


def _made(store: Store) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in store.attrs.get("versions", {}).items())
    recipe = json.dumps({name: value for name, value in store.identity.items() if name != "scene"}, indent=1)
    for letter in "<>&`~":  # a JSON escape is never markup
        recipe = recipe.replace(letter, f"\\u{ord(letter):04x}")
    return (
        "## How it was made\n\n"
        "By `rf_exp`: RoboBrain proposes subgoals and constraints, a planner makes joint paths and a\n"
        "schedule of them, RoboChecker checks both and watches the simulated arms; only what succeeds\n"
        "is kept. The certificate of each episode holds proposals, check code and verdicts. The same\n"
        "seeds and versions give the same states and actions again.\n\n"
        f"Generator {text(store.attrs.get('generator'))}, "
        f"code {text(store.attrs.get('commit') or 'not known')}; {text(versions)}.\n\n"
        f"<details><summary>Configuration</summary>\n\n{block(recipe, 'json')}\n\n</details>\n\n"
        "## Licence\n\nMIT, as `rf_exp`. If you use the data, cite RoboFactory (Qin et al., ICCV 2025)."
    )
