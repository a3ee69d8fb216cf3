from .show import demonstrate as demonstrate
