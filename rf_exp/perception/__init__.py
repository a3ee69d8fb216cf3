"""What depth cameras see of a scene: occupied voxels, and the obstacles that they make."""

from rf_exp.perception.depth import look
from rf_exp.perception.obstacles import SEEN, Seen, down_to_table, together

__all__ = ["SEEN", "Seen", "down_to_table", "look", "together"]
