"""`python -m rf_exp_client`: the same as the command `rf_exp-client`."""

import sys

from .client.__main__ import main

sys.exit(main())
