"""The robot without a simulator."""

from rf_exp.robots.meshes import cache_folder, is_made, light_meshes, light_urdf
from rf_exp.robots.panda import LINKS, Panda, hulls, limits_rad, link_poses, self_pairs, tcp_pose
from rf_exp.robots.postures import BRANCHES, OTHER_SIGN, crossed

__all__ = [
    "BRANCHES",
    "LINKS",
    "OTHER_SIGN",
    "Panda",
    "cache_folder",
    "crossed",
    "hulls",
    "is_made",
    "light_meshes",
    "light_urdf",
    "limits_rad",
    "link_poses",
    "self_pairs",
    "tcp_pose",
]
