"""Serve a robot policy to rf_exp; see `rf_exp_client.client` and the document that README.md names."""

from .client import *  # noqa: F403
from .client import __all__ as __all__
