"""Collision geometry: convex pieces, planning scene, exact clearance, occupancy.

Arms and objects consist of convex `Piece`s. The `PlanningScene` of a task combines them to `Swept` bodies
with allowed contacts. `closer_than` returns the coordination diagram of two bodies, `nearest` and `overlap`
their distance. World frame, metres.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
