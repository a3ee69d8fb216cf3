"""Configuration keys that are known, and checks of the command line before Hydra reads it.

An unknown key would be ignored, so it is refused, with the nearest known one.
"""

from rf_exp.keys.arguments import checked_arguments, checked_folder
from rf_exp.keys.help import keys_help
from rf_exp.keys.refusal import RENAMED, refuse_unknown_keys, unknown_key_message

__all__ = [
    "RENAMED",
    "checked_arguments",
    "checked_folder",
    "keys_help",
    "refuse_unknown_keys",
    "unknown_key_message",
]
