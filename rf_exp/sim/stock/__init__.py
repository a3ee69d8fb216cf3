"""Environments that somebody else has made, with the shapes of their bodies."""

from rf_exp.sim.stock.environment import Arm, Stepped, Stock

__all__ = ["Arm", "Stepped", "Stock"]
