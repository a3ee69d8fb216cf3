from .suite import LAWS as LAWS
from .suite import Law as Law
from .suite import judged as judged
