"""Pictures and films of expert episodes: `python -m rf_exp.gallery task=all out=outputs`."""

from rf_exp.gallery.performance import play

__all__ = ["play"]
