"""Progress bars: few lines where there is no terminal, one bar where there is, nothing if quiet."""

import io

import pytest
from tqdm import tqdm

from soft_tendon_env.tools import progress
from soft_tendon_env.tools.progress import MOST_LINES, progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def stream(monkeypatch):
    """stream(kind): stderr of that class; progress is wanted."""

    def make(kind):
        written = kind()
        monkeypatch.setattr("sys.stderr", written)
        monkeypatch.setattr(progress, "QUIET", False)
        return written

    return make


@pytest.mark.parametrize("total", [0, 1, 3, 10, 11, 57, 1000])
def test_a_file_gets_few_lines_with_name_share_and_time(stream, total):
    written = stream(io.StringIO)
    with progress_bar(total, "circle: episodes", "episode") as bar:
        for _ in range(total):
            bar.update()
    lines = written.getvalue().splitlines()
    assert len(lines) <= MOST_LINES
    assert len(lines) >= min(total, MOST_LINES // 2)
    shares = []
    for line in lines:
        name, share, seconds = line.replace(" %, ", "|").replace(": ", "|").rsplit("|", 2)
        assert name == "circle|episodes", line
        assert seconds.endswith(" s to go"), line
        shares.append(int(share))
    assert shares == sorted(set(shares))
    assert "\r" not in written.getvalue()


def test_a_terminal_gets_a_bar_that_is_drawn_anew(stream):
    written = stream(Terminal)
    with progress_bar(3, "circle", "episode") as bar:
        bar.update(3)
    assert type(bar) is tqdm
    assert "\rcircle: " in written.getvalue()


def test_quiet_is_quiet(stream, monkeypatch):
    written = stream(io.StringIO)
    monkeypatch.setattr(progress, "QUIET", True)
    with progress_bar(3, "circle", "episode") as bar:
        bar.update(3)
    assert written.getvalue() == ""
