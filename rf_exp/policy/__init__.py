"""Learned policies: architectures as views of one data set, networks, training and rollouts.

Names are imported lazily: an experiment is read without torch, a policy server runs without the suite.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
