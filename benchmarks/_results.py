"""How the benchmarks measure, print and store."""

import argparse
import csv
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from soft_tendon_env.evaluation import provenance
from soft_tendon_env.evaluation.tables import markdown_table as table_of_text
from soft_tendon_env.evaluation.tables import write_markdown

matplotlib.use("Agg")


def parser_of(doc: str) -> argparse.ArgumentParser:
    """Parser with the options of all benchmarks whose tables are in the documentation."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="try the script: few, small and short cases"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder of tables, CSV files and pictures"
    )
    return parser


def write_tables(path: Path, text: str) -> None:
    """Print tables in Markdown, and write them to a file."""
    print(f"\n{text}\n")
    write_markdown(path, text)


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
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    print(f"written: {path}")


def write_picture(figure: Figure, path: Path, dpi: int = 130) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
    print(f"written: {path}")


def machine() -> str:
    """Text of what the numbers depend on besides the code."""
    return f"{provenance.machine()}, one thread"
