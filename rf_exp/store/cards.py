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


def card(store: Store, format_note: str = "", tags: Iterable[str] = ()) -> str:
    """A data card in Markdown. Texts from the store are untrusted and escaped.

    `format_note`: Markdown about the format of the data beside the card; by default the store's.
    """
    name = code(store.path.name)
    format_note = (
        format_note or f"{name} is a Zarr 3 store; docs/data.md of `rf_exp` says what its arrays are."
    )
    tag_lines = "\n".join(f"- {tag}" for tag in ("robofactory", "multi-arm", *tags))
    header = HEADER.format(licence="unknown" if import_source(store.identity) else "mit", tags=tag_lines)
    title = store.description.language["title"] if store.description else store.attrs["task"]
    heading = f"# {text(title)}: demonstrations of several arms"
    origin = _import_section(store) or _provenance_section(store)
    parts = heading, format_note, _task_section(store), _facts_section(store), origin
    return header + "\n" + "\n\n".join(part for part in parts if part) + "\n"


def _task_section(store: Store) -> str:
    description = store.description
    if description is None:
        return ""
    success = "".join(f"\n- {text(name)}" for name in description.conditions)
    hold_steps = store.identity.get("scene", {}).get("success", {}).get("hold_steps")
    hold_text = f"{hold_steps:g}" if isinstance(hold_steps, int | float) else "several"
    return (
        f"{text(description.language['description'])} {text(description.language['target_condition'])}\n\n"
        "## Success\n\n"
        f"Criteria of version {text(store.attrs['criteria_version'])}; all of them held for "
        f"{hold_text} control steps at the end of every demonstration:\n{success}"
    )


def facts(store: Store) -> dict[str, Any]:
    """Facts about the data, by name; values are plain, texts are one printable line."""
    lengths = np.diff(store.episode_ends, prepend=0)
    seeds = store.seeds
    constraint_set = store.identity.get("constraint_set", {})
    robot_counts = Counter(model.title for model in store.models)
    robots = ", ".join(f"{count} x {title}" for title, count in robot_counts.items())
    picture = f"{store.attrs['width']} x {store.attrs['height']} px" if store.cameras else "none"
    values = {
        "task": store.attrs["task"],
        "constraints": constraint_set.get("name", "not known"),
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
    if source := import_source(store.identity):
        missing = source.get("missing")
        values["imported from"] = str(source.get("format"))
        names = ", ".join(map(str, missing)) if isinstance(missing, Mapping) else ""
        values["missing"] = names or "nothing"
    return {
        name: printable(value, LONGEST_LINE) if isinstance(value, str) else value
        for name, value in values.items()
    }


def _facts_section(store: Store) -> str:
    rows = [(name, cell(value)) for name, value in facts(store).items()]
    return (
        f"## The data\n\n{table(('what', 'value'), rows)}\n\n"
        "Units are metres, radians, seconds; the world frame has its z axis up and the top of the\n"
        "table at z = 0; quaternions are w, x, y, z. A gripper command goes from -1, closed, to 1,\n"
        "open. A row is what was measured before its action; the conditions of success are what the\n"
        "action has led to."
    )


def _import_section(store: Store) -> str:
    """Section about the source of imported demonstrations and what missing data prevents; else empty."""
    source = import_source(store.identity)
    if not source:
        return ""
    missing, notes = source.get("missing"), source.get("notes")
    missing_rows = (
        [(cell(item), cell(consequence)) for item, consequence in missing.items()]
        if isinstance(missing, Mapping)
        else []
    )
    note_lines = [f"- {text(note)}" for note in notes] if isinstance(notes, list) else []
    parts = (
        "## Where it is from",
        f"Imported from {text(source.get('format'))} by `rf_exp`, code "
        f"{text(store.attrs.get('commit') or 'not known')}. The certificate of each episode names its "
        "source.\nWhose the data are, and under which licence, their source says.",
        "\n".join(note_lines),
        "## What is missing",
        table(("what", "so"), missing_rows) if missing_rows else "Nothing.",
    )
    return "\n\n".join(part for part in parts if part)


def import_source(identity: Mapping[str, Any]) -> Mapping[str, Any]:
    """The entry about its source in the identity of an imported store; empty for the suite's own stores."""
    source = identity.get("imported")
    return source if isinstance(source, Mapping) else {}


def _provenance_section(store: Store) -> str:
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
