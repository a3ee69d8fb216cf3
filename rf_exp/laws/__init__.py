"""The laws of the suite (`suite`), held to tasks by the command and by the tests.

What is asked for is imported then: the command's help does without the simulator.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
