"""Makes the generated blocks, pages and pictures of the documentation that docs/generated.toml
lists.

    python docs/generated.py [--list] [PAGE or FILE ...]

A command leaves tables in Markdown, CSV files and pictures in a folder; from there they come into
the documentation, with a stamp:

    <!-- made {"command": ..., "commit": ..., "made": ...} -->
    <small>Made by `soft-tendon ...` at commit ..., on ...</small>

What is current, made at a commit since which no code or configuration has changed, is left as it
is: a stopped command goes on. --list only says what is not current.
"""

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from pydantic import Field

from soft_tendon_env.evaluation.provenance import commit, machine
from soft_tendon_env.tools.configuration import Configuration, read_toml
from soft_tendon_env.tools.files import read_json, read_text, replacing

ROOT = Path(__file__).parents[1]
LIST = ROOT / "docs" / "generated.toml"
STAMPS = ROOT / "docs" / "pictures" / "stamps.json"
"""Stamps of files that stand in no generated block, by their paths."""
SOURCES = ("soft_tendon_env", "benchmarks", "examples", "configs", "agents")
"""Parts of the clone on which generated blocks depend."""
MADE = re.compile(r"<!-- made (\{.*\}) -->")
PROGRAMS = {"soft-tendon": [sys.executable, "-m", "soft_tendon_env"], "python": [sys.executable]}
SHORTEST = 0.1
"""Time [min] that is kept of a command that took less."""


class Stamp(NamedTuple):
    """Origin of what is generated: the command, the commit (None: of no clone), and the day."""

    command: str
    commit: str | None
    made: str

    @classmethod
    def of(cls, command: str) -> "Stamp":
        """The stamp of a command that ends now."""
        return cls(command, commit(), datetime.now(UTC).date().isoformat())

    @classmethod
    def parse(cls, table: object) -> "Stamp":
        """The stamp of a table, as JSON has it. Raises ValueError."""
        if not isinstance(table, dict) or not {*cls._fields} <= table.keys():
            raise ValueError(f"a stamp should have {', '.join(cls._fields)}, not {table}")
        return cls(*(table[name] for name in cls._fields))

    def comment(self) -> str:
        """The comment that programs read."""
        return f"<!-- made {json.dumps(self._asdict())} -->"

    def text(self) -> str:
        """The comment that programs read, and the line that people read, with this machine."""
        source = ""
        if self.commit is not None:
            changed = "+" if self.commit.endswith("+") else ""
            source = f" at commit {self.commit[:10]}{changed}"
        sentence = f"Made by `{self.command}`{source} on {self.made}. Machine: {machine()}."
        return f"{self.comment()}\n<small>{sentence}</small>"


def read_stamp(text: str) -> Stamp | None:
    """The first stamp in a text, if there is one. Raises ValueError where it is damaged."""
    comment = MADE.search(text)
    return None if comment is None else Stamp.parse(json.loads(comment[1]))


def has_changed(commit: str | None) -> bool:
    """Whether SOURCES differ from those of a commit, or that is not known."""
    if commit is None or commit.endswith("+"):
        return True
    difference = ["git", "diff", "--quiet", commit, "--", *SOURCES]
    return subprocess.run(difference, cwd=ROOT, capture_output=True).returncode != 0


def around_markers(path: Path, block: str) -> tuple[str, str]:
    """Text before and after the lines `<!-- BLOCK -->` and `<!-- /BLOCK -->` of a page, with them.
    Raises ValueError, FileNotFoundError."""
    begin = f"<!-- {block} -->"
    end = f"<!-- /{block} -->"
    content = read_text(path)
    before, _, rest = content.partition(begin)
    _, _, after = rest.partition(end)
    are_single = content.count(begin) == 1 and content.count(end) == 1
    if not are_single or end not in rest:
        raise ValueError(
            f"{path} should have the lines {begin} and {end}, once each and in this order"
        )
    return before + begin, end + after


