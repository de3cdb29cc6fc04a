"""Messages to a user: errors of all kinds in words, and lines on stderr.

The lines say what is compiled, kept or left out.
"""

import contextlib
import functools
import os
import sys
from collections.abc import Iterator
from contextvars import ContextVar

QUIET = os.environ.get("SOFT_TENDON_ENV_QUIET", "0") not in (
    "",
    "0",
)  # whether lines of progress are not wanted

_subject = ContextVar("_subject", default="")
"""Beginning of lines of progress: what they are about, and a colon; empty outside of `naming`."""


class UserError(Exception):
    """Ends a program for a reason that its user can do something about.

    The program has begun; its exit status is 1 after one line, without a traceback.
    """


def describe(error: BaseException) -> str:
    """Error in words: of an OSError the file comes first, without the number.

    Its notes come last.
    """
    if isinstance(error, OSError) and error.strerror:
        names = ", ".join(
            str(name) for name in (error.filename, error.filename2) if name is not None
        )
        if names:
            return f"{names}: {error.strerror}"
        return error.strerror
    if isinstance(error, MemoryError):
        if str(error):
            return f"there is too little memory: {error}"
        return "there is too little memory"
    text = str(error) or type(error).__name__
    notes = getattr(error, "__notes__", [])
    return ". ".join([text, *notes])


def first_line(error: BaseException) -> str:
    """The type and the first line of an error of another library, at most 160 characters of it."""
    text = describe(error).strip().splitlines()
    if text:
        first = text[0][:160]
        return f"{type(error).__name__}, {first}"
    return type(error).__name__


def say(line: str) -> None:
    """Prints a line to stderr, if that can be written."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):  # it lies on the full disk too; it is closed
            print(f"soft_tendon_env: {line}", file=sys.stderr, flush=True)


@functools.cache
def warn_once(line: str) -> None:
    """Prints a line to stderr the first time that it is given."""
    say(line)


@functools.cache
def say_once(line: str) -> None:
    """Prints a line of progress to stderr the first time that it is passed.

    SOFT_TENDON_ENV_QUIET=1 silences it.
    """
    if not QUIET:
        say(f"{_subject.get()}{line}")


@contextlib.contextmanager
def naming(subject: str) -> Iterator[None]:
    """Context in which lines of progress begin with what they are about."""
    before = _subject.set(f"{subject}: ")
    try:
        yield
    finally:
        _subject.reset(before)
