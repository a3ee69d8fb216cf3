"""Environments of the tasks: Gymnasium, one controller of all arms, and PettingZoo, one agent per arm.

Importing this package registers `rf_exp/<task>-v1` with Gymnasium for every task of conf/task, and
`rf_exp/lerobot-v1`, which has the keys of LeRobot. All environments build on `core.EpisodeCore`;
`Observations` selects what they observe. See docs/environments.md.
"""

from rf_exp.envs.central import environment_id, parallel_env, register
from rf_exp.envs.core import ResetNeeded
from rf_exp.envs.lerobot import LEROBOT_ID, LeRobotEnv, lerobot_spaces
from rf_exp.observations import Observations

__all__ = [
    "LEROBOT_ID",
    "LeRobotEnv",
    "Observations",
    "ResetNeeded",
    "environment_id",
    "lerobot_spaces",
    "parallel_env",
    "register",
]
