"""docs/tasks.md says what the configuration and the modules say."""

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_document_is_what_its_script_writes() -> None:
    written = runpy.run_path(str(DOCS / "tasks.py"))["document"]()
    assert (DOCS / "tasks.md").read_text("utf-8") == written, "run: python docs/tasks.py"
