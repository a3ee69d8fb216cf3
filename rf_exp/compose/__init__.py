"""Composes a task from a sentence: its jobs (`sentence`), the layout of the scene (`layout`), its two files.

A language model is optional: it can reword a sentence (`wording`). docs/compose.md.
"""

from rf_exp.compose.composing import Composed, compose, parse_objects, write_files

__all__ = ["Composed", "compose", "parse_objects", "write_files"]
