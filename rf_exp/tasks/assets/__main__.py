"""Prints the annotation of a built-in asset, as a template for a user's own.

python -m rf_exp.tasks.assets shoe --mesh shoe.glb > shoe.yaml
"""

import argparse
import sys
from pathlib import Path

import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from rf_exp.errors import ArgumentError
from rf_exp.progress import console, error_console
from rf_exp.tasks import assets
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.assets.asset import mesh


def visible_scene(asset: Asset) -> trimesh.Scene:
    """The visible parts of an asset as a scene of coloured meshes."""
    meshes = trimesh.Scene()
    for part in asset.parts:
        if part.visible:
            material = PBRMaterial(baseColorFactor=[*part.colour, 1.0])
            mesh = trimesh.Trimesh(part.mesh.vertices, part.mesh.faces, process=False)
            mesh.visual = TextureVisuals(material=material)
            meshes.add_geometry(mesh)
    return meshes


def main() -> int:
    parser = argparse.ArgumentParser("python -m rf_exp.tasks.assets", description=__doc__)
    parser.add_argument("asset", help=f"one of {', '.join(assets.available())}")
    parser.add_argument("--mesh", type=Path, help="a .glb file to write the mesh to as well")
    arguments = parser.parse_args()
    if arguments.mesh and arguments.mesh.suffix != ".glb":
        parser.error(f"argument --mesh: {arguments.mesh}; expected a name that ends in .glb")
    try:
        asset = assets.load(arguments.asset)
    except ArgumentError as error:
        error_console.print(str(error))
        return 2
    if arguments.mesh:
        visible_scene(asset).export(arguments.mesh)
    name = arguments.mesh.name if arguments.mesh else f"{arguments.asset}.glb"
    console.print(mesh.write(asset, name), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
