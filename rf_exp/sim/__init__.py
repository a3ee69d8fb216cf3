"""Simulator: ManiSkill behind arrays and frozen values. Only this package imports ManiSkill.

Names are imported lazily: a process that only starts simulating processes never imports ManiSkill.
"""

import lazy_loader

import rf_exp.sim.vulkan as vulkan

vulkan.select_driver()  # before SAPIEN is imported, or it would not find the software driver

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
