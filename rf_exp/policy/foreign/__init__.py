"""Policies of others: what they observe and give, made by a factory or asked of a server: docs/foreign.md.

`spec` is what `conf/` says, `factory` and `remote` are the two ways to a policy, `wire` is how arrays
travel, and `runner` lets it act in the rollouts of the suite.
"""

from typing import TYPE_CHECKING

from rf_exp.late import late

if TYPE_CHECKING:
    from rf_exp.policy.foreign.factory import make_policy
    from rf_exp.policy.foreign.runner import foreign_runners
    from rf_exp.policy.foreign.spec import Foreign, foreign_policy
    from rf_exp.policy.foreign.wire import pack, unpack
else:
    __getattr__ = late(
        __name__,
        {
            "factory": ("make_policy",),
            "runner": ("foreign_runners",),
            "spec": ("Foreign", "foreign_policy"),
            "wire": ("pack", "unpack"),
        },
    )

__all__ = ["Foreign", "foreign_policy", "foreign_runners", "make_policy", "pack", "unpack"]
