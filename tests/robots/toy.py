"""A small arm with six joints and a two-finger gripper, from a URDF that is generated here."""

from pathlib import Path

import numpy as np

from rf_exp.robots import Finger, Hand, Robot

DOWN = np.pi  # rad; sum of the second, third and fifth joints when the tool points down


def _link(name: str, shape: str = "", z_m: float = 0.0, y_m: float = 0.0) -> str:
    if not shape:
        return f'<link name="{name}"/>'
    piece = f'<origin xyz="0 {y_m} {z_m}" rpy="0 0 0"/><geometry><{shape}/></geometry>'
    return f'<link name="{name}"><visual>{piece}</visual><collision>{piece}</collision></link>'


def _joint(name: str, kind: str, parent: str, child: str, z_m: float, axis: str, limits: tuple) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {z_m}" rpy="0 0 0"/><axis xyz="{axis}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="80" velocity="3"/></joint>'
    )


JOINTS = (  # height above the previous joint, axis, limits, shape of the next link and its height
    (0.1, "0 0 1", (-2.9, 2.9), 'cylinder radius="0.05" length="0.16"', 0.08),
    (0.2, "0 1 0", (-1.9, 1.9), 'box size="0.07 0.07 0.36"', 0.2),
    (0.4, "0 1 0", (-2.7, 2.7), 'box size="0.06 0.06 0.16"', 0.1),
    (0.2, "0 0 1", (-2.9, 2.9), 'cylinder radius="0.03" length="0.14"', 0.1),
    (0.2, "0 1 0", (-2.6, 2.6), 'sphere radius="0.03"', 0.0),
    (0.06, "0 0 1", (-2.9, 2.9), 'box size="0.05 0.16 0.03"', 0.02),
)


def urdf() -> str:
    """The URDF with `base`, `link1` to `link6`, fingers `left` and `right`, and the frame `tcp`."""
    parts = [_link("base", 'cylinder radius="0.06" length="0.1"', 0.05)]
    parent = "base"
    for k, (z_m, axis, limits, shape, at_m) in enumerate(JOINTS, start=1):
        parts += [_link(f"link{k}", shape, at_m)]
        parts += [_joint(f"turn{k}", "revolute", parent, f"link{k}", z_m, axis, limits)]
        parent = f"link{k}"
    for side, sign in (("left", 1), ("right", -1)):
        parts += [_link(side, 'box size="0.02 0.01 0.08"', 0.05, 0.005 * sign)]
        parts += [_joint(f"slide_{side}", "prismatic", parent, side, 0.05, f"0 {sign} 0", (0.0, 0.04))]
    parts += [_link("tcp"), _joint("fixed", "fixed", parent, "tcp", 0.13, "0 0 1", (0, 0))]
    return f'<robot name="toy">{"".join(parts)}</robot>'


def toy(folder: Path, name: str = "toy") -> Robot:
    """The robot, with its URDF written to `folder`."""
    path = folder / f"{name}.urdf"
    path.write_text(urdf())
    return Robot(
        name=name,
        title="toy with six joints",
        urdf=path,
        joints=tuple(f"turn{k}" for k in range(1, 7)),
        hand=Hand(
            link="link6",
            tcp="tcp",
            fingers=(
                Finger("left", ("slide_left",), opens=(0.0, 1.0, 0.0)),
                Finger("right", ("slide_right",), opens=(0.0, -1.0, 0.0)),
            ),
            open_m=0.04,
            pressed_m=-0.01,
            target_m=(0.0, 0.0, 0.13),
        ),
        rest_rad=(0.0, 0.2, 1.6, 0.0, DOWN - 1.8, 0.0),
        aside_rad=(0.0, -0.9, 2.3, 0.0, DOWN - 1.4, 0.0),
        reach_m=0.8,
    )
