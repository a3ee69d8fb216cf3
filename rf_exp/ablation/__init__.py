"""Result rows, statistics, the paper's tables and the report. Never needs torch or a simulator."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
