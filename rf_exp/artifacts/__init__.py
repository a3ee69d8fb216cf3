"""Common parts of all artifacts: provenance, atomic writing of files, locks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
