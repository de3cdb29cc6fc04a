"""What is said on stderr: that kernels are compiled, and what cannot be kept."""

import contextlib
import os
import sys

QUIET = os.environ.get("SOFT_TENDON_ENV_QUIET", "0") not in ("", "0")


def say(line: str) -> None:
    """Print a line to stderr, where there is one that can be written."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):  # it lies on the full disk too; it is closed
            print(f"soft_tendon_env: {line}", file=sys.stderr, flush=True)


def say_unless_quiet(line: str) -> None:
    """The same for what is no more than progress: SOFT_TENDON_ENV_QUIET=1 silences it."""
    if not QUIET:
        say(line)
