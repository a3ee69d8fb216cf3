"""Error in millimetres and run time of the keypoint encoder, on seeds that it was not trained on.

    python benchmarks/keypoints.py [outputs/data/lift_barrier/full/fast.zarr] [--train 40] [--steps 500]

Trains the encoder of every agent's own camera on the first episodes of a store and evaluates it on the rest:
the distance between true and predicted keypoints (where an own gripper changes next, or the episode ends, or
another arm is), at every earlier frame in which the keypoint is in the picture and the agent may go on. The
last line is JSON: by agent median and 90th percentile in mm for each keypoint, milliseconds per picture, and
CPU seconds of training. `--look STORE` evaluates on other pictures of those seeds, as `rf_exp.data redraw`
renders them.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from loader import recipe

from rf_exp.policy import Training, Windows, views
from rf_exp.policy.examples.keypoints import GRIPPER_POINTS, HEADING_SIZE
from rf_exp.policy.examples.windows import expert_steps
from rf_exp.policy.networks.keypoint_encoder import KEYPOINT_SIZE
from rf_exp.store import Store
from rf_exp.types import Arch

DEMO = Path("outputs/data/lift_barrier/full/fast.zarr")
CPU = torch.device("cpu")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, nargs="?", default=DEMO, help="default: that of the demo")
    parser.add_argument("--train", type=int, default=40, help="episodes")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument(
        "--active", type=float, default=0.5, help="part of the pictures in which it may go on"
    )
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--downsample", type=int, default=1, help="times, of the picture heat maps cover")
    parser.add_argument("--crop", type=int, default=0, help="pixels, side of the squares looked at again")
    parser.add_argument("--shift", type=int, default=0, help="pixels, of the pictures that are learned from")
    parser.add_argument("--look", type=Path, help="another store, that is looked at in place of this one")
    parser.add_argument("--photometric", type=float, default=0.0, help="how far pictures are lit otherwise")
    parser.add_argument("--dilations", default="1,2,4", help="of the convolutions, in cells")
    args = parser.parse_args()
    torch.set_num_threads(1)
    store = Store.open(args.store)
    train_store, eval_store = store.first(args.train), Store.open(args.look or args.store)
    seeds = np.repeat(eval_store.seeds, np.diff(eval_store.episode_ends, prepend=0))[expert_steps(eval_store)]
    keys = "policy.encoder.keypoints"
    experiment = recipe(
        "paper",
        *("policy.encoder.name=keypoints", "policy.context=true", "policy.crop=1.0"),
        *(f"picture.{side}={store.attrs[side]}" for side in ("height", "width")),
        *(f"{keys}.downsample={args.downsample}", f"{keys}.crop_refinement={args.crop}"),
        *(f"{keys}.photometric={args.photometric}", f"{keys}.steps={args.steps}"),
        *(f"{keys}.shift_px={args.shift}", "policy.observation_steps=1"),
        f"{keys}.dilations=[{args.dilations}]",
        *("training.epochs=null", "training.steps=1", "training.warmup_steps=50", "training.run_length=1"),
        *(f"training.active_agent_sampling={args.active}", f"training.batch_size={args.batch}"),
        f"training.learning_rate={args.rate}",
    )
    config = experiment.policy
    result: dict[str, object] = {"benchmark": "keypoints", "store": str(args.store)}
    for view in views(Arch("separate_local", False, False), store.agents):
        windows, eval_windows = (Windows(source, view, config, CPU) for source in (train_store, eval_store))
        training, began = Training(windows, view, config, experiment.training), time.process_time()
        for _ in range(args.steps):
            training.step()  # after the last one, the policy has averaged weights
        seconds = time.process_time() - began
        policy = training.policy.eval()
        held_out = eval_windows.active[~np.isin(seeds[eval_windows.active], train_store.seeds)]
        pictures, rays, labels = eval_windows.labelled(held_out)
        began = time.process_time()
        with torch.inference_mode():
            parts = zip(pictures.split(64), rays.split(64), strict=True)
            predictions, places = zip(*(policy.encode_centre_crops(*part) for part in parts), strict=True)
        points, pixels = labels.points[:, :: len(GRIPPER_POINTS)], labels.pixels[:, :: len(GRIPPER_POINTS)]
        predictions, places = (
            torch.cat(predictions).unflatten(1, (-1, KEYPOINT_SIZE)),
            torch.cat(places)[:, :: len(GRIPPER_POINTS)],
        )
        predicted_points, predicted_headings = predictions[..., :3], predictions[..., -1 - HEADING_SIZE : -1]
        milliseconds = 1e3 * (time.process_time() - began) / len(held_out)
        sides = torch.tensor([config.width, config.height])
        errors = {
            "mm": 1e3 * (predicted_points - points).norm(dim=2),
            "pixels": ((places - pixels) * sides).norm(dim=2),
            "degrees": _heading_error_deg(predicted_headings, labels.headings),
        }
        inside = ((pixels >= 0) & (pixels <= 1)).all(dim=2)
        view_result: dict[str, object] = {
            unit: [_quantiles(values[inside[:, k], k]) for k in range(inside.shape[1])]
            for unit, values in errors.items()
        }
        view_result |= {"ms": round(milliseconds, 2), "training_s": round(seconds)}
        result[view.name] = view_result
        print(f"{view.name}: {view_result}", flush=True)
    print(json.dumps(result))


def _heading_error_deg(predicted: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Error of headings (..., 6) in degrees, modulo half a turn."""
    twice = [torch.atan2(heading[..., 3], heading[..., 2]) for heading in (predicted, true)]
    return torch.rad2deg((twice[0] - twice[1] + torch.pi) % (2 * torch.pi) - torch.pi).abs() / 2


def _quantiles(values: torch.Tensor) -> list[float] | None:
    """Median and 90th percentile."""
    if not len(values):
        return None
    return [round(float(values.quantile(part)), 1) for part in (0.5, 0.9)]


if __name__ == "__main__":
    main()
