"""The four architectures as views of one data set, their diffusion policy, training and rollout.

What is asked for is imported then: an experiment is read without torch, a server of policies runs without the
suite.
"""

from typing import TYPE_CHECKING

from rf_exp.late import late

if TYPE_CHECKING:
    from rf_exp.policy.acting.diffusion_runner import DiffusionRunner, load_runners
    from rf_exp.policy.acting.rollouts import rollout
    from rf_exp.policy.acting.runner import PolicyRunner
    from rf_exp.policy.acting.shield import SHIELD_VERSION, Decision, Shield
    from rf_exp.policy.bounds import bounded, one_of
    from rf_exp.policy.config import (
        LEARNER,
        EncoderConfig,
        HeadConfig,
        PolicyConfig,
        TrainConfig,
        add_encoder,
        add_head,
        import_code,
        policy_keys,
        read_recipe,
    )
    from rf_exp.policy.examples.windows import Batch, Windows
    from rf_exp.policy.foreign import (
        Foreign,
        foreign_policy,
        foreign_runners,
        make_policy,
        pack,
        unpack,
    )
    from rf_exp.policy.inputs.coordination import sent_on
    from rf_exp.policy.inputs.view import Stream, View, views
    from rf_exp.policy.learning.checkpoint import (
        CURVES,
        MODEL,
        device_of,
        expect_policy,
        load_policy,
        made_of,
        write_small,
    )
    from rf_exp.policy.learning.curves import Curve, cost_s
    from rf_exp.policy.learning.training import Training, train
    from rf_exp.policy.networks.interfaces import Encoder, Fit, Head
    from rf_exp.policy.networks.layers import hidden
    from rf_exp.policy.networks.policy import Policy
    from rf_exp.policy.networks.unet import ConditionalUNet1D
else:
    __getattr__ = late(
        __name__,
        {
            "acting.diffusion_runner": ("DiffusionRunner", "load_runners"),
            "acting.rollouts": ("rollout",),
            "acting.runner": ("PolicyRunner",),
            "acting.shield": ("SHIELD_VERSION", "Decision", "Shield"),
            "bounds": ("bounded", "one_of"),
            "config": (
                "LEARNER",
                "EncoderConfig",
                "HeadConfig",
                "PolicyConfig",
                "TrainConfig",
                "add_encoder",
                "add_head",
                "import_code",
                "policy_keys",
                "read_recipe",
            ),
            "examples.windows": ("Batch", "Windows"),
            "foreign": (
                "Foreign",
                "foreign_policy",
                "foreign_runners",
                "make_policy",
                "pack",
                "unpack",
            ),
            "inputs.coordination": ("sent_on",),
            "inputs.view": ("Stream", "View", "views"),
            "learning.checkpoint": (
                "CURVES",
                "MODEL",
                "device_of",
                "expect_policy",
                "load_policy",
                "made_of",
                "write_small",
            ),
            "learning.curves": ("Curve", "cost_s"),
            "learning.training": ("Training", "train"),
            "networks.interfaces": ("Encoder", "Fit", "Head"),
            "networks.layers": ("hidden",),
            "networks.policy": ("Policy",),
            "networks.unet": ("ConditionalUNet1D",),
        },
    )

__all__ = [
    "CURVES",
    "LEARNER",
    "MODEL",
    "SHIELD_VERSION",
    "Batch",
    "ConditionalUNet1D",
    "Curve",
    "Decision",
    "DiffusionRunner",
    "Encoder",
    "EncoderConfig",
    "Fit",
    "Foreign",
    "Head",
    "HeadConfig",
    "Policy",
    "PolicyConfig",
    "PolicyRunner",
    "Shield",
    "Stream",
    "TrainConfig",
    "Training",
    "View",
    "Windows",
    "add_encoder",
    "add_head",
    "bounded",
    "cost_s",
    "device_of",
    "expect_policy",
    "foreign_policy",
    "foreign_runners",
    "hidden",
    "import_code",
    "load_policy",
    "load_runners",
    "made_of",
    "make_policy",
    "one_of",
    "pack",
    "policy_keys",
    "read_recipe",
    "rollout",
    "sent_on",
    "train",
    "unpack",
    "views",
    "write_small",
]
