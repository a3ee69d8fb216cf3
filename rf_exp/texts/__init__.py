"""Sanitising of untrusted text for display: `plain` text, and `markdown`.

Relative imports: `rf_exp-client` packages these files under its own name.
"""

from . import markdown
from .plain import LONGEST_ERROR, LONGEST_LINE, one_line, printable, shown, visible

__all__ = ["LONGEST_ERROR", "LONGEST_LINE", "markdown", "one_line", "printable", "shown", "visible"]
