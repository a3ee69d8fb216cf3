"""The one simulation: ManiSkill behind arrays and frozen values. Only this package imports it."""

from rf_exp.sim.vulkan import COSTS, render_probe, select_driver

select_driver()  # before SAPIEN is imported, or it would not know the software driver

from rf_exp.sim.environment import FAR_M  # noqa: E402
from rf_exp.sim.simulator import (  # noqa: E402
    Limited,
    Simulator,
    close_shared_simulator,
    depth_and_segmentation,
    shared_simulator,
)
from rf_exp.sim.stock import Arm, Stepped, Stock  # noqa: E402

__all__ = [
    "COSTS",
    "FAR_M",
    "Arm",
    "Limited",
    "Simulator",
    "Stepped",
    "Stock",
    "close_shared_simulator",
    "depth_and_segmentation",
    "render_probe",
    "shared_simulator",
]
