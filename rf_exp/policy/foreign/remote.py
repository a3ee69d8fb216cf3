"""Remote policy: one on another machine, asked over a connection of `rf_exp.client`."""

from rf_exp.client import Connection
from rf_exp.errors import StageError


class Remote(Connection):
    """One connection, of one worker. Every way in which a server can fail raises a StageError."""

    LIMITS = "foreign.connect_s", "foreign.answer_s"

    def _failed(self, how: str) -> StageError:
        return StageError(*super()._failed(how).args)
