"""The four architectures as views of one data set, their diffusion policy, training and rollout.

What is asked for is imported then: an experiment is read without torch, a server of policies runs without the
suite.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
