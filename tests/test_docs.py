"""The documentation runs: Python blocks of README.md and docs/, in order, and the commands that
shell blocks name.

The blocks of one page share a namespace and a temporary folder. A block with a file name
(```toml title="my_arm.toml")
is written there. Blocks of `py`, whose libraries the tests lack, are only compiled. A block that
would run for long is shortened by a comment in the line before it, which says what: <!-- test:
replace "300_000" by "512" -->. A block of `text` is the end of what the page has printed up to it.
"""

import contextlib
import functools
import io
import itertools
import os
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import pytest

from soft_tendon_env.cli.main import main

pytestmark = pytest.mark.usefixtures("forgotten")
ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDS = ("soft-tendon", "python", "make", "pip", "rerun")
"""What shell blocks and command lines in the text may begin with."""

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
LAST_DIGITS = 0.02
"""Share by which a printed number may differ from a quoted one, on another processor say."""

FENCE = re.compile(
    r'((?:^<!-- test: [^\n]*-->\n)*)^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$',
    re.MULTILINE | re.DOTALL,
)
REPLACEMENT = re.compile(r'<!-- test: replace "([^"]+)" by "([^"]*)" -->\n')


class Block(NamedTuple):
    """A fenced block: its language, the file that it is, its first line on the page, its text as
    shown and as tested."""

    language: str
    file: str | None
    line: int
    text: str
    tested: str


def blocks_of(text: str) -> list[Block]:
    """All fenced blocks of a page."""
    found = []
    for match in FENCE.finditer(text):
        comments, language, file, body = match.groups()
        line = text.count("\n", 0, match.start(4)) + 1
        tested = body
        assert not REPLACEMENT.sub("", comments), f"line {line}: {comments.strip()}"
        for old, new in REPLACEMENT.findall(comments):
            assert old in tested, (
                f"line {line}: the block should have {old!r}, which its test replaces"
            )
            tested = tested.replace(old, new)
        found.append(Block(language, file, line, body, tested))
    return found


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


PYTHON = [
    pytest.param(
        page,
        marks=[] if "tutorials" in page.parts and page.stem != "robot" else [pytest.mark.slow],
        id=name_of(page),
    )
    for page in PAGES
    if "```python" in page.read_text(encoding="utf-8")
]
"""Pages with blocks of Python: tutorials are tried first, but for that of the robot, which takes
longer."""


@pytest.mark.slow
@pytest.mark.parametrize("page", PYTHON)
def test_python_blocks_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    printed = io.StringIO()
    for block in blocks_of(page.read_text(encoding="utf-8")):
        if block.file is not None:
            Path(block.file).write_text(block.text, encoding="utf-8")
        if block.language in ("python", "py"):
            code = compile(
                "\n" * (block.line - 1) + block.tested, str(page), "exec"
            )  # a traceback names the line of the page
            if block.language == "python":
                with contextlib.redirect_stdout(printed):
                    exec(code, namespace)
        if block.language == "text":
            difference = misquoted(block.tested, printed.getvalue())
            assert difference is None, f"{name_of(page)}, line {block.line}: {difference}"


def misquoted(quoted: str, printed: str) -> str | None:
    """Difference between lines that a page quotes and the last lines that it printed, in words;
    None: there is none but in the last digits."""
    quoted_lines = quoted.splitlines()
    printed_lines = printed.splitlines()[-len(quoted_lines) :]
    if len(printed_lines) < len(quoted_lines):
        return f"it quotes {len(quoted_lines)} lines, but printed {len(printed_lines)}"
    for quoted_line, printed_line in zip(quoted_lines, printed_lines, strict=True):
        difference = f"it quotes {quoted_line!r}, but printed {printed_line!r}"
        if NUMBER.sub("#", quoted_line) != NUMBER.sub("#", printed_line):
            return difference
        quoted_numbers = [float(text) for text in NUMBER.findall(quoted_line)]
        printed_numbers = [float(text) for text in NUMBER.findall(printed_line)]
        if quoted_numbers != pytest.approx(printed_numbers, rel=LAST_DIGITS):
            return difference
    return None


@pytest.mark.parametrize(
    ("quoted", "printed", "is_right"),
    [
        ("tip 0.0361 mm\n", "first\ntip 0.0360 mm\n", True),
        ("tip 0.0361 mm\n", "tip 0.0461 mm\n", False),
        ("tip 0.0361 mm\n", "tip 0.0361 mm, by 1e-06 of it\n", False),
        ("tip 0.0361 mm\n", "tip 0.0361 m\n", False),
        ("one\ntwo\n", "two\n", False),
    ],
)
def test_quoted_outputs_are_compared_in_words_and_numbers(quoted, printed, is_right):
    assert (misquoted(quoted, printed) is None) == is_right


