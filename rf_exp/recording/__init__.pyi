from .film import RolloutFilm as RolloutFilm
from .film import follow as follow
from .recorders import EpisodeRecorder as EpisodeRecorder
from .recorders import RolloutRecorder as RolloutRecorder
from .recorders import check_result as check_result
from .recorders import check_results as check_results
from .recorders import orders as orders
