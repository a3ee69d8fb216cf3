"""Robots as values, without a simulator.

Names are imported lazily: reading a task does not load meshes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
