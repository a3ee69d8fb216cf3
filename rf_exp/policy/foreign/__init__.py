"""Policies of others: what they are told and give, made by a factory or asked of a server: docs/foreign.md.

`spec` is what `conf/` says, `factory` and `remote` are the two ways to a policy, `wire` is how arrays
travel, and `runner` lets it act in the rollouts of the suite.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
