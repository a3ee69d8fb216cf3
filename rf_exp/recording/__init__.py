"""Films and recordings of episodes and rollouts: from simulator, checker and loops to `rf_exp.viz`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
