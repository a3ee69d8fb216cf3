"""Configuration keys that are known, and checks of the command line before Hydra reads it.

An unknown key would be ignored, so it is refused, with the nearest known one.
"""

from rf_exp.keys.arguments import arranged, checked_folder
from rf_exp.keys.refusal import RENAMED, not_among_files, refuse_unknown_keys
from rf_exp.keys.told import keys_told

__all__ = ["RENAMED", "arranged", "checked_folder", "keys_told", "not_among_files", "refuse_unknown_keys"]
