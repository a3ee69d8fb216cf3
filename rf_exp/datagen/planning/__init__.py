"""Checked plans: what a planner sees, what a proposal may take, and how a plan is made of it."""

from rf_exp.datagen.planning.planner import Planned, Planner, Settings

__all__ = ["Planned", "Planner", "Settings"]
