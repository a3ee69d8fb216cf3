"""Generation of checked demonstrations: RoboBrain (`brain`), motion, the loop.

All but RoboBrain is imported once it is asked for: an experiment is read without kinematics and simulator.
"""

from typing import TYPE_CHECKING

from rf_exp.datagen import brain
from rf_exp.late import late

if TYPE_CHECKING:
    from rf_exp.datagen.coordinator import COORDINATOR_VERSION, Coordinator
    from rf_exp.datagen.driving import commands_of, drive, follow
    from rf_exp.datagen.episode import EpisodeMaker
    from rf_exp.datagen.generation import generate, make_episode
    from rf_exp.datagen.motion import (
        Motion,
        Request,
        State,
        Unreachable,
        add_primitive,
        as_commanded,
    )
    from rf_exp.datagen.observer import NullObserver, Observer
    from rf_exp.datagen.outcome import Outcome
    from rf_exp.datagen.planning import Planned, Planner, Settings
    from rf_exp.datagen.trace import Trace
    from rf_exp.datagen.version import GENERATOR, generator_version
else:
    __getattr__ = late(
        __name__,
        {
            "coordinator": ("COORDINATOR_VERSION", "Coordinator"),
            "driving": ("commands_of", "drive", "follow"),
            "episode": ("EpisodeMaker",),
            "generation": ("generate", "make_episode"),
            "motion": (
                "Motion",
                "Request",
                "State",
                "Unreachable",
                "add_primitive",
                "as_commanded",
            ),
            "observer": ("NullObserver", "Observer"),
            "outcome": ("Outcome",),
            "planning": ("Planned", "Planner", "Settings"),
            "trace": ("Trace",),
            "version": ("GENERATOR", "generator_version"),
        },
    )

__all__ = [
    "COORDINATOR_VERSION",
    "GENERATOR",
    "Coordinator",
    "EpisodeMaker",
    "Motion",
    "NullObserver",
    "Observer",
    "Outcome",
    "Planned",
    "Planner",
    "Request",
    "Settings",
    "State",
    "Trace",
    "Unreachable",
    "add_primitive",
    "as_commanded",
    "brain",
    "commands_of",
    "drive",
    "follow",
    "generate",
    "generator_version",
    "make_episode",
]
