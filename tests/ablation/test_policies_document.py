"""docs/policies.md and the README say what the rows in results/evaluate say."""

import runpy
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_document_is_what_its_script_writes() -> None:
    script = runpy.run_path(str(DOCS / "policies.py"))
    for path, written in ((DOCS / "policies.md", script["document"]), (script["README"], script["readme"])):
        assert path.read_text("utf-8") == written(), "run: python docs/policies.py"
