"""Asset files in the layout of the authors' release, made from the suite's own meshes and points."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rf_exp.tasks import assets
from rf_exp.tasks.assets import Asset
from rf_exp.tasks.assets.__main__ import visible_scene
from rf_exp.tasks.assets.asset.annotated import HAND_ROTATION
from rf_exp.tasks.assets.asset.released import Source
from rf_exp.transforms import Matrix, inverse, transform

SCALES = {"barrier": (0.6, 0.6, 0.2), "steak": (0.08, 0.4, 0.08)}  # all others have one scale for all axes
SCALE = 0.1
LISTS = "contact_points_pose", "functional_matrix", "target_pose"
RAISED_M = 0.03  # height of the origin of an actor above the table
ROOT = Rotation.from_euler("xyz", (np.pi / 2, 0.0, -np.pi / 2))  # as in URDFs of upright meshes
URDF = """<robot name="thing">
<link name="base"/>
<joint name="root" type="fixed">
  <origin xyz="0 0 0" rpy="{rpy}"/><parent link="base"/><child link="still"/>
</joint>
<link name="still"><visual><geometry><mesh filename="still.glb"/></geometry></visual></link>
<link name="moves">
  <visual><origin xyz="{back}"/><geometry><mesh filename="moves.glb"/></geometry></visual>
</link>
<joint name="opens" type="{kind}">
  <origin xyz="{at}"/><parent link="still"/><child link="moves"/>
  <axis xyz="{axis}"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>
</joint>
</robot>
"""


def write(folder: Path, like: str, bearer: str | None = None, seat_m: float = 0.0) -> None:
    """Writes the files of asset `like`; with a bearer, a URDF in which `like` moves, `seat_m` above it."""
    source, scale = assets.release_sources()[like], np.array(SCALES.get(like, (SCALE,) * 3))
    path = folder / "objects" / source.mesh
    path.parent.mkdir(parents=True, exist_ok=True)
    world_from_actor = transform(
        (0, 0, RAISED_M), Rotation.from_quat(source.standing_wxyz, scalar_first=True)
    )
    main_asset = assets.load(like)
    annotation: dict[str, Any] = {
        "scale": scale.tolist(),
        "center": [0.0, 0.0, 0.0],
        **{key: [] for key in LISTS},
    }
    parts = {like: (main_asset, inverse(world_from_actor))}
    if bearer is not None:
        parts = {bearer: (assets.load(bearer), np.eye(4)), like: (main_asset, transform((0, 0, seat_m)))}
        _write_urdf(path, parts, main_asset, scale)
    else:
        meshes = visible_scene(main_asset)
        meshes.apply_transform(inverse(world_from_actor))
        meshes.apply_transform(np.diag([*(1 / scale), 1.0]))
        meshes.export(path)
    for name, (asset, actor_from_asset) in parts.items():
        _annotate(annotation, assets.release_sources()[name], asset, actor_from_asset, scale)
    (folder / "objects" / source.annotation).write_text(json.dumps(annotation))


def _annotate(
    annotation: dict[str, Any], source: Source, asset: Asset, actor_from_asset: Matrix, scale: Any
) -> None:
    for point, (key, number) in source.points.items():
        x, y, z = asset.points[point].object_from_tcp[:3, :3].T
        pose = asset.points[point].object_from_tcp.copy()
        pose[:3, :3] = np.column_stack([z, y, -x])
        pose = actor_from_asset @ pose @ inverse(HAND_ROTATION)
        pose[:3, 3] /= scale
        annotation[key] += [np.eye(4).tolist()] * (number + 1 - len(annotation[key]))
        annotation[key][number] = pose.tolist()


def _write_urdf(path: Path, parts: Mapping[str, tuple[Asset, Matrix]], moving: Asset, scale: Any) -> None:
    still_from_root = inverse(transform((0, 0, 0), ROOT))
    for file, (asset, actor_from_asset) in zip(("still", "moves"), parts.values(), strict=True):
        meshes = visible_scene(asset)
        meshes.apply_transform(actor_from_asset)
        meshes.apply_transform(np.diag([*(1 / scale), 1.0]))
        meshes.apply_transform(still_from_root)
        meshes.export(path.with_name(f"{file}.glb"))
    at, axis = np.zeros(3), np.array([0.0, 0, 1])
    if moving.hinge is not None:
        _, actor_from_asset = [*parts.values()][1]
        hinge = actor_from_asset @ moving.hinge.object_from_hinge
        at, axis = hinge[:3, 3] / scale, hinge[:3, 1]
    at, axis = (still_from_root[:3, :3] @ each for each in (at, axis))
    values = {name: " ".join(map(str, each)) for name, each in (("at", at), ("axis", axis), ("back", -at))}
    kind = "prismatic" if moving.hinge is None else "revolute"
    path.write_text(URDF.format(rpy=" ".join(map(str, ROOT.as_euler("xyz"))), kind=kind, **values))
