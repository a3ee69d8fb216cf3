"""When who moves: the shortest schedule of agents on fixed paths, which keeps what is asked of it.

`Demands` are cells of coordination diagrams; `schedule` finds a proven shortest schedule, or says as a
violation why there is none; `sequential` lets agents take turns. `assign` says who does what, before there
are paths.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
