from .episode import EpisodeRecorder as EpisodeRecorder
from .episode import check_result as check_result
from .episode import check_results as check_results
from .episode import orders as orders
from .film import RolloutFilm as RolloutFilm
from .rollout import RolloutRecorder as RolloutRecorder
