"""Cost of a training step: frames encoded once or for each window, NHWC or NCHW, in one run.

    python benchmarks/train_step.py [--size compact|paper] [--steps 5] [--batch 32] [--threads 1]
                                    [--lerobot PYTHON]

One step is the forward and backward pass of the loss. The four variants alternate on the same batches, so
that a busy machine slows all of them; optionally also LeRobot's diffusion policy, in the environment of
PYTHON (lerobot_steps.py). The last line is JSON: windows/s of each, and the ratios.
"""

import argparse
import json
import time
from contextlib import ExitStack
from dataclasses import replace
from statistics import median

import numpy as np
import torch
from lerobot_steps import LeRobot
from loader import VIEW, noise, recipe

from rf_exp.policy import Batch, Policy, Windows


def per_window(batch: Batch) -> Batch:
    """The same batch with every frame repeated for each window that shows it."""
    pictures = batch.pictures[batch.frames.flatten()]
    return replace(batch, pictures=pictures, frames=torch.arange(len(pictures)).view_as(batch.frames))


def milliseconds(policy: Policy, batch: Batch) -> float:
    generator = torch.Generator().manual_seed(0)
    begin = time.perf_counter()
    condition = policy.condition(policy.encode(batch.pictures)[batch.frames], batch.proprio, batch.context)
    policy.head.loss(condition, policy.normaliser.action.normalise(batch.action), generator).backward()
    elapsed = (time.perf_counter() - begin) * 1e3
    policy.zero_grad()
    return elapsed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--size", choices=("compact", "paper"), default="compact")
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--batch", type=int, default=None, help="windows; 32, or 8 for paper")
    parser.add_argument("--threads", type=int, default=1, help="more are steady on an idle machine only")
    parser.add_argument("--lerobot", metavar="PYTHON", help="of an environment with lerobot; size paper")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    paper = args.size == "paper"
    if args.lerobot and not paper:
        parser.error("--lerobot is of the paper's shapes; add --size paper")
    small = ("training.run_length=4", "policy.head.diffusion.noise_draws=4")
    experiment = recipe(args.size, *(() if paper else small))
    config, train = experiment.policy, experiment.training
    count = args.batch or (8 if paper else 32)

    torch.manual_seed(0)
    windows = Windows(noise(config), VIEW, config, torch.device("cpu"))  # pyright: ignore[reportArgumentType]
    policies = {}
    for layout in (torch.channels_last, torch.contiguous_format):
        policies[layout] = Policy(config, VIEW)
        policies[layout].to(memory_format=layout)
    rng = np.random.default_rng(0)
    batches = windows.epoch(count, train.run_length, rng)
    times: dict[str, list[float]] = {}
    frames = 0
    with ExitStack() as stack:
        python = args.lerobot
        lerobot = python and stack.enter_context(LeRobot(python, "train", count, args.threads))
        for index in range(args.steps + 1):  # the first round warms up
            unique = windows.batch(batches[index % len(batches)], rng)
            frames = len(unique.pictures)
            for kind, batch in (("unique", unique), ("naive", per_window(unique))):
                for name, layout in (("nhwc", torch.channels_last), ("nchw", torch.contiguous_format)):
                    # `encode` makes (U, h, w, 3) channels_last; for NCHW the memory is laid out first.
                    pictures = batch.pictures
                    if layout is torch.contiguous_format:
                        pictures = pictures.permute(0, 3, 1, 2).contiguous().permute(0, 2, 3, 1)
                    elapsed = milliseconds(policies[layout], replace(batch, pictures=pictures))
                    times.setdefault(f"{kind}_{name}", []).append(elapsed)
            if lerobot:
                times.setdefault("lerobot", []).append(lerobot.milliseconds())
    rates = {name: round(count * 1e3 / median(values[1:]), 2) for name, values in times.items()}
    print(f"{count} windows of {frames} frames (naive: {3 * count}), {args.threads} threads")
    result = {
        "size": args.size,
        **{f"{name}_windows_per_s": rate for name, rate in rates.items()},
        "unique_over_naive": round(rates["unique_nhwc"] / rates["naive_nhwc"], 2),
        "nhwc_over_nchw": round(rates["unique_nhwc"] / rates["unique_nchw"], 2),
        "both": round(rates["unique_nhwc"] / rates["naive_nchw"], 2),
    }
    if args.lerobot:
        result["unique_over_lerobot"] = round(rates["unique_nhwc"] / rates["lerobot"], 2)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
