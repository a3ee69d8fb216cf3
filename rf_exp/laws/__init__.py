"""The laws of the suite (`suite`): invariants of every task, checked by the command and by the tests.

Names are imported lazily, so that the command's help does not import the simulator.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
