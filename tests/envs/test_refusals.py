"""Errors of the environments name the problem, the value found and the possible values."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from rf_exp.envs import Observations, ResetNeeded, environment_id, parallel_env, register
from rf_exp.envs.central import CentralEnv
from rf_exp.errors import ArgumentError


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Observations(state="all"), "unknown state 'all'; available: full, joints, none"),  # pyright: ignore
        (lambda: Observations(cameras="wrist"), "unknown cameras 'wrist'; available: all, global, local"),  # pyright: ignore
        (lambda: Observations(width=5), "picture.width is 5; possible are 16 to 2048 pixels"),
        (lambda: Observations(state="none"), "nothing is observed; expected state, pictures, depth"),
        (lambda: Observations(calibration=True), "calibration is observed, and no camera is"),
        (
            lambda: CentralEnv("lift_barier"),
            "unknown task 'lift_barier'; available: camera_alignment, chain, ",
        ),
        (lambda: CentralEnv("ring_9x1"), "task 'ring': arms is 9; expected 1 to 8"),
        (lambda: register("no/such.yaml"), "task 'no/such.yaml': there is no such file"),
        (lambda: CentralEnv("pick_meat", step_limit=0), "step_limit is 0; expected at least 1 control step"),
        (
            lambda: CentralEnv("pick_meat", render_mode="human"),
            "unknown render_mode 'human'; available: None",
        ),
        (lambda: parallel_env("pick_meat", {"state": "full"}), "observations is {'state': 'full'}; expected"),  # pyright: ignore
    ],
)
def test_invalid_options_are_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError) as error:
        make()
    assert message in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            np.zeros(8),
            r"action of shape \(8,\); expected finite numbers of shape \(2, 8\): joint targets in rad",
        ),
        (
            np.full((2, 8), np.nan),
            r"action of shape \(2, 8\) with values that are not finite; expected finite",
        ),
        ("up", r"action is 'up'; expected finite numbers of shape \(2, 8\)"),
        (None, r"action of shape \(\); expected finite numbers of shape \(2, 8\)"),
    ],
)
def test_invalid_actions_are_refused(action: Any, message: str) -> None:
    env: Any = CentralEnv("lift_barrier")
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=message):
        env.step(action)
    env.step(env.action_space.sample())  # the environment still works
    env.close()


@pytest.mark.slow
def test_invalid_actions_of_agents_are_refused() -> None:
    env = parallel_env("lift_barrier")
    env.reset(seed=0)
    valid = {agent: env.action_space(agent).sample() for agent in env.agents}
    with pytest.raises(
        ArgumentError, match=r"actions of \['agent1'\]; expected one of each of \['agent1', 'agent2'\]"
    ):
        env.step({"agent1": valid["agent1"]})
    with pytest.raises(
        ArgumentError, match=r"action of agent2 of shape \(7,\); expected finite numbers of shape \(8,\)"
    ):
        env.step(valid | {"agent2": np.zeros(7)})
    with pytest.raises(ArgumentError, match="values that are not finite"):
        env.step(valid | {"agent2": np.full(8, np.nan)})
    env.close()


@pytest.mark.parametrize("make", [CentralEnv, parallel_env])
def test_a_step_without_an_episode_is_refused(make: Callable[..., Any]) -> None:
    env = make("pick_meat", step_limit=1)
    action = {"agent1": np.zeros(8)} if make is parallel_env else np.zeros((1, 8))
    with pytest.raises(ResetNeeded, match=r"no episode is under way; call reset\(\)"):
        env.step(action)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="without a render_mode; expected render_mode='rgb_array'"):
        env.render()
    env.step(action)
    with pytest.raises(gymnasium.error.ResetNeeded, match="after the last"):
        env.step(action)
    env.close()
    env.close()
    with pytest.raises(ResetNeeded, match="the environment is closed; make another one"):
        env.reset()


def test_invalid_seeds_are_refused() -> None:
    env = gymnasium.make(environment_id("pick_meat"))
    with pytest.raises(ArgumentError, match="seed 4294967296: expected a whole number from 0 to 4294967295"):
        env.reset(seed=2**32)
    with pytest.raises(gymnasium.error.Error, match="greater or equal to zero"):
        env.reset(seed=-1)
    env.close()
