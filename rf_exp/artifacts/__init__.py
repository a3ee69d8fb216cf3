"""What every artifact has, whatever is in it: who made it and of what, and that it is whole."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
