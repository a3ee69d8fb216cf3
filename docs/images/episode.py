"""Writes the pictures of docs/one_episode.md, from the output of `rf_exp.demonstration`:

python -m rf_exp.demonstration task=place_food "picture={width: 640, height: 480}"
python docs/images/episode.py outputs/demonstrations/place_food-0
"""

import argparse
import shutil
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent / "episode"
FIGURES = {"round-1-lanes.png": "lanes.png", "round-1-diagrams.png": "diagram.png"}
PHASES = ("phase-1.2.jpg", "phase-1.3.jpg", "phase-1.4.jpg", "end.jpg")
TILE_PX, GAP_PX = (480, 360), 8
QUALITY = 85  # of JPEG


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of pictures, beside the page")
    folder: Path = parser.parse_args().folder
    HERE.mkdir(exist_ok=True)
    for name, kept in FIGURES.items():
        shutil.copyfile(folder / name, HERE / kept)
    width, height = TILE_PX
    joined = Image.new("RGB", (2 * width + GAP_PX, 2 * height + GAP_PX), "white")
    for place, name in enumerate(PHASES):
        row, column = divmod(place, 2)
        at = column * (width + GAP_PX), row * (height + GAP_PX)
        joined.paste(Image.open(folder / name).resize(TILE_PX, Image.Resampling.LANCZOS), at)
    joined.save(HERE / "phases.jpg", quality=QUALITY)


if __name__ == "__main__":
    main()
