"""What went wrong, as values: violations, and the account of an episode. Sentences are written from them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
