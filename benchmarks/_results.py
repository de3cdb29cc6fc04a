"""How the benchmarks measure, print and store."""

import csv
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from soft_tendon_env.evaluation.pages import stamp

matplotlib.use("Agg")


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
    cells = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])


def write_page(path: Path, title: str, parts: Sequence[str]) -> None:
    """A page of the docs: its first part, the stamp, the others."""
    first, *others = parts
    path.write_text("\n\n".join([f"# {title}", first, stamp(), *(own.strip("\n") for own in others)]) + "\n")
    print(f"written: {path}")


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
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def machine() -> str:
    """What the numbers depend on besides the code."""
    return f"{processor()}, {os.cpu_count()} cores, Python {platform.python_version()}, one thread"
