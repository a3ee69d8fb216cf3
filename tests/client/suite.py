"""Writes the client's description of the suite from its configuration: python -m tests.client.suite"""

import json
from pathlib import Path
from typing import Any

from rf_exp.robots import DEFAULT
from rf_exp.types import CONTROL_HZ
from tests.conftest import TASKS, read_task

VELOCITY_RAD_S = 0.9  # limits.velocity_rad_s of conf/config.yaml
FILE = Path(__file__).parents[2] / "rf_exp/client/suite.json"


def suite() -> dict[str, Any]:
    """Rest posture and limits of the Panda, the largest motion of a joint per control step, and all tasks."""
    tasks = {name: read_task(name) for name in TASKS}
    return {
        "rest_rad": [round(angle, 4) for angle in DEFAULT.rest_rad],
        "limits_rad": [list(row) for row in DEFAULT.limits_rad],
        "open_m": DEFAULT.hand.open_m,
        "step_rad": VELOCITY_RAD_S / CONTROL_HZ,
        "tasks": {
            name: {"arms": len(each.agents), "objects": [*each.objects], "description": each.description}
            for name, each in tasks.items()
        },
    }


def suite_json() -> str:
    return json.dumps(suite(), indent=1) + "\n"


if __name__ == "__main__":
    FILE.write_text(suite_json(), "utf-8")
