"""Generated blocks of documents: what a command writes between two lines of a page, and the stamp that says which code made it.

<!-- made {"command": ..., "commit": ..., "code": ..., ...} -->
<small>Made by `soft-tendon ...` at commit ..., on ...</small>
"""

import hashlib
import json
import os
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from soft_tendon_env.evaluation.experiment import SHOWS_ALONE, package_version, source_digest
from soft_tendon_env.evaluation.provenance import commit, machine
from soft_tendon_env.policies.agent_files import is_agent
from soft_tendon_env.tools.files import PACKAGE, digest, parse_json, read_text, replacing

ROOT = PACKAGE.parent
"""Folder of the clone, from which the paths of sources count."""
COMMAND = "soft-tendon"
CONFIGS, AGENTS = "configs", "agents/trained"
MADE_HERE = ("docs/", "out/")
"""Folders of what commands write: no block depends on them."""
SHORT = 10  # characters of a commit that people read
IMPORTED = re.compile(r"^\s*(?:from|import) ([\w.]+)", re.MULTILINE)
MADE = re.compile(r"<!-- made (\{.*\}) -->")


class Stamp(NamedTuple):
    """Origin of a generated block: the command, and what it was made with.

    code: digest of the package, as results of experiments are stored under, and of `sources`: files and folders of the clone that the block
    depends on too, such as its configuration, and other parts of the package. preset: fidelity. made: day.
    """

    command: str
    commit: str | None
    code: str
    sources: list[str]
    preset: str
    machine: str
    made: str

    @classmethod
    def of(cls, command: Sequence[str], preset: str, sources: Iterable[str] = ()) -> "Stamp":
        """The stamp of a command, which may be the path of a script, that is running now. Raises OSError."""
        program, *words = command
        script = Path(program).resolve()
        if script.is_relative_to(ROOT) and not script.is_relative_to(PACKAGE) and script.suffix == ".py":
            line = ["python", script.relative_to(ROOT).as_posix(), *words]
        else:
            line = [COMMAND, *words]
        every = sorted({*sources_of(line), *sources})
        day = datetime.now(UTC).date().isoformat()
        return cls(shlex.join(line), commit(), code_digest(every), every, preset, machine(), day)

    @classmethod
    def read(cls, text: str) -> "Stamp | None":
        """The first stamp in a text, if there is one. Raises ValueError where it is damaged."""
        found = MADE.search(text)
        if found is None:
            return None
        table = parse_json(found[1])
        if not isinstance(table, dict) or set(table) != set(cls._fields):
            raise ValueError(f"a stamp should have {', '.join(cls._fields)}, not {found[1]}")
        return cls(**table)

    def text(self) -> str:
        """The comment that programs read, and the line that people read."""
        at = "" if self.commit is None else f" at commit {self.commit[:SHORT]}{'+' * self.commit.endswith('+')}"
        shown = f"<small>Made by `{self.command}`{at} on {self.made}. Preset: {self.preset}. Machine: {self.machine}.</small>"
        return f"<!-- made {json.dumps(self._asdict())} -->\n{shown}"

    def changed(self) -> bool:
        """Whether the code, or a source, is not what it was when the block was made. Raises OSError."""
        return self.code != code_digest(self.sources)


def sources_of(words: Sequence[str]) -> list[str]:
    """Files of the clone that a command line names: by path, a configuration that ships by its name, or the module of a command; and
    what they import that no result of an episode depends on."""
    paths = [path for word in words for path in (word, f"{CONFIGS}/{word}.toml")]
    if COMMAND in words:
        paths += [f"{PACKAGE.name}/cli/{word.replace('-', '_')}.py" for word in words]
    named = [path for path in paths if (ROOT / path).is_file() and not path.startswith(MADE_HERE) and not path.endswith(".md")]
    return [*named, *_imported([ROOT / path for path in named if path.endswith(".py")])]


def _imported(files: list[Path]) -> list[str]:
    """Parts of the package, but the command line, that no result of an episode depends on, and private modules beside the files: those
    that files import, and that these import in turn."""
    found = list[str]()
    for file in files:  # which grow
        for name in IMPORTED.findall(read_text(file)):
            first, *parts = name.split(".")
            part = file.parent / first if (file.parent / first).is_dir() else file.parent / f"{first}.py"
            if first == PACKAGE.name and parts and parts[0] != "cli" and f"{parts[0]}/" in SHOWS_ALONE:
                part = ROOT / first / parts[0]
            elif not first.startswith("_") or not part.exists():
                continue
            if (path := part.relative_to(ROOT).as_posix()) not in found:
                found.append(path)
                files += sorted(part.rglob("*.py")) if part.is_dir() else [part]
    return found


def agent_sources(policies: Iterable[str]) -> list[str]:
    """The folder of the agents that ship, where one of these policies is an agent."""
    return [AGENTS] if any(map(is_agent, policies)) else []


def code_digest(sources: Iterable[str]) -> str:
    """Digest of the package and of files and folders of the clone, without what is compiled and written in the folders; what is not there
    counts as empty. Raises OSError."""
    parts = [package_version()]
    for name in sources:
        path = ROOT / name
        inside = sorted(own for own in path.rglob("*") if own.is_file() and "__pycache__" not in own.parts and own.suffix != ".md")
        within = [f"{own.relative_to(path).as_posix()} {source_digest(own)}" for own in inside]
        parts += [name, *([digest(path)] if path.is_file() else within)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def stamp(preset: str, sources: Iterable[str] = ()) -> str:
    """Text of the stamp of this process's command. Raises OSError."""
    return Stamp.of(sys.argv, preset, sources).text()


class Page:
    """File in which generated blocks stand between the lines `<!-- NAME -->` and `<!-- /NAME -->`; without a path nothing is written.

    preset, sources: see `Stamp`. Raises as `around_markers` for names whose lines are not there.
    """

    def __init__(self, path: str | None, names: Iterable[str], preset: str, sources: Iterable[str] = ()) -> None:
        self._path = None if path is None else Path(path)
        self._preset, self._sources = preset, sources
        if self._path is not None:
            for name in names:
                around_markers(self._path, name)

    def write(self, name: str, text: str) -> None:
        """Replaces what stands between the lines of a name, with a stamp before it. Raises as `around_markers`, OSError."""
        if self._path is not None:
            before, after = around_markers(self._path, name)
            with replacing(self._path) as path:
                path.write_text(f"{before}\n{stamp(self._preset, self._sources)}\n\n{text}\n{after}")
            print(f"written: {self._path}")


def around_markers(path: Path, name: str) -> tuple[str, str]:
    """Text before and after the markers in a file that can be written, with them. Raises ValueError, FileNotFoundError."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    content = read_text(path)
    if content.count(begin) != 1 or content.count(end) != 1 or content.index(end) < content.index(begin):
        raise ValueError(f"{path} should have the lines {begin} and {end}, once each and in this order")
    if not os.access(path, os.W_OK):
        raise ValueError(f"{path} cannot be written")
    return content.partition(begin)[0] + begin, end + content.partition(end)[2]
