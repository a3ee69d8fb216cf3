"""Jobs that run elsewhere, on engines that exist: joblib's loky, Dask, Ray, and batch jobs by submitit.

Who runs which job when, and where, is the engine's affair.
"""

from rf_exp.launch.engines import HERE, Launch
from rf_exp.launch.running import results

__all__ = ["HERE", "Launch", "results"]
