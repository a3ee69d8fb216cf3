"""Gallery: pictures and films of expert episodes, `python -m rf_exp.gallery task=all out=outputs`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
