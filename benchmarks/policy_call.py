"""Cost of a call of the policy: effect of sampler, ring buffer and FiLM table, in one run.

    python benchmarks/policy_call.py [--size compact|paper] [--calls 3] [--lerobot PYTHON]
    python benchmarks/policy_call.py --policy outputs/policies/TASK/full/separate_local/fast-50-0/agent1

DDPM with 100 steps and DDIM with 10, each as in the rollout; then DDIM with all three frames encoded
again, and with the FiLM vector computed in every step; LeRobot's diffusion policy with both samplers,
in the environment of PYTHON (lerobot_steps.py). The variants alternate on one thread.
With `--policy`, for a trained policy instead: encoding (`look`), prediction of subgoals and of agents that
may go on (`phase`), the chunk of actions (`act`), and all together.
The last line is JSON: medians in ms, and the ratios.
"""

import argparse
import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from statistics import median

import torch
from lerobot_steps import LeRobot
from loader import VIEW, recipe

from rf_exp.policy import Policy, load_policy
from rf_exp.policy.networks.heads import DiffusionHead

PROPRIO = ACTION = 8


def make(size: str, sampler: str, steps: int) -> Policy:
    torch.manual_seed(0)
    samples = f"policy.head.diffusion.sampler={sampler}", f"policy.head.diffusion.inference_steps={steps}"
    return Policy(recipe(size, *samples).policy, VIEW).eval()


@torch.inference_mode()
def call(policy: Policy, pictures: torch.Tensor, known: torch.Tensor) -> None:
    """Encode the pictures, append their features to the known ones, and sample."""
    features = torch.cat([known, policy.encode_centre_crops(pictures)[0]])[None]
    proprio, nothing = (torch.zeros(1, features.shape[1], size) for size in (PROPRIO, 0))
    policy.act(features, proprio, nothing, [torch.Generator().manual_seed(0)])


@torch.inference_mode()
def call_without_table(policy: Policy, pictures: torch.Tensor, known: torch.Tensor) -> None:
    """The same by the U-Net's reference computation, which projects step and observation in every step."""
    config, head = policy.config, policy.head
    assert isinstance(head, DiffusionHead)
    features = torch.cat([known, policy.encode_centre_crops(pictures)[0]])[None]
    proprio, nothing = (torch.zeros(1, config.observation_steps, size) for size in (PROPRIO, 0))
    condition = head.trunk(policy.condition(features, proprio, nothing))
    sample = torch.randn(1, config.horizon, ACTION, generator=torch.Generator().manual_seed(0))
    for step in head.scheduler.timesteps:
        prediction = head.unet(sample, step[None], condition)
        sample = head.scheduler.step(prediction, step, sample).prev_sample  # pyright: ignore


def trained(folder: Path, calls: int) -> dict[str, object]:
    """Times in ms of a trained policy for one chunk, as in a rollout."""
    policy, _, _ = load_policy(folder, "cpu")
    config, normaliser = policy.config, policy.normaliser
    steps, generator = config.observation_steps, torch.Generator().manual_seed(0)
    picture = torch.randint(256, (1, config.height, config.width, 3), dtype=torch.uint8)
    proprio, context = (part.centre.expand(1, steps, -1) for part in (normaliser.proprio, normaliser.context))
    times: dict[str, list[float]] = {}
    for _ in range(calls + 1):
        with torch.inference_mode():
            began = [time.perf_counter()]
            features = policy.encode_centre_crops(picture)[0][:, None].expand(-1, steps, -1)
            began.append(time.perf_counter())
            probabilities = policy.transition_probabilities(features, proprio, context)
            if probabilities is None:
                conditioning = context
            else:
                conditioning = policy.with_phases(
                    context, probabilities[..., :-1].argmax(dim=2), probabilities[..., -1] > 0.5
                )
            began.append(time.perf_counter())
            policy.act(features, proprio, conditioning, [generator])
            began.append(time.perf_counter())
        for name, first, last in (("look", 0, 1), ("phase", 1, 2), ("act", 2, 3), ("all", 0, 3)):
            times.setdefault(f"{name}_ms", []).append((began[last] - began[first]) * 1e3)
    return {name: round(median(values[1:]), 2) for name, values in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore
    parser.add_argument("--size", choices=("compact", "paper"), default="compact")
    parser.add_argument("--calls", type=int, default=3)
    parser.add_argument("--policy", type=Path, help="folder of a trained one")
    parser.add_argument("--lerobot", metavar="PYTHON", help="of an environment with lerobot; size paper")
    args = parser.parse_args()
    if args.lerobot and args.size != "paper":
        parser.error("--lerobot is of the paper's shapes; add --size paper")
    torch.set_num_threads(1)  # as the rollout runs
    if args.policy:
        print(json.dumps(trained(args.policy, args.calls)))
        return
    ddpm, ddim = make(args.size, "ddpm", 100), make(args.size, "ddim", 10)
    config = ddim.config
    frames = torch.randint(256, (config.observation_steps, config.height, config.width, 3), dtype=torch.uint8)
    with torch.inference_mode():
        features = ddim.encode_centre_crops(frames)[0]
    earlier_features, newest_frame = features[:-1], frames[-1:]
    variants: dict[str, Callable[[], None]] = {
        "ddpm_100": lambda: call(ddpm, newest_frame, earlier_features),
        "ddim_10": lambda: call(ddim, newest_frame, earlier_features),
        "ddim_10_all_frames": lambda: call(ddim, frames, earlier_features[:0]),
        "ddim_10_no_table": lambda: call_without_table(ddim, newest_frame, earlier_features),
    }
    times: dict[str, list[float]] = {}
    with ExitStack() as stack:
        python = args.lerobot
        others = {
            f"lerobot_{name}": stack.enter_context(LeRobot(python, name, 1, 1))
            for name in ("ddpm", "ddim")
            if python
        }
        for _ in range(args.calls + 1):  # the first round warms up
            for name, variant in variants.items():
                begin = time.perf_counter()
                variant()
                times.setdefault(name, []).append((time.perf_counter() - begin) * 1e3)
            for name, other in others.items():
                times.setdefault(name, []).append(other.milliseconds())
    medians = {name: round(median(values[1:]), 2) for name, values in times.items()}
    result = {
        "size": args.size,
        **{f"{name}_ms": value for name, value in medians.items()},
        "ddpm_over_ddim": round(medians["ddpm_100"] / medians["ddim_10"], 2),
        "all_frames_over_ring_buffer": round(medians["ddim_10_all_frames"] / medians["ddim_10"], 2),
        "no_table_over_table": round(medians["ddim_10_no_table"] / medians["ddim_10"], 2),
    }
    for name, ours in (("ddpm", "ddpm_100"), ("ddim", "ddim_10")):
        if python:
            result[f"lerobot_{name}_over_ours"] = round(medians[f"lerobot_{name}"] / medians[ours], 2)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
