"""Page about one episode: constraints, check code and verdicts in each phase (paper, supplementary A)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
