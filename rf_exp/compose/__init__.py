"""A task from a sentence: what it says (`sentence`), where things stand (`layout`), and its two files.

No language model is needed, and one may word it (`wording`). docs/compose.md.
"""

from rf_exp.compose.composing import Composed, compose, things_of, written

__all__ = ["Composed", "compose", "things_of", "written"]
