"""docs/tasks.md agrees with the configuration and the task modules."""

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_document_is_the_output_of_its_script() -> None:
    written = runpy.run_path(str(DOCS / "tasks.py"))["document"]()
    assert (DOCS / "tasks.md").read_text("utf-8") == written, "run: python docs/tasks.py"
