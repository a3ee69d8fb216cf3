"""Jobs on external engines: joblib's loky, Dask, Ray, and batch jobs by submitit.

The engine decides when and where a job runs.
"""

from rf_exp.launch.engines import LOCAL, Launch
from rf_exp.launch.running import results

__all__ = ["LOCAL", "Launch", "results"]
