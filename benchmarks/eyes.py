"""How many millimetres the heat maps are off, and how many milliseconds they take, on seeds they never saw.

    python benchmarks/eyes.py [outputs/data/lift_barrier/full/fast.zarr] [--train 40] [--steps 500]

Trains the eyes of every agent's own camera on the first episodes of a store and looks at the rest: the
distance between where an own gripper changes next (or the episode ends, or another arm is) and where the eyes
say so, at every frame before that in which it is in the picture and the agent may go on. The last line is
JSON: by agent median and 90th percentile in mm for each keypoint, milliseconds a picture, and CPU seconds of
training.
"""

import argparse
import json
import time
from pathlib import Path

import torch

from rf_exp.policy import PolicyConfig, TrainConfig, Training, Windows, views
from rf_exp.policy.examples.keypoints import HAND, HEADING
from rf_exp.policy.networks.keypoint_encoder import OUT
from rf_exp.store import Store
from rf_exp.types import Arch

DEMO = Path("outputs/data/lift_barrier/full/fast.zarr")
CPU = torch.device("cpu")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path, nargs="?", default=DEMO, help="of the demo, unless said")
    parser.add_argument("--train", type=int, default=40, help="episodes")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--going", type=float, default=0.5, help="part of the pictures in which it may go on")
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--shrink", type=int, default=1, help="times, of the picture that heat maps cover")
    parser.add_argument("--close-up", type=int, default=0, help="pixels, side of the squares looked at again")
    parser.add_argument("--shift", type=int, default=0, help="pixels, of the pictures that are learned from")
    given = parser.parse_args()
    torch.set_num_threads(1)
    store = Store.open(given.store)
    size = {"height": store.attrs["height"], "width": store.attrs["width"]}
    config = PolicyConfig(
        encoder="heatmaps",
        context=True,
        observation_steps=1,
        crop=1.0,
        drop_idle=True,
        shrink=given.shrink,
        close_up=given.close_up,
        **size,
    )
    recipe = TrainConfig(
        epochs=None,
        eyes_steps=given.steps,
        eyes_shift_px=given.shift,
        going=given.going,
        steps=1,
        warmup_steps=50,
        batch_size=given.batch,
        learning_rate=given.rate,
        noise_draws=1,
        run_length=1,
    )
    result: dict[str, object] = {"benchmark": "eyes", "store": str(given.store)}
    for view in views(Arch("separate_local", False, False), store.agents):
        windows, everything = (Windows(each, view, config, CPU) for each in (store.first(given.train), store))
        training, began = Training(windows, view, config, recipe), time.process_time()
        for _ in training.run():
            if training.step == given.steps:
                break
        seconds = time.process_time() - began
        policy = training.averaged()
        policy.lift_eyes(windows.pixels, windows.points)
        unseen = everything.goes[everything.goes >= len(windows)]
        pictures, pixels, headings, _ = everything.marked(unseen)
        points = everything.points[torch.from_numpy(unseen)]
        began = time.process_time()
        with torch.inference_mode():
            seen, places = zip(*(policy.look(part) for part in pictures.split(64)), strict=True)
        points, pixels = (each.unflatten(1, (-1, len(HAND)))[:, :, 0] for each in (points, pixels))
        seen, places = torch.cat(seen).unflatten(1, (-1, OUT)), torch.cat(places)
        found, turned = seen[..., :3], seen[..., -1 - HEADING : -1]
        milliseconds = 1e3 * (time.process_time() - began) / len(unseen)
        sides = torch.tensor([config.width, config.height])
        off = {
            "mm": 1e3 * (found - points).norm(dim=2),
            "pixels": ((places - pixels) * sides).norm(dim=2),
            "degrees": _askew_deg(turned, headings),
        }
        inside = ((pixels >= 0) & (pixels <= 1)).all(dim=2)
        of_view: dict[str, object] = {
            unit: [_said(values[inside[:, k], k]) for k in range(inside.shape[1])]
            for unit, values in off.items()
        }
        of_view |= {"ms": round(milliseconds, 2), "training_s": round(seconds)}
        result[view.name] = of_view
        print(f"{view.name}: {of_view}", flush=True)
    print(json.dumps(result))


def _askew_deg(found: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """How far headings (..., 6) are off, where half a turn is nothing."""
    twice = [torch.atan2(each[..., 3], each[..., 2]) for each in (found, true)]
    return torch.rad2deg((twice[0] - twice[1] + torch.pi) % (2 * torch.pi) - torch.pi).abs() / 2


def _said(values: torch.Tensor) -> list[float] | None:
    """Median and 90th percentile."""
    if not len(values):
        return None
    return [round(float(values.quantile(part)), 1) for part in (0.5, 0.9)]


if __name__ == "__main__":
    main()
