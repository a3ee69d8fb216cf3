"""Tests. rf_exp is imported first because it selects NumPy's kernels, which must precede importing NumPy."""

import rf_exp as rf_exp
