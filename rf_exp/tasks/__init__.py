"""Tasks and their assets: geometry, plans and success criteria. Independent of the simulator.

`assets` holds the objects on the table, `predicates` the building blocks of success criteria, `shared` code
that several tasks have in common.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
