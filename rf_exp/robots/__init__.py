"""The robot without a simulator."""

from rf_exp.robots.meshes import light_meshes, light_urdf
from rf_exp.robots.panda import LINKS, Panda, hulls, limits_rad, link_poses, self_pairs, tcp_pose
from rf_exp.robots.postures import BRANCHES, OTHER_SIGN, crossed

__all__ = [
    "BRANCHES",
    "LINKS",
    "OTHER_SIGN",
    "Panda",
    "crossed",
    "hulls",
    "light_meshes",
    "light_urdf",
    "limits_rad",
    "link_poses",
    "self_pairs",
    "tcp_pose",
]
