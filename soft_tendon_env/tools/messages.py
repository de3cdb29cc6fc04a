"""Messages on stderr: that kernels are being compiled, and what cannot be cached."""

import contextlib
import functools
import os
import sys

QUIET = os.environ.get("SOFT_TENDON_ENV_QUIET", "0") not in ("", "0")


def say(line: str) -> None:
    """Prints a line to stderr, if that can be written."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):  # it lies on the full disk too; it is closed
            print(f"soft_tendon_env: {line}", file=sys.stderr, flush=True)


def say_unless_quiet(line: str) -> None:
    """Prints a line of progress to stderr, unless SOFT_TENDON_ENV_QUIET=1."""
    if not QUIET:
        say(line)


@functools.cache
def say_once(line: str) -> None:
    """Prints a line to stderr the first time that it is given."""
    say(line)
