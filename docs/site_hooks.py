"""MkDocs hooks: README, CONTRIBUTING and CHANGELOG of the root as pages of the site, and example files within pages."""

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages."""
    root = Path(config.config_file_path).parent
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=site_links((root / source).read_text(encoding="utf-8"), root)))
    return files


def on_page_markdown(markdown: str, config: MkDocsConfig, **kwargs: Any) -> str:
    """Puts a file's text in the place of a comment that names it, `<!-- file: examples/own_task.py -->`. Raises OSError."""
    root = Path(config.config_file_path).parent

    def text(match: re.Match[str]) -> str:
        return f'```python title="{match[1]}"\n{(root / match[1]).read_text(encoding="utf-8")}```'

    return re.sub(r"^<!-- file: (\S+) -->$", text, markdown, flags=re.MULTILINE)


def site_links(text: str, root: Path) -> str:
    """Links to files in docs/ and to PAGES lead to their pages; those to other files, which the site lacks, become plain text."""

    def replaced(match: re.Match[str]) -> str:
        picture, label, target = match.groups()
        path, _, anchor = target.partition("#")
        if target.startswith("#") or "://" in target:
            return match[0]
        if not (root / path).exists():
            return match[0]  # mkdocs says that it leads nowhere
        if path not in PAGES and not path.startswith("docs/"):
            return label if label == path else f"{label} (`{path}`)"
        return f"{picture}[{label}]({PAGES.get(path, path.removeprefix('docs/'))}{'#' + anchor if anchor else ''})"

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", replaced, text)
