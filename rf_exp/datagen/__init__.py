"""Generation of checked demonstrations: RoboBrain (`brain`), motion planning, the episode loop.

Names are imported on first use, so that an experiment can be read without kinematics and simulator.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
