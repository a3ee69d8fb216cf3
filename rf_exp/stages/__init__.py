"""The stages of an experiment. Each reads and writes artifacts below `out` and skips what is there.

An artifact made from another configuration is never reused and never overwritten: the stage stops
and names what differs. Jobs that want the same artifact at the same time wait for one another.
"""

from rf_exp.stages.artifacts import check_cameras, check_folders, owned
from rf_exp.stages.cell import Cell, cells
from rf_exp.stages.costs import say_how_long
from rf_exp.stages.evaluation import evaluate_policies
from rf_exp.stages.generation import generate_data, why_seeds_failed
from rf_exp.stages.redrawing import redraw
from rf_exp.stages.reporting import write_tables
from rf_exp.stages.training import train_policies

__all__ = [
    "Cell",
    "cells",
    "check_cameras",
    "check_folders",
    "evaluate_policies",
    "generate_data",
    "owned",
    "redraw",
    "say_how_long",
    "train_policies",
    "why_seeds_failed",
    "write_tables",
]
