"""What episodes and rollouts look like: the bridge from simulator, checker and loops to `rf_exp.viz`."""

from rf_exp.recording.episode import EpisodeRecorder, check_result, check_results, orders
from rf_exp.recording.film import RolloutFilm
from rf_exp.recording.rollout import RolloutRecorder

__all__ = [
    "EpisodeRecorder",
    "RolloutFilm",
    "RolloutRecorder",
    "check_result",
    "check_results",
    "orders",
]
