"""Rerun recordings of generation and rollouts, figures, films and texts. Nothing else imports rerun.

One `Recorder` writes one file that `rerun FILE` opens well laid out: the layout (blueprint) is in
the file. All geometry is handed in as arrays; world frame, metres, radians. What the entities are
called and how to look at a file: docs/recordings.md. `figures` draws schedules, `frames` lays pictures out
with words, `text` says things in Markdown.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
