"""Rerun recordings of generation and rollouts, figures, films and texts. Nothing else imports rerun.

One `Recorder` writes one file that `rerun FILE` opens well laid out: the layout (blueprint) is in
the file. All geometry is handed in as arrays; world frame, metres, radians. What the entities are
called and how to look at a file: docs/recordings.md. `figures` draws schedules, `frames` lays pictures out
with words, `text` says things in Markdown.
"""

from rf_exp.viz import figures, frames, text
from rf_exp.viz.elements import Mesh
from rf_exp.viz.film import Film
from rf_exp.viz.layout import (
    HOLDS,
    VIOLATED,
    Panels,
    agent_colour,
    camera_entity,
    link_entity,
    object_entity,
)
from rf_exp.viz.recorder import Recorder

__all__ = [
    "HOLDS",
    "VIOLATED",
    "Film",
    "Mesh",
    "Panels",
    "Recorder",
    "agent_colour",
    "camera_entity",
    "figures",
    "frames",
    "link_entity",
    "object_entity",
    "text",
]
