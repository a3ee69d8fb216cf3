"""The one simulation: ManiSkill behind arrays and frozen values. Only this package imports it.

What is asked for is imported then: who starts processes that simulate does without ManiSkill.
"""

import lazy_loader

import rf_exp.sim.vulkan as vulkan

vulkan.select_driver()  # before SAPIEN is imported, or it would not know the software driver

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
