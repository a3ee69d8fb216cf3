"""The one simulation: ManiSkill behind arrays and frozen values. Only this package imports it."""

from rf_exp.sim.vulkan import select_driver

select_driver()  # before SAPIEN is imported, or it would not know the software driver

from rf_exp.sim.simulator import Limited, Simulator  # noqa: E402

__all__ = ["Limited", "Simulator"]