def test_tutorials_quote_outputs_behind_blocks_that_print_them():
    """A quotation on a page whose programs do not run would be compared with nothing."""
    for page in PAGES:
        languages = [block.language for block in blocks_of(page.read_text(encoding="utf-8"))]
        if "text" in languages:
            assert "python" in languages[: languages.index("text")], name_of(page)


def command_lines(text: str) -> list[str]:
    """Commands that a page names: lines of blocks without language, and code in the text that
    begins with one of COMMANDS."""
    shell = "\n".join(
        block.text for block in blocks_of(text) if block.language in ("", "bash", "sh")
    )
    prose = FENCE.sub("", text)
    spans = re.findall(r"`([^`]+)`", prose.replace("\n", " "))
    lines = [
        line.split(" #")[0].strip() for line in [*shell.replace("\\\n", " ").splitlines(), *spans]
    ]
    return [line for line in lines if line.split(" ")[0] in COMMANDS and " " in line]


@functools.cache
def help_of(command: str) -> str:
    """What a command, or a script, says with --help."""
    said = io.StringIO()
    script = str(ROOT / command)
    path = [str(Path(script).parent), *sys.path]
    with (
        mock.patch.dict(os.environ, COLUMNS="1000"),
        mock.patch.multiple(sys, argv=[script, "--help"], path=path),
        contextlib.redirect_stdout(said),
        pytest.raises(SystemExit) as exit,
    ):
        runpy.run_path(script, run_name="__main__") if command.endswith(".py") else main(
            [command, "--help"]
        )
    assert not exit.value.code, f"{command} --help"
    return said.getvalue()


def check_command(line: str) -> None:
    """Asserts that a command, the files that it takes and its options exist."""
    program, *rest = shlex.split(line)
    if program == "make":
        targets = re.findall("^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert all(target in targets for target in rest), line
    elif program == "pip":
        extras = [name for given in re.findall(r"\[([a-z,]+)\]", line) for name in given.split(",")]
        project = (ROOT / "pyproject.toml").read_text()
        assert all(re.search(f"^{name} = ", project, re.MULTILINE) for name in extras), line
    elif program in ("soft-tendon", "python"):
        check_options(line, rest, script=program == "python")


def check_options(line: str, words: list[str], script: bool) -> None:
    command, *given = words
    if command.startswith("-"):
        return  # python -m, python -c, --help
    if script:
        assert (ROOT / command).is_file(), line
    options = any(word.startswith("--") for word in given)
    text = (
        help_of(command) if options or not script else ""
    )  # a script without options may do its work when asked for help
    for word in given:
        if word.startswith("--"):
            assert re.search(rf"{re.escape(word.split('=')[0])}\b", text), (
                f"{line}: no option {word}"
            )
        elif word.startswith(("configs/", "agents/")):
            assert (ROOT / word).exists(), line
    if command in ("train", "sweep"):
        for name in itertools.takewhile(lambda word: not word.startswith("-"), given):
            assert (ROOT / "configs" / f"{name}.toml").is_file() or name.isupper() or "." in name, (
                f"{line}: there is no configs/{name}.toml"
            )


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if command_lines(page.read_text(encoding="utf-8"))],
    ids=name_of,
)
def test_commands_exist(page):
    for line in command_lines(page.read_text(encoding="utf-8")):
        check_command(line)


def test_files_that_pages_show_are_examples_that_run():
    tested = (ROOT / "tests" / "test_examples.py").read_text(encoding="utf-8")
    for page in PAGES:
        for file in re.findall(
            r"^<!-- file: (\S+) -->$", page.read_text(encoding="utf-8"), re.MULTILINE
        ):
            assert (ROOT / file).is_file(), f"{name_of(page)}: {file}"
            assert f'"{Path(file).name}"' in tested, f"{name_of(page)}: {file}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere_and_configurations_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", text)):
        path = target.partition("#")[0]
        assert (
            "://" in target
            or not path
            or (page.parent / path).exists()
            or path.endswith(("contributing.md", "changelog.md"))
        ), target
    for path in re.findall(r"\bconfigs/[\w/]+\.(?:toml|yml)\b", text):
        assert (ROOT / path).is_file(), path


@pytest.mark.parametrize(
    "command",
    [
        made["command"]
        for made in tomllib.loads((ROOT / "docs" / "generated.toml").read_text())["made"]
    ],
)
def test_commands_of_generated_tables_exist(command):
    check_command(command)
