"""docs/policies.md says what the rows in results/evaluate say."""

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_document_is_what_its_script_writes() -> None:
    written = runpy.run_path(str(DOCS / "policies.py"))["document"]()
    assert (DOCS / "policies.md").read_text("utf-8") == written, "run: python docs/policies.py"
