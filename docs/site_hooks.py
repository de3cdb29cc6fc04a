"""MkDocs hooks: README, CONTRIBUTING and CHANGELOG of the root as pages, example files within
pages, and source files that pages name."""

import posixpath
import re
from pathlib import Path
from typing import Any

import generated
import source_comments  # noqa: F401  griffe loads field_comments.py, which needs it, by its path
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
SOURCES = {".py": "python", ".toml": "toml"}
"""Endings of source files that have a page each, and their language."""
FOLDERS = ("examples", "benchmarks", "configs")
BOOSTS = {"how_to/recipes.md": 4, "how_to/controllers.md": 2, "api/": 0.3}
"""Weights in the search, by the beginnings of paths: answers before signatures."""
NOT_SEARCHED = "---\nsearch: {exclude: true}\n---\n"
SOURCE = re.compile(rf"(?:{'|'.join(FOLDERS)})/[\w/]+\.(?:py|toml)")
CELL = re.compile(r"<td>(.*?)</td>", re.DOTALL)
NUMBER = r"(?:\(?-?\d[-+\d.,e–]*[x*%]?\)?,?|/|%,?|to|of|bad)"
"""A number of a table, perhaps in brackets, or what stands between two of them."""
NUMBERS = re.compile(f"{NUMBER}(?: {NUMBER})*")
LONG = 40
"""Characters of a cell from which on it keeps some width on a phone, see site.css."""
FENCE_LINK_OR_CODE = re.compile(
    r"^```.*?^```|(?P<link>\[[^\]]*\])\((?P<target>[^)\s]+)\)|`(?P<path>[\w/]+\.\w+)`",
    re.MULTILINE | re.DOTALL,
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages of the root, the one of what is generated, and one of every source file."""
    root = Path(config.config_file_path).parent
    files.append(File.generated(config, "appendix/generated.md", content=generated.overview()))
    for source, page in PAGES.items():
        text = site_links((root / source).read_text(encoding="utf-8"), root)
        files.append(
            File.generated(
                config, page, content=f"{NOT_SEARCHED}{text}" if source == "CHANGELOG.md" else text
            )
        )
    for path in sorted(
        path for folder in FOLDERS for path in (root / folder).rglob("*") if path.suffix in SOURCES
    ):
        name = path.relative_to(root).as_posix()
        text = (
            f"{NOT_SEARCHED}#"
            f" {name}\n\n````{SOURCES[path.suffix]}\n{path.read_text(encoding='utf-8')}````\n"
        )
        files.append(File.generated(config, source_page(name), content=text))
    return files


def on_page_content(content: str, page: Page, **kwargs: Any) -> str:
    """Lets long names, such as those of tests, break behind an underscore or a dot, and cells of a
    table where `laid_out` does."""
    content = CELL.sub(laid_out, content)
    broken = re.compile(r"(?<=\w[_.])(?=\w)")
    return re.sub(
        r"<code>([\w.\[\]]{30,})</code>",
        lambda match: f"<code>{broken.sub('<wbr>', match[1])}</code>",
        content,
    )


def laid_out(cell: re.Match[str]) -> str:
    """Cell of a table: numbers, such as "1.8 (2.9), 3 % bad", break behind a comma alone, and a
    long text has a class."""
    content = cell[1]
    if NUMBERS.fullmatch(content):
        parts = [f'<span class="numbers">{part}</span>' for part in content.split(", ")]
        return f"<td>{', '.join(parts)}</td>"
    text = re.sub(r"<[^>]*>", "", content)
    if len(text) > LONG:
        return f'<td class="text">{content}</td>'
    return cell[0]


def on_post_build(config: MkDocsConfig) -> None:
    """Names the generated tables and pictures that are not of the present code."""
    generated.say(generated.not_current())


def source_page(name: str) -> str:
    """Page that shows a source file."""
    return f"sources/{name}.md"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **kwargs: Any) -> str:
    """Puts a file's text in the place of a comment that names it,
    `<!-- file: examples/own_task.py -->`, and makes links of the names of source files. Raises
    OSError."""
    root, uri = Path(config.config_file_path).parent, page.file.src_uri

    def text(match: re.Match[str]) -> str:
        return f'```python title="{match[1]}"\n{(root / match[1]).read_text(encoding="utf-8")}```'

    def linked(match: re.Match[str]) -> str:
        target = match["target"] and posixpath.normpath(
            posixpath.join("docs", posixpath.dirname(uri), match["target"])
        )
        name = match["path"] or target
        if name is None or not SOURCE.fullmatch(name) or not (root / name).is_file():
            return match[0]
        label = match["link"] or f"[`{name}`]"
        address = posixpath.relpath(source_page(name), posixpath.dirname(uri) or ".")
        return f"{label}({address})"

    if uri.startswith("sources/"):
        return markdown
    if boost := next((boost for start, boost in BOOSTS.items() if uri.startswith(start)), None):
        page.meta["search"] = {"boost": boost}
    return FENCE_LINK_OR_CODE.sub(
        linked, re.sub(r"^<!-- file: (\S+) -->$", text, markdown, flags=re.MULTILINE)
    )


def site_links(text: str, root: Path) -> str:
    """Links to files in docs/ and to PAGES lead to their pages, those to source files to theirs; of
    other files, which the site lacks, only the name stays."""

    def replaced(match: re.Match[str]) -> str:
        picture, label, target = match.groups()
        path, _, anchor = target.partition("#")
        if target.startswith("#") or "://" in target:
            return match[0]
        if not (root / path).exists():
            return match[0]  # mkdocs says that it leads nowhere
        if SOURCE.fullmatch(path):
            return f"[{label}]({source_page(path)})"
        if path not in PAGES and not path.startswith("docs/"):
            return label if label == path else f"{label} (`{path}`)"
        address = PAGES.get(path, path.removeprefix("docs/"))
        fragment = f"#{anchor}" if anchor else ""
        return f"{picture}[{label}]({address}{fragment})"

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", replaced, text)
