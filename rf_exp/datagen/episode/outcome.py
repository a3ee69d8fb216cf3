"""What became of a seed."""

from dataclasses import dataclass, field

from rf_exp.findings import Account
from rf_exp.types import Episode


@dataclass(frozen=True)
class Outcome:
    """What became of one seed. `episode` is there for successes only."""

    seed: int
    success: bool
    success_paper: bool
    steps: int
    attempts: int  # proposals that ended in a violation, plus the last one
    contacts: int  # control steps in which arms touched each other
    wall_s: float
    account: Account = field(
        default_factory=Account
    )  # which violations ended proposals, which arms touched, what failed
    episode: Episode | None = None

    @property
    def violations(self) -> int:
        """Proposals that ended in a violation."""
        return len(self.account.rejections)

    @property
    def reason(self) -> str:
        """Why it failed, in words; empty for a success."""
        return "" if self.success else self.account.reason
