"""The card of a data set: what its reader wants to know, from what the store says of itself."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from rf_exp.store.reader import Reader

HEADER = """---
license: mit
task_categories:
- robotics
tags:
{tags}
---
"""


def card(store: Reader, held: str = "", tags: Iterable[str] = ()) -> str:
    """A data card in Markdown. `held` says in which form the data lie beside it; unless given, the store."""
    held = (
        held or f"`{store.path.name}` is a Zarr 3 store; docs/data.md of `rf_exp` says what its arrays are."
    )
    lines = HEADER.format(tags="\n".join(f"- {tag}" for tag in ("robofactory", "multi-arm", *tags)))
    title = store.description.language["title"] if store.description else store.attrs["task"]
    parts = [f"# {title}: demonstrations of several arms", held, _about(store), _facts(store), _made(store)]
    return lines + "\n" + "\n\n".join(part for part in parts if part) + "\n"


def _about(store: Reader) -> str:
    said = store.description
    if said is None:
        return ""
    success = "".join(f"\n- {name}" for name in said.conditions)
    return (
        f"{said.language['description']} {said.language['target_condition']}\n\n"
        "## Success\n\n"
        f"Criteria of version {store.attrs['criteria_version']}; all of them held for "
        f"{hold_steps(store)} control steps at the end of every demonstration:\n{success}"
    )


def hold_steps(store: Reader) -> str:
    """For how many steps the conditions have to hold."""
    steps = store.identity.get("scene", {}).get("success", {}).get("hold_steps")
    return "several" if steps is None else f"{steps:g}"


def facts(store: Reader) -> dict[str, Any]:
    """The data in numbers, by name; values are plain."""
    lengths = np.diff(store.episode_ends, prepend=0)
    seeds = store.seeds
    row = store.identity.get("constraint_set", {})
    picture = f"{store.attrs['width']} x {store.attrs['height']} px" if store.cameras else "none"
    return {
        "task": store.attrs["task"],
        "constraints": row.get("name", "not known"),
        "robots": f"{store.agents} x Franka Panda with its gripper, in simulation (ManiSkill 3, SAPIEN)",
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
        "disturbed": "yes: `executed` differs from `action`" if store.disturbed else "no",
    }


def _facts(store: Reader) -> str:
    rows = "".join(f"\n| {name} | {value} |" for name, value in facts(store).items())
    return (
        "## The data\n\n| what | value |\n| --- | --- |" + rows + "\n\n"
        "Units are metres, radians, seconds; the world frame has its z axis up and the top of the\n"
        "table at z = 0; quaternions are w, x, y, z. A gripper command goes from -1, closed, to 1,\n"
        "open. A row is what was measured before its action; the conditions of success are what the\n"
        "action has led to."
    )


def _made(store: Reader) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in store.attrs.get("versions", {}).items())
    recipe = json.dumps({name: value for name, value in store.identity.items() if name != "scene"}, indent=1)
    return (
        "## How it was made\n\n"
        "By `rf_exp`: RoboBrain proposes subgoals and constraints, a planner makes joint paths and a\n"
        "schedule of them, RoboChecker checks both and watches the simulated arms; only what succeeds\n"
        "is kept. The certificate of each episode holds proposals, check code and verdicts. The same\n"
        "seeds and versions give the same states and actions again.\n\n"
        f"Generator {store.attrs.get('generator')}, code {store.attrs.get('commit') or 'not known'}; "
        f"{versions}.\n\n<details><summary>Configuration</summary>\n\n```json\n{recipe}\n```\n\n</details>\n\n"
        "## Licence\n\nMIT, as `rf_exp`. If you use the data, cite RoboFactory (Qin et al., ICCV 2025)."
    )
