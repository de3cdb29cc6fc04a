"""Generated blocks of documents, and the stamp that says what made them.

A command writes a block between two lines of a page.

<!-- made {"command": ..., "commit": ..., "made": ...} -->
<small>Made by `soft-tendon ...` at commit ..., on ...</small>
"""

import json
import shlex
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from soft_tendon_env.evaluation.provenance import commit, machine
from soft_tendon_env.tools.files import PACKAGE, read_text, replacing

ROOT = PACKAGE.parent
"""Folder of the clone, from which the paths of scripts count."""


class Stamp(NamedTuple):
    """Origin of a generated block: the command, the commit (None: of no clone), and the day."""

    command: str
    commit: str | None
    made: str

    @classmethod
    def of(cls, command: Sequence[str]) -> "Stamp":
        """The stamp of a command, which may be the path of a script, that is running now."""
        script = Path(command[0]).resolve()
        is_ours = script.is_relative_to(ROOT) and not script.is_relative_to(PACKAGE)
        begin = ["soft-tendon"]
        if is_ours and script.suffix == ".py":
            begin = ["python", script.relative_to(ROOT).as_posix()]
        line = shlex.join([*begin, *command[1:]])
        today = datetime.now(UTC).date()
        return cls(line, commit(), today.isoformat())

    def text(self) -> str:
        """The comment that programs read, and the line that people read, with this machine."""
        source = ""
        if self.commit is not None:
            changed = "+" if self.commit.endswith("+") else ""
            source = f" at commit {self.commit[:10]}{changed}"
        sentence = f"Made by `{self.command}`{source} on {self.made}. Machine: {machine()}."
        comment = f"<!-- made {json.dumps(self._asdict())} -->"
        return f"{comment}\n<small>{sentence}</small>"


def stamp() -> str:
    """Text of the stamp of this process's command."""
    return Stamp.of(sys.argv).text()


class Page:
    """File in which generated blocks stand between `<!-- NAME -->` and `<!-- /NAME -->`.

    Without a path nothing is written.

    Raises as `around_markers` for names whose lines are not there.
    """

    def __init__(self, path: str | None, names: Iterable[str]) -> None:
        self._path = None if path is None else Path(path)
        if self._path is not None:
            for name in names:
                around_markers(self._path, name)

    def write(self, name: str, text: str) -> None:
        """Replaces what stands between the lines of a name, with a stamp before it.

        Raises as `around_markers`, OSError.
        """
        if self._path is not None:
            before, after = around_markers(self._path, name)
            with replacing(self._path) as path:
                path.write_text(f"{before}\n{stamp()}\n\n{text}\n{after}")
            print(f"written: {self._path}")


def around_markers(path: Path, name: str) -> tuple[str, str]:
    """Text before and after the markers in a file, with them.

    Raises ValueError, FileNotFoundError.
    """
    begin = f"<!-- {name} -->"
    end = f"<!-- /{name} -->"
    content = read_text(path)
    before, _, rest = content.partition(begin)
    _, _, after = rest.partition(end)
    are_single = content.count(begin) == 1 and content.count(end) == 1
    if not are_single or end not in rest:
        raise ValueError(
            f"{path} should have the lines {begin} and {end}, once each and in this order"
        )
    return before + begin, end + after
