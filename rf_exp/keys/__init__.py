"""The keys that a configuration may have, and arguments before Hydra reads them.

Any other key would be ignored, so it is refused, with its nearest.
"""

from rf_exp.keys.arguments import arranged, checked_folder
from rf_exp.keys.refusal import RENAMED, not_among_files, refuse_unknown_keys
from rf_exp.keys.told import keys_told

__all__ = ["RENAMED", "arranged", "checked_folder", "keys_told", "not_among_files", "refuse_unknown_keys"]
