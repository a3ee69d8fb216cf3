"""The keys that a configuration may have, and arguments before Hydra reads them.

Any other key would be ignored, so it is refused, with its nearest.
"""

from rf_exp.keys.arguments import arranged, checked_folder
from rf_exp.keys.refusal import RENAMED, keys_are_in, keys_of_files, no_key, refuse_unknown_keys
from rf_exp.keys.told import keys_told

__all__ = [
    "RENAMED",
    "arranged",
    "checked_folder",
    "keys_are_in",
    "keys_of_files",
    "keys_told",
    "no_key",
    "refuse_unknown_keys",
]
