"""Robots without a simulator: each a value, and what they have in common.

What is asked for is imported then: a task is read without meshes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
