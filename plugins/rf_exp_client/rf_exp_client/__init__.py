"""Server of a robot policy for rf_exp; see `rf_exp_client.client` and docs/serving.md."""

from .client import *  # noqa: F403
from .client import __all__ as __all__
