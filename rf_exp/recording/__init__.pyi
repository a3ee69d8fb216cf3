from .film import RolloutFilm as RolloutFilm
from .film import show_measured_state as show_measured_state
from .recorders import EpisodeRecorder as EpisodeRecorder
from .recorders import RolloutRecorder as RolloutRecorder
from .recorders import check_result as check_result
from .recorders import check_results as check_results
from .recorders import order_masks as order_masks
