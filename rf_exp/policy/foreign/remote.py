"""Remote policy: one on another machine, queried over a connection of `rf_exp.client`."""

from rf_exp.client import Connection
from rf_exp.errors import StageError


class Remote(Connection):
    """Connection of one worker. Every failure of the server raises a StageError."""

    LIMITS = "foreign.connect_s", "foreign.answer_s"

    def _failed(self, how: str) -> StageError:
        return StageError(*super()._failed(how).args)
