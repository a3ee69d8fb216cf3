"""Cost of a picture: our two-arm scene against ManiSkill's stock two-robot scene, in one run.

    python benchmarks/render.py [--pictures 40] [--task lift_barrier]

Both render 320x240 through the same calls, alternating, so that a busy machine slows both; neither has
shadows. The last line is JSON: medians in ms, and the ratio.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rf_exp.sim import Simulator  # first: selects the Vulkan driver
from rf_exp.tasks import load_task

WIDTH_PX, HEIGHT_PX = 320, 240
ORDER = (2, 1, 0, 4, 3)  # reset, step, picture, stock step, stock picture


def ours(task_name: str) -> tuple[Callable[[], float], Callable[[], float], Callable[[], float]]:
    """Timers in ms of one picture of a task's scene, one control step, and one reset."""
    from omegaconf import OmegaConf

    path = Path(__file__).parents[1] / "conf" / "task" / f"{task_name}.yaml"
    config = OmegaConf.to_container(OmegaConf.load(path))
    assert isinstance(config, dict)
    simulator = Simulator(load_task(task_name, config[task_name]), width_px=WIDTH_PX, height_px=HEIGHT_PX)
    simulator.reset(0)

    def picture() -> float:
        begin = time.perf_counter()
        count = len(simulator.images())
        return (time.perf_counter() - begin) * 1e3 / count

    def step() -> float:
        begin = time.perf_counter()
        simulator.step(simulator.command)
        return (time.perf_counter() - begin) * 1e3

    def reset() -> float:
        begin = time.perf_counter()
        simulator.reset(0)
        return (time.perf_counter() - begin) * 1e3

    return picture, step, reset


def stock() -> tuple[Callable[[], float], Callable[[], float]]:
    """Timers in ms of one picture and one control step of ManiSkill's unchanged TwoRobotStackCube-v1."""
    import gymnasium
    import mani_skill.envs  # noqa: F401 - registers the environment

    environment: Any = gymnasium.make(
        "TwoRobotStackCube-v1",
        obs_mode="none",
        control_mode="pd_joint_pos",
        sensor_configs={"width": WIDTH_PX, "height": HEIGHT_PX},
    ).unwrapped
    environment.reset(seed=0)
    scene = environment.scene.sub_scenes[0]
    camera = next(iter(environment._sensors.values())).camera._render_cameras[0]
    action = {
        uid: np.append(agent.robot.qpos[0, :7].numpy(), 1.0).astype(np.float32)
        for uid, agent in environment.agent.agents_dict.items()
    }

    def picture() -> float:
        begin = time.perf_counter()
        scene.update_render()
        camera.take_picture()
        camera.get_picture("Color")
        return (time.perf_counter() - begin) * 1e3

    def step() -> float:
        begin = time.perf_counter()
        environment.step(action)
        return (time.perf_counter() - begin) * 1e3

    return picture, step


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pictures", type=int, default=40)
    parser.add_argument("--task", default="lift_barrier")
    args = parser.parse_args()
    timers = [*ours(args.task), *stock()]
    for timer in timers:
        timer()  # the first picture compiles shaders
    times = np.array([[timers[i]() for i in ORDER] for _ in range(args.pictures)])
    reset_ms, step_ms, ours_ms, stock_step_ms, stock_ms = np.median(times, axis=0)
    print(f"picture {WIDTH_PX}x{HEIGHT_PX}: ours {ours_ms:.1f} ms, stock {stock_ms:.1f} ms")
    print(f"control step, two arms: ours {step_ms:.2f} ms at 100 Hz physics, stock {stock_step_ms:.2f} ms")
    print(f"reset with a new scene: {reset_ms:.1f} ms")
    print(
        json.dumps(
            {
                "picture_ms": round(float(ours_ms), 2),
                "stock_picture_ms": round(float(stock_ms), 2),
                "step_ms": round(float(step_ms), 3),
                "reset_ms": round(float(reset_ms), 1),
                "stock_step_ms": round(float(stock_step_ms), 3),
                "ratio": round(float(stock_ms / ours_ms), 2),
            }
        )
    )


if __name__ == "__main__":
    main()
