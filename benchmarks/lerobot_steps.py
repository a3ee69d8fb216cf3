"""LeRobot's diffusion policy in the paper's shapes, a step or a call at a time, for comparison with ours.

    python benchmarks/train_step.py --size paper --lerobot PYTHON
    python benchmarks/policy_call.py --size paper --lerobot PYTHON

PYTHON belongs to a separate environment with lerobot, which needs another torch than we do. Run there, this
file answers each line of its input with the milliseconds of one more step. LeRobot gets pictures as floats in
[0, 1], our policy as bytes; neither has an optimiser.
"""

# pyright: reportMissingImports=false
import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import torch

FRAMES, HORIZON, ACTION_STEPS, CHANNELS = 3, 8, 6, (256, 512, 1024)
HEIGHT, WIDTH, CROP = 240, 320, 0.9
SIZE = 8  # joints and gripper


class LeRobot:
    """Client of this file in LeRobot's environment. A context manager."""

    def __init__(self, python: str, what: str, batch: int, threads: int) -> None:
        command = [python, __file__, what, "--batch", str(batch), "--threads", str(threads)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def milliseconds(self) -> float:
        """The time of one more step or call."""
        assert self._process.stdin and self._process.stdout
        print(file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            sys.exit(f"lerobot ended with exit code {self._process.wait()}; its output is above")
        return float(answer)

    def __enter__(self) -> "LeRobot":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()


def lerobot_policy(what: str) -> Any:
    """LeRobot's policy, in the paper's shapes."""
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import Policy

    sampler = {"noise_scheduler_type": "DDIM", "num_inference_steps": 10} if what == "ddim" else {}
    torch.manual_seed(0)
    return Policy(
        DiffusionConfig(
            n_obs_steps=FRAMES,
            horizon=HORIZON,
            n_action_steps=ACTION_STEPS,
            down_dims=CHANNELS,
            crop_shape=(round(CROP * HEIGHT), round(CROP * WIDTH)),
            input_features={
                "observation.state": PolicyFeature(FeatureType.STATE, (SIZE,)),
                "observation.images.own": PolicyFeature(FeatureType.VISUAL, (3, HEIGHT, WIDTH)),
            },
            output_features={"action": PolicyFeature(FeatureType.ACTION, (SIZE,))},
            device="cpu",
            **sampler,
        )
    )


def step_of(what: str, count: int) -> Callable[[], None]:
    """A function for one forward and backward pass on a batch of windows, or for one chunk of actions."""
    policy = lerobot_policy(what)
    batch = {
        "observation.state": torch.rand(count, FRAMES, SIZE),
        "observation.images.own": torch.rand(count, FRAMES, 3, HEIGHT, WIDTH),
        "action": torch.rand(count, HORIZON, SIZE),
        "action_is_pad": torch.zeros(count, HORIZON, dtype=torch.bool),
    }

    def train() -> None:
        policy.forward(dict(batch))[0].backward()
        policy.zero_grad()

    @torch.inference_mode()
    def call() -> None:
        images = {"observation.images": batch["observation.images.own"].unsqueeze(2)}
        policy.diffusion.generate_actions({"observation.state": batch["observation.state"], **images})

    policy.train(what == "train")
    return train if what == "train" else call


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("what", choices=("train", "ddpm", "ddim"))
    parser.add_argument("--batch", type=int, default=1, help="windows")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    step = step_of(args.what, args.batch)
    for _ in sys.stdin:
        begin = time.perf_counter()
        step()
        print((time.perf_counter() - begin) * 1e3, flush=True)


if __name__ == "__main__":
    main()
