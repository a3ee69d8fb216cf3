"""The four architectures as views of one data set, their diffusion policy, training and rollout.

What is asked for is imported then: an experiment is read without torch, a server of policies runs without the
suite.
"""

from typing import TYPE_CHECKING

from rf_exp.late import late

if TYPE_CHECKING:
    from rf_exp.policy.config import LEARNER, PolicyConfig, TrainConfig
    from rf_exp.policy.coordination import sent_on
    from rf_exp.policy.curves import Curve, cost_s
    from rf_exp.policy.dataset import Batch, Windows
    from rf_exp.policy.diffusion import DiffusionPolicy
    from rf_exp.policy.diffusion_runner import DiffusionRunner, load_runners
    from rf_exp.policy.foreign import (
        Foreign,
        foreign_policy,
        foreign_runners,
        make_policy,
        pack,
        unpack,
    )
    from rf_exp.policy.rollouts import rollout
    from rf_exp.policy.runner import PolicyRunner
    from rf_exp.policy.saved import (
        CURVES,
        MODEL,
        device_of,
        expect_policy,
        load_policy,
        made_of,
        write_small,
    )
    from rf_exp.policy.shield import SHIELD_VERSION, Decision, Shield
    from rf_exp.policy.training import Training, train
    from rf_exp.policy.view import Stream, View, views
else:
    __getattr__ = late(
        __name__,
        {
            "config": ("LEARNER", "PolicyConfig", "TrainConfig"),
            "coordination": ("sent_on",),
            "curves": ("Curve", "cost_s"),
            "dataset": ("Batch", "Windows"),
            "diffusion": ("DiffusionPolicy",),
            "diffusion_runner": ("DiffusionRunner", "load_runners"),
            "foreign": (
                "Foreign",
                "foreign_policy",
                "foreign_runners",
                "make_policy",
                "pack",
                "unpack",
            ),
            "rollouts": ("rollout",),
            "runner": ("PolicyRunner",),
            "saved": (
                "CURVES",
                "MODEL",
                "device_of",
                "expect_policy",
                "load_policy",
                "made_of",
                "write_small",
            ),
            "shield": ("SHIELD_VERSION", "Decision", "Shield"),
            "training": ("Training", "train"),
            "view": ("Stream", "View", "views"),
        },
    )

__all__ = [
    "CURVES",
    "LEARNER",
    "MODEL",
    "SHIELD_VERSION",
    "Batch",
    "Curve",
    "Decision",
    "DiffusionPolicy",
    "DiffusionRunner",
    "Foreign",
    "PolicyConfig",
    "PolicyRunner",
    "Shield",
    "Stream",
    "TrainConfig",
    "Training",
    "View",
    "Windows",
    "cost_s",
    "device_of",
    "expect_policy",
    "foreign_policy",
    "foreign_runners",
    "load_policy",
    "load_runners",
    "made_of",
    "make_policy",
    "pack",
    "rollout",
    "sent_on",
    "train",
    "unpack",
    "views",
    "write_small",
]
