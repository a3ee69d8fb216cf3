from .factory import make_policy as make_policy
from .runner import foreign_runners as foreign_runners
from .spec import Foreign as Foreign
from .spec import foreign_policy as foreign_policy
from .wire import pack as pack
from .wire import unpack as unpack
