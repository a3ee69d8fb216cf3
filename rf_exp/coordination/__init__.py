"""Coordination of agents: shortest schedules on fixed paths under constraints, and assignment of jobs.

`Demands` are cells of coordination diagrams; `schedule` finds a proven shortest schedule, or returns a
violation that says why there is none; `sequential` lets agents take turns. `assign` gives jobs to agents,
before there are paths.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
