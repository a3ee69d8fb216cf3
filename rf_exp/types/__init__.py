"""Values passed between the stages: frozen, without behaviour beyond derived numbers.

Agents are numbered from 1 as in the paper (Agent_1); arrays over agents have agent k at index
k - 1. World frame: table top at z = 0. Units: metres, radians, seconds; control steps at 20 Hz.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