class Made(Configuration):
    """What a command makes: see docs/generated.toml."""

    command: str
    folder: str | None = None
    page: str | None = None
    blocks: dict[str, str] = Field(default={})
    files: tuple[str, ...] = ()
    minutes: float | None = Field(default=None, gt=0.0)
    is_measured: bool = True

    @property
    def names(self) -> list[str]:
        """The page and the files that are made."""
        pages = [] if self.page is None else [self.page]
        return [*pages, *self.files]

    def stamps(self) -> list[Stamp | None]:
        """Stamps of the blocks, or of the page, or of the files. Raises ValueError,
        FileNotFoundError."""
        if self.page is None:
            return self._stamps_of_files()
        page = ROOT / self.page
        if not self.blocks:
            return [read_stamp(read_text(page)) if page.exists() else None]
        text = read_text(page)
        stamps = []
        for block in self.blocks:
            before, after = around_markers(page, block)
            stamps.append(read_stamp(text.removeprefix(before).removesuffix(after)))
        return stamps

    def _stamps_of_files(self) -> list[Stamp | None]:
        kept = read_json(STAMPS) if STAMPS.exists() else {}
        stamps = list[Stamp | None]()
        for name in self.files:
            is_there = name in kept and (ROOT / name).is_file()
            stamps.append(Stamp.parse(kept[name]) if is_there else None)
        return stamps

    def stale(self) -> str | None:
        """Why it is to be made again; None: it is current. Raises ValueError, OSError."""
        for stamp in self.stamps():
            if stamp is None:
                return "has no stamp"
            if stamp.command != self.command:
                return f"was made by `{stamp.command}`"
            if has_changed(stamp.commit):
                origin = stamp.made if stamp.commit is None else stamp.commit[:10]
                return f"code or configuration has changed since {origin}"
        return None

    def make(self) -> None:
        """Runs the command, brings what it leaves into the documentation, and keeps stamps. Raises
        ValueError, OSError where it failed."""
        sources = self._sources()
        # What an earlier run has left does not pass for this one's.
        for source in sources:
            source.unlink(missing_ok=True)
        program, *words = shlex.split(self.command)
        if not succeeds([*PROGRAMS.get(program, [program]), *words]):
            raise ValueError("it ended with an error")
        for source in sources:
            if not source.is_file():
                raise ValueError(f"it should have left {source}")
        self._take_over(Stamp.of(self.command))

    def _sources(self) -> list[Path]:
        """Files that the command leaves in its folder."""
        if self.folder is None:
            return []
        names = [*self.blocks.values(), *(Path(name).name for name in self.files)]
        if self.page is not None and not self.blocks:
            names.append(Path(self.page).name)
        return [ROOT / self.folder / name for name in names]

    def _take_over(self, stamp: Stamp) -> None:
        """Writes what was made into the documentation."""
        folder = ROOT / (self.folder or "")
        if self.folder is not None:
            for name in self.files:
                shutil.copyfile(folder / Path(name).name, ROOT / name)
        if self.page is None:
            kept = read_json(STAMPS) if STAMPS.exists() else {}
            kept |= dict.fromkeys(self.files, stamp._asdict())
            STAMPS.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
            return
        page = ROOT / self.page
        origin = stamp.text() if self.is_measured else stamp.comment()
        for block, name in self.blocks.items():
            before, after = around_markers(page, block)
            text = read_text(folder / name).strip()
            with replacing(page) as path:
                path.write_text(f"{before}\n{origin}\n\n{text}\n{after}", encoding="utf-8")
        if not self.blocks:
            # The stamp stands below the title.
            title, _, text = read_text(folder / page.name).partition("\n\n")
            with replacing(page) as path:
                path.write_text(f"{title}\n\n{origin}\n\n{text}", encoding="utf-8")


def succeeds(command: list[str]) -> bool:
    """Runs a command in the clone."""
    return subprocess.run(command, cwd=ROOT).returncode == 0


