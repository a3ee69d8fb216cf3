"""The tasks as environments for others: Gymnasium, one controller of all arms, and PettingZoo, an agent each.

Importing this package registers `rf_exp/<task>-v1` with Gymnasium for every task of conf/task. Both faces
stand on `core.EpisodeCore`, and both are told by `Observations` what they see. See docs/environments.md.
"""

from rf_exp.envs.central import environment_id, parallel_env, register
from rf_exp.envs.core import ResetNeeded
from rf_exp.observations import Observations

__all__ = ["Observations", "ResetNeeded", "environment_id", "parallel_env", "register"]
