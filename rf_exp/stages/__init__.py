"""The stages of an experiment. Each reads and writes artifacts below `out` and skips finished ones.

An artifact made from another configuration is never reused and never overwritten: the stage stops
and names what differs. Jobs that want the same artifact at the same time wait for one another. Modules are
imported on first use, so that processes that make demonstrations start without the networks.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
