"""Jobs that run elsewhere, on engines that exist: joblib's loky, Dask, Ray, and batch jobs by submitit.

An engine is one module with one function, `connected`; what it gives takes a job and says how it stands. Who
runs which job when, and where, is the engine's affair.
"""

from rf_exp.launch.running import results
from rf_exp.launch.spec import HERE, Launch

__all__ = ["HERE", "Launch", "results"]
