"""The tests. Before any of them loads NumPy, its kernels are chosen."""

import rf_exp as rf_exp