class Tables(Configuration):
    """The list."""

    made: tuple[Made, ...]


def listed() -> tuple[Made, ...]:
    """All that is made, in order. Raises ConfigurationError, FileNotFoundError."""
    return Tables.parse(read_toml(LIST), str(LIST)).made


def not_current() -> list[tuple[Made, str]]:
    """What is not current, in order, and why. Raises ValueError, OSError."""
    reasons = [(made, made.stale()) for made in listed()]
    return [(made, reason) for made, reason in reasons if reason is not None]


def overview() -> str:
    """A page of the documentation: every block with the command and commit that made it. Raises
    ValueError, OSError."""
    head = """# Generated tables and pictures

`make tables` makes these tables and pictures anew where the code or the configuration has changed
since. Each table carries a line with the command, the commit and the day. "-" stands for a table
that was made before it carried such a line.
"""
    rows = [head, "| made | command | commit | day |", "|---|---|---|---|"]
    for made in listed():
        stamp = made.stamps()[0]
        commit_and_day = "- | -"
        if stamp is not None:
            commit_and_day = f"{(stamp.commit or '-')[:10]} | {stamp.made}"
        names = ", ".join(f"[{Path(name).name}]({link(name)})" for name in made.names)
        rows.append(f"| {names} | `{made.command}` | {commit_and_day} |")
    return "\n".join(rows) + "\n"


def link(name: str) -> str:
    """Path of a file of the documentation from a page in docs/appendix."""
    return "../index.md" if name == "README.md" else f"../{name.removeprefix('docs/')}"


def keep_time(made: Made, minutes: float) -> None:
    """Writes the minutes that a command took into the list, for the next estimate."""
    line = f"command = {json.dumps(made.command)}\n"
    head, _, tail = read_text(LIST).partition(line)
    others = re.sub(r"\Aminutes = .*\n", "", tail)
    LIST.write_text(f"{head}{line}minutes = {max(SHORTEST, minutes):.1f}\n{others}")


def say(stale: list[tuple[Made, str]]) -> None:
    """Prints what is not current."""
    for made, why in stale:
        print(f"not current: {', '.join(made.names)}: {why}")


def main() -> int:
    """Make what is not current; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument(
        "names",
        nargs="*",
        metavar="PAGE",
        help="pages or files, by default all that are not current",
    )
    parser.add_argument(
        "--list", action="store_true", help="say what is not current, and make nothing"
    )
    arguments = parser.parse_args()
    known = [name for made in listed() for name in made.names]
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        parser.error(f"{unknown[0]} is not in docs/generated.toml: {', '.join(known)}")

    stale = not_current()
    if arguments.names:
        stale = [(made, why) for made, why in stale if {*arguments.names} & {*made.names}]
    if arguments.list or not stale:
        say(stale)
        print(f"{len(stale)} to be made")
        return 0
    return make_all([made for made, _ in stale])


def make_all(stale: list[Made]) -> int:
    """Make everything in order; the exit status, 1 where something failed."""
    minutes = sum(made.minutes or 0.0 for made in stale)
    print(f"{len(stale)} to be made: about {minutes:.1f} minutes", flush=True)
    not_measured = [made.names[0] for made in stale if made.minutes is None]
    if not_measured:
        print(f"not measured yet, and not in this: {', '.join(not_measured)}", flush=True)
    failed = []
    for number, made in enumerate(stale, 1):
        print(f"\n[{number}/{len(stale)}] {made.command}", flush=True)
        started = time.monotonic()
        try:
            made.make()
        except (ValueError, OSError) as error:
            failed.append(f"failed: {made.command}: {error}")
            continue
        minutes = (time.monotonic() - started) / 60.0
        print(f"{minutes:.1f} minutes; {made.minutes or 'no time'} foreseen", flush=True)
        keep_time(made, minutes)
    for line in failed:
        print(line, file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("stopped: the same command goes on")
    except (ValueError, OSError) as error:
        sys.exit(str(error))
