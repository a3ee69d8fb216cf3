from .suite import LAWS as LAWS
from .suite import Law as Law
from .suite import check_task as check_task
