"""Gymnasium's and PettingZoo's own checkers; their warnings count as failures.

Spaces and seeds of all tasks are made in the same way, from the numbers of arms and objects. Registration of
each task and observations within their spaces are tested in test_environments.py.
"""

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from rf_exp.envs import Observations, environment_id, parallel_env

# Positions and velocities have no bounds on purpose.
pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.filterwarnings("ignore:.*Box observation space m.* value is -?infinity"),
]
# With one, two, three and four arms.
NUMBERS_OF_ARMS = ["pick_meat", "lift_barrier", "three_robots_stack_cube", "take_photo"]
SMALL = Observations(
    pictures=True, depth=True, segmentation=True, calibration=True, language=True, width=32, height=24
)


@pytest.mark.slow
@pytest.mark.parametrize("name", NUMBERS_OF_ARMS)
def test_gymnasium_accepts_tasks_with_one_to_four_arms(name: str) -> None:
    env = gymnasium.make(environment_id(name))
    assert environment_id(name) == f"rf_exp/{name}-v1"
    check_env(env.unwrapped, skip_render_check=True)  # which needs a Vulkan device
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", NUMBERS_OF_ARMS)
def test_pettingzoo_accepts_tasks_with_one_to_four_arms(name: str) -> None:
    parallel_api_test(parallel_env(name, step_limit=8), num_cycles=12)
    parallel_seed_test(lambda: parallel_env(name), num_cycles=6)


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", ["lift_barrier", "take_photo"])
def test_both_accept_all_observations(name: str) -> None:
    env = gymnasium.make(environment_id(name), observations=SMALL, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()
    parallel_api_test(parallel_env(name, SMALL, step_limit=4), num_cycles=6)
    parallel_seed_test(lambda: parallel_env(name, SMALL), num_cycles=2)
