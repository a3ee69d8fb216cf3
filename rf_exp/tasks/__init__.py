"""Tasks and their assets: geometry, plans and success criteria. Knows no simulator.

`assets` has what stands on the table, `predicates` what the success of a task is made of, `shared` what
several tasks do alike.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
