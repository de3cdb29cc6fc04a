"""Makes the generated blocks and pictures of the documentation that docs/generated.toml lists.

    python docs/generated.py [--list] [PAGE or PICTURE ...]

What is current, made at a commit since which no code or configuration has changed (see
soft_tendon_env/evaluation/pages.py), is left as it is: a stopped command goes on. --list only says
what is not current.
"""

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

from pydantic import Field

from soft_tendon_env.evaluation.pages import Stamp, around_markers
from soft_tendon_env.tools.configuration import Configuration, read_toml
from soft_tendon_env.tools.files import read_json, read_text

ROOT = Path(__file__).parents[1]
LIST = ROOT / "docs" / "generated.toml"
STAMPS = ROOT / "docs" / "pictures" / "stamps.json"
"""Stamps of pictures, by their paths."""
SOURCES = ("soft_tendon_env", "benchmarks", "examples", "configs", "agents")
"""Parts of the clone on which generated blocks depend."""
MADE = re.compile(r"<!-- made (\{.*\}) -->")
PROGRAMS = {"soft-tendon": [sys.executable, "-m", "soft_tendon_env"], "python": [sys.executable]}


def read_stamp(text: str) -> Stamp | None:
    """The first stamp in a text, if there is one. Raises ValueError where it is damaged."""
    if (found := MADE.search(text)) is None:
        return None
    table = json.loads(found[1])
    if not isinstance(table, dict) or not {*Stamp._fields} <= table.keys():
        raise ValueError(f"a stamp should have {', '.join(Stamp._fields)}, not {found[1]}")
    return Stamp(*(table[name] for name in Stamp._fields))


def has_changed(commit: str | None) -> bool:
    """Whether SOURCES differ from those of a commit, or that is not known."""
    if commit is None or commit.endswith("+"):
        return True
    return (
        subprocess.run(
            ["git", "diff", "--quiet", commit, "--", *SOURCES], cwd=ROOT, capture_output=True
        ).returncode
        != 0
    )


class Made(Configuration):
    """What a command makes: see docs/generated.toml."""

    command: str
    page: str | None = None
    blocks: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    copied_from: str | None = None
    minutes: float | None = Field(default=None, gt=0.0)

    @property
    def names(self) -> list[str]:
        """The files that are made."""
        return [*([] if self.page is None else [self.page]), *self.pictures]

    def stamps(self) -> list[Stamp | None]:
        """Stamps of the blocks, or of the page, or of the pictures. Raises ValueError,
        FileNotFoundError."""
        if self.page is None:
            kept = read_json(STAMPS) if STAMPS.exists() else {}
            return [
                (
                    Stamp(*(kept[name][key] for key in Stamp._fields))
                    if name in kept and (ROOT / name).is_file()
                    else None
                )
                for name in self.pictures
            ]
        page = ROOT / self.page
        if not self.blocks and not page.exists():
            return [None]
        text = read_text(page)
        between = [
            text.removeprefix(before).removesuffix(after)
            for before, after in (around_markers(page, name) for name in self.blocks)
        ]
        return [read_stamp(part) for part in between or [text]]

    def stale(self) -> str | None:
        """Why it is to be made again; None: it is current. Raises ValueError, OSError."""
        for stamp in self.stamps():
            if stamp is None:
                return "has no stamp"
            if stamp.command != self.command and not self.command.startswith("make "):
                return f"was made by `{stamp.command}`"
            if has_changed(stamp.commit):
                return (
                    "code or configuration has changed since"
                    f" {stamp.commit[:10] if stamp.commit else stamp.made}"
                )
        return None

    def make(self) -> bool:
        """Runs the command, and keeps the stamps of pictures. False where it failed."""
        program, *words = shlex.split(self.command)
        if not succeeds([*PROGRAMS.get(program, [program]), *words]):
            return False
        for name in self.pictures if self.copied_from is not None else ():
            shutil.copyfile(ROOT / self.copied_from / Path(name).name, ROOT / name)
        if self.page is None:
            stamp = Stamp.of(
                [str(ROOT / words[0]), *words[1:]]
                if program == "python"
                else ["soft-tendon", *words]
            )
            kept = {
                **(read_json(STAMPS) if STAMPS.exists() else {}),
                **dict.fromkeys(self.pictures, stamp._asdict()),
            }
            STAMPS.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
        return True


def succeeds(command: list[str]) -> bool:
    """Runs a command in the clone."""
    return subprocess.run(command, cwd=ROOT).returncode == 0


class Tables(Configuration):
    """The list."""

    made: tuple[Made, ...]


def listed() -> tuple[Made, ...]:
    """All that is made, in order. Raises ConfigurationError, FileNotFoundError."""
    return Tables.parse(read_toml(LIST), str(LIST)).made


def not_current() -> dict[Made, str]:
    """What is not current, in order, and why. Raises ValueError, OSError."""
    return {made: why for made in listed() if (why := made.stale()) is not None}


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
        what = ("-", "-") if stamp is None else ((stamp.commit or "-")[:10], stamp.made)
        names = ", ".join(f"[{Path(name).name}]({link(name)})" for name in made.names)
        rows.append(f"| {names} | `{made.command}` | {' | '.join(what)} |")
    return "\n".join(rows) + "\n"


def link(name: str) -> str:
    """Path of a file of the documentation from a page in docs/appendix."""
    return "../index.md" if name == "README.md" else f"../{name.removeprefix('docs/')}"


def keep_time(made: Made, minutes: float) -> None:
    """Writes the minutes that a command took into the list, for the next estimate."""
    line = f"command = {json.dumps(made.command)}\n"
    head, _, tail = read_text(LIST).partition(line)
    others = re.sub(r"\Aminutes = .*\n", "", tail)
    LIST.write_text(f"{head}{line}minutes = {max(0.1, minutes):.1f}\n{others}")


def say(stale: dict[Made, str]) -> None:
    """Prints what is not current."""
    for made, why in stale.items():
        print(f"not current: {', '.join(made.names)}: {why}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "names",
        nargs="*",
        metavar="PAGE",
        help="pages or pictures, by default all that are not current",
    )
    parser.add_argument(
        "--list", action="store_true", help="say what is not current, and make nothing"
    )
    arguments = parser.parse_args()
    known = [name for made in listed() for name in made.names]
    if unknown := [name for name in arguments.names if name not in known]:
        parser.error(f"{unknown[0]} is not in docs/generated.toml: {', '.join(known)}")
    stale = {
        made: why
        for made, why in not_current().items()
        if not arguments.names or {*arguments.names} & {*made.names}
    }
    if arguments.list or not stale:
        say(stale)
        print(f"{len(stale)} to be made")
        return 0
    unknown = [made.names[0] for made in stale if made.minutes is None]
    print(
        f"{len(stale)} to be made: about {sum(made.minutes or 0.0 for made in stale):.1f} minutes",
        flush=True,
    )
    if unknown:
        print(f"not measured yet, and not in this: {', '.join(unknown)}", flush=True)
    failed = []
    for number, made in enumerate(stale, 1):
        print(f"\n[{number}/{len(stale)}] {made.command}", flush=True)
        started = time.monotonic()
        if not made.make():
            failed.append(made)
            continue
        minutes = (time.monotonic() - started) / 60.0
        print(f"{minutes:.1f} minutes; {made.minutes or 'no time'} foreseen", flush=True)
        keep_time(made, minutes)
    for made in failed:
        print(f"failed: {made.command}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("stopped: the same command goes on")
    except (ValueError, OSError) as error:
        sys.exit(str(error))
