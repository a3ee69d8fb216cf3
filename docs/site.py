"""Hook of mkdocs (mkdocs.yml): adds a page for each file of the repository that a document links to.

In the repository such links lead to the files themselves.
"""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
OUTSIDE = re.compile(r"\]\(\.\./([\w./-]+)\)")  # relative to docs/, where all documents with such links are
LEXERS = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".sh": "sh"}
TITLE = "---\ntitle: {name}\nsearch:\n  exclude: true\n---\n\n# `{name}`\n\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages. A link to a missing file gets none, and fails the build."""
    for document in list(files.documentation_pages()):
        for name in OUTSIDE.findall(document.content_string):
            if (ROOT / name).is_file() and files.get_file_from_path(_page(name)) is None:
                files.append(File.generated(config, _page(name), content=_content(name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrites links to such files as links to their pages."""

    def rewrite_link(link: re.Match[str]) -> str:
        return f"]({_page(link[1])})" if files.get_file_from_path(_page(link[1])) else link[0]

    return OUTSIDE.sub(rewrite_link, markdown)


def _page(name: str) -> str:
    return f"source/{name}.md"


def _content(name: str) -> str:
    lexer = LEXERS.get(Path(name).suffix, "text")
    return f"{TITLE.format(name=name)}````{lexer}\n{(ROOT / name).read_text('utf-8')}````\n"
