"""How the benchmarks measure, print and store."""

import argparse
import csv
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.tables import markdown_table as table_of_text

matplotlib.use("Agg")
APPENDIX = Path(__file__).parent.parent / "docs" / "appendix"


def parser_of(doc: str) -> argparse.ArgumentParser:
    """Parser with the options of all benchmarks whose tables are in the documentation."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="try the script: few, small and short cases"
    )
    parser.add_argument(
        "--write-docs",
        action="store_true",
        help="write the table, the CSV file and the picture of the documentation too",
    )
    parser.add_argument("--out", type=Path, default=Path("out"))
    return parser


def folders(arguments: argparse.Namespace, docs: Path = APPENDIX) -> list[Path]:
    """Folders that get the CSV file and the picture. docs: that of the documentation."""
    return [arguments.out, *([docs] if arguments.write_docs else [])]


def write_block(arguments: argparse.Namespace, page: Path, name: str, text: str) -> None:
    """Print a block of a page, and write it there with --write-docs. Raises as
    soft_tendon_env.evaluation.pages.Page."""
    print(f"\n{text}\n")
    Page(str(page) if arguments.write_docs else None, [name]).write(name, text)


def cpu_times(action: Callable[[], object], repeats: int) -> list[float]:
    """CPU seconds of the process for each of `repeats` calls, after one that is not counted."""
    action()
    times = []
    for _ in range(repeats):
        started = time.process_time()
        action()
        times.append(time.process_time() - started)
    return times


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table that reads well as it is and as Markdown."""
    return table_of_text(header, [[*map(str, row)] for row in rows])


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    print(f"written: {path}")


def write_picture(figure: Figure, path: Path, dpi: int = 130) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    print(f"written: {path}")


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def machine() -> str:
    """What the numbers depend on besides the code."""
    return f"{processor()}, {os.cpu_count()} cores, Python {platform.python_version()}, one thread"
