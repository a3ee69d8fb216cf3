"""Generation of checked demonstrations: RoboBrain (`brain`), motion, the loop.

What is asked for is imported then: an experiment is read without kinematics and simulator.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
