"""What fills space and how near it comes: convex pieces, the planning scene, exact clearance, occupancy.

Arms and objects are convex `Piece`s. The `PlanningScene` of a task makes `Swept` bodies of them, with allowed
contacts. `closer_than` gives the coordination diagram of two of these, `nearest` and `overlap` their
distance. World frame, metres.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
