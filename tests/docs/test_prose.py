"""Prose of the documentation: short sentences, measured numbers that link to where they come from,
and refusals that are tried.

A refusal that a page documents has a comment behind its sentence, which is run and has to be
refused in one line, or names the test:

    An unknown task is refused. <!-- refused: soft-tendon evaluate tracking --task None -->
    <!-- refused: gym.make("TendonRod-TipPose-v0", fidelity="exact") -->
    <!-- refused: tests/envs/test_contacts.py::test_name -->
"""

import ast
import re
from pathlib import Path

import generated
import gymnasium as gym
import numpy as np
import pytest

import soft_tendon_env as ste

ROOT = Path(__file__).parents[2]
GUIDES = ("tutorials", "how_to", "explanation")
"""Folders of pages in which a length in mm is a result, and links to the table that has it; given
lengths stand as code."""
WRITTEN = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
WRITTEN += [
    page
    for folder in (*GUIDES, "reference")
    for page in sorted((ROOT / "docs" / folder).glob("*.md"))
]
LONGEST = 25
"""Words of a sentence."""
MARKED = re.compile(r"^<!-- ([^/\n]+) -->$.*?^<!-- /\1 -->$", re.MULTILINE | re.DOTALL)
FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)
REFUSED = re.compile(r"<!-- refused: (.+?) -->", re.DOTALL)
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
CODE = re.compile(r"`[^`]*`|\$\$.*?\$\$|\$[^$\n]+\$", re.DOTALL)
PARAGRAPH = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=[|#])")
SENTENCE = re.compile(r"(?<=[.!?:;])\s+")


def paragraphs(text: str) -> list[str]:
    """Paragraphs, items and table rows that people wrote, with their comments: no generated blocks
    and no code blocks."""
    return [
        part
        for part in PARAGRAPH.split(FENCE.sub("", MARKED.sub("", text)))
        if COMMENT.sub("", part).strip()
    ]


def prose(paragraph: str) -> str:
    """Words that are read: code and comments are none, links are their labels."""
    return CODE.sub("code", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", COMMENT.sub("", paragraph)))


def lengths(page: Path, text: str) -> list[str]:
    """Paragraphs with a result in mm that lack a link to a generated page."""
    if page.parent.name not in GUIDES:
        return []
    made = {part.page for part in generated.listed()}

    def linked(paragraph: str) -> bool:
        targets = re.findall(r"\]\(([^)#\s]+)", paragraph)
        return any(
            str((page.parent / target).resolve().relative_to(ROOT)) in made
            for target in targets
            if "://" not in target
        )

    return [
        paragraph
        for paragraph in paragraphs(text)
        if re.search(r"\d\s*(?:mm|millimet\w+)\b", prose(paragraph)) and not linked(paragraph)
    ]


def sentences(page: Path, text: str) -> list[str]:
    """Sentences that are too long, outside of tables."""
    parts = [
        prose(paragraph) for paragraph in paragraphs(text) if not paragraph.lstrip().startswith("|")
    ]
    return [
        sentence
        for part in parts
        for sentence in SENTENCE.split(part)
        if len(sentence.split()) > LONGEST
    ]


def refusals(page: Path, text: str) -> list[str]:
    """Paragraphs that say that something is refused, without what is tried."""
    return [
        paragraph
        for paragraph in paragraphs(text)
        if re.search(r"\brefuse[sd]?\b", prose(paragraph)) and not REFUSED.search(paragraph)
    ]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("check", [lengths, sentences, refusals])
def test_pages_are_written_plainly(check):
    faults = {name(page): check(page, page.read_text(encoding="utf-8")) for page in WRITTEN}
    assert {page: texts for page, texts in faults.items() if texts} == {}, check.__doc__


@pytest.mark.parametrize(
    ("check", "text", "count"),
    [
        (lengths, "It is 3 mm off.", 1),
        (
            lengths,
            "It is 3 mm off, see [accuracy](../appendix/accuracy.md).\n\nA rod of `3 mm`.",
            0,
        ),
        (lengths, "It is 3 mm off, see [symbols](../reference/symbols.md).", 1),
        (sentences, f"{'word ' * 24}word. {'word ' * 25}word.", 1),
        (refusals, "This is refused.\n\nThat is refused. <!-- refused: 1 / 0 -->", 1),
    ],
)
def test_faults_of_a_page_are_found(check, text, count):
    assert len(check(ROOT / "docs" / "how_to" / "own.md", text)) == count


TRIED = [
    (page, match[1])
    for page in WRITTEN
    for match in REFUSED.finditer(page.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(
    ("page", "tried"), TRIED, ids=lambda value: name(value) if isinstance(value, Path) else None
)
def test_what_a_page_says_is_refused_is_refused(page, tried, capsys):
    if tried.startswith("tests/"):
        file, _, test = tried.partition("::")
        tests = {
            node.name
            for node in ast.walk(ast.parse((ROOT / file).read_text()))
            if isinstance(node, ast.FunctionDef)
        }
        assert test in tests, f"{name(page)}: there is no test {tried}"
    else:
        assert refused(tried, capsys), f"{name(page)}: {tried} is not refused in one line"


def refused(tried: str, capsys: pytest.CaptureFixture[str]) -> bool:
    """Whether a command, or Python code, ends in a message of one line."""
    if tried.startswith("soft-tendon "):
        from soft_tendon_env.cli.main import main

        capsys.readouterr()  # what was compiled for the refusals before
        with pytest.raises(SystemExit) as ended:
            main(tried.split()[1:])
        return ended.value.code == 2 and len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises((ValueError, TypeError)) as error:
        exec(tried, {"gym": gym, "np": np, "ste": ste})
    return "\n" not in str(error.value)
