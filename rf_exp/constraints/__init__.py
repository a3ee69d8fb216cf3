"""Compositional constraints: interfaces (logical, spatial, temporal) and RoboChecker.

Geometry and time only: no simulator, no learning. Start at `checker`. `stl` has the checks in signal temporal
logic.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
