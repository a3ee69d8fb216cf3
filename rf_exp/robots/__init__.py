"""The robot without a simulator."""

from rf_exp.robots.panda import LINKS, Panda, hulls, limits_rad, link_poses, tcp_pose

__all__ = ["LINKS", "Panda", "hulls", "limits_rad", "link_poses", "tcp_pose"]
