"""Rerun recordings of generation and rollouts, figures, films and texts. Nothing else imports rerun.

A `Recorder` writes one file for `rerun FILE`, with its layout (blueprint). Geometry is passed as arrays;
world frame, metres, radians. Entity names and how to view a file: docs/recordings.md. `figures` draws
schedules, `frames` composes pictures with text, `text` formats results as Markdown.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
