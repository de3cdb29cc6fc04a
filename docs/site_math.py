"""MkDocs hook: equations in LaTeX, $...$ within a line and $$...$$ by themselves, as MathML, which
browsers draw without any script."""

import html
import re
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.pages import Page

EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
"""An equation as pymdownx.arithmatex marks it."""
NOT_UNDERSTOOD = re.compile(r"\\[A-Za-z]+|<mi>&(?:amp;)?</mi>")
"""Commands and alignment that latex2mathml hands on as if they were symbols."""


def on_page_content(content: str, page: Page, **kwargs: Any) -> str:
    """Replaces every equation. Raises PluginError for one that cannot be converted."""

    def mathml(match: re.Match[str]) -> str:
        tag, opening, latex = match[1], match[2], html.unescape(match[3]).strip()
        try:
            found = convert(latex, display="block" if opening == "[" else "inline")
        except (
            Exception
        ) as error:  # latex2mathml has an exception for every mistake, without a common class
            raise PluginError(
                f"{page.file.src_path}: {latex!r} is no equation: {type(error).__name__}"
            ) from error
        if len(re.findall(r"(?<!\\)\{", latex)) != len(re.findall(r"(?<!\\)\}", latex)):
            raise PluginError(f"{page.file.src_path}: braces of the equation {latex!r} do not pair")
        if unknown := NOT_UNDERSTOOD.search(found):
            raise PluginError(
                f"{page.file.src_path}: {unknown[0]} in the equation {latex!r} is not among what"
                " latex2mathml converts"
            )
        return f'<{tag} class="equation">{found}</{tag}>'

    return EQUATION.sub(mathml, content)
