"""Generated tables and pictures: every one is listed, with a command and a configuration that
exist."""

import json
import re
import sys
from pathlib import Path

import generated
import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.fixture
def listed(tmp_path, monkeypatch):
    """listed(text, page): the list, in a folder in the place of the clone, with this one page."""

    def make(text, page):
        (tmp_path / "docs" / "pictures").mkdir(parents=True)
        (tmp_path / "docs" / "own.md").write_text(page)
        path = tmp_path / "docs" / "generated.toml"
        path.write_text(text)
        for name, value in (
            ("ROOT", tmp_path),
            ("LIST", path),
            ("STAMPS", tmp_path / "docs" / "pictures" / "stamps.json"),
        ):
            monkeypatch.setattr(generated, name, value)
        return tmp_path

    return make


def test_every_generated_block_is_listed_once_and_is_there():
    made = [
        (entry.page, block) for entry in generated.listed() if entry.page for block in entry.blocks
    ]
    blocks = [
        (page.relative_to(ROOT).as_posix(), block)
        for page in PAGES
        for block in re.findall(r"^<!-- /(.+) -->$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert sorted(made) == sorted(blocks)
    whole = {entry.page for entry in generated.listed() if entry.page and not entry.blocks}
    stamped = {
        page.relative_to(ROOT).as_posix()
        for page in PAGES
        if generated.MADE.search(page.read_text(encoding="utf-8"))
    }
    assert stamped <= whole | {page for page, _ in made}
    for entry in generated.listed():
        entry.stale()  # reads pages and stamps, and raises for what is not there


def test_stamps_are_read_and_unknown_commits_have_changed():
    stamp = generated.Stamp.of("soft-tendon own")
    assert f"<!-- made {json.dumps(stamp._asdict())} -->" in stamp.text()
    assert "`soft-tendon own`" in stamp.text()
    assert generated.read_stamp(f"text {stamp.text()} text") == stamp
    assert generated.read_stamp("no stamp") is None
    assert generated.has_changed(None)
    assert generated.has_changed("0" * 40)


def test_files_are_shown_and_there():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    files = {name for entry in generated.listed() for name in entry.files}
    assert all((ROOT / name).is_file() for name in files)
    pictures = {name for name in files if not name.endswith(".csv")}
    assert all(Path(name).name in text for name in pictures)


ENTRY = """[[made]]
page = "docs/own.md"
blocks = { "own" = "table.md" }
files = ["docs/own.csv"]
folder = "out"
command = "soft-tendon own"
minutes = 2
"""


def test_what_is_current_is_left_and_what_changed_or_failed_is_made(listed, monkeypatch, capsys):
    root = listed(ENTRY, "before\n<!-- own -->\nold\n<!-- /own -->\nafter\n")
    page = root / "docs" / "own.md"
    played = []

    def play(command):
        played.append(command[-1])
        (root / "out").mkdir(exist_ok=True)
        for name in ("table.md", "own.csv"):
            (root / "out" / name).write_text(f"run {len(played)}\n")
        return len(played) == 1

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["generated.py", *arguments])
        status = generated.main()
        return status, capsys.readouterr()

    monkeypatch.setattr(generated, "succeeds", play)
    monkeypatch.setattr(generated, "commit", lambda: "HEAD")
    monkeypatch.setattr(generated, "has_changed", lambda commit: False)
    status, printed = call()
    assert status == 0
    assert "about 2.0 minutes" in printed.out
    text = page.read_text()
    assert text.startswith("before\n<!-- own -->\n<!-- made ")
    assert text.endswith("\n\nrun 1\n<!-- /own -->\nafter\n")
    assert "\nold\n" not in text
    assert (root / "docs" / "own.csv").read_text() == "run 1\n"

    status, printed = call()
    assert status == 0
    assert "0 to be made" in printed.out
    assert played == ["own"]
    assert generated.listed()[0].minutes == 0.1
    assert generated.LIST.read_text().count("minutes") == 1

    monkeypatch.setattr(generated, "has_changed", lambda commit: True)
    status, printed = call("--list")
    assert status == 0
    assert "has changed since" in printed.out
    assert played == ["own"]
    status, printed = call()
    assert status == 1
    assert "failed: soft-tendon own" in printed.err
    assert "run 1" in page.read_text()


def test_what_an_earlier_run_has_left_is_not_taken_over(listed, monkeypatch, capsys):
    root = listed(ENTRY, "<!-- own -->\n<!-- /own -->\n")
    (root / "out").mkdir()
    for name in ("table.md", "own.csv"):
        (root / "out" / name).write_text("of an earlier run")
    monkeypatch.setattr(generated, "succeeds", lambda command: True)
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 1
    assert "it should have left" in capsys.readouterr().err
    assert (root / "docs" / "own.md").read_text() == "<!-- own -->\n<!-- /own -->\n"


def test_a_whole_page_has_its_stamp_below_the_title(listed, monkeypatch):
    entry = '[[made]]\npage = "docs/own.md"\nfolder = "out"\ncommand = "soft-tendon own"\n'
    root = listed(entry, "old")
    (root / "out").mkdir()

    def play(command):
        (root / "out" / "own.md").write_text("# Title\n\ntext\n")
        return True

    monkeypatch.setattr(generated, "succeeds", play)
    generated.listed()[0].make()
    text = (root / "docs" / "own.md").read_text()
    assert text.startswith("# Title\n\n<!-- made ")
    assert text.endswith("</small>\n\ntext\n")


def test_a_page_without_its_lines_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("no lines")
    message = "should have the lines <!-- own --> and <!-- /own -->, once each"
    with pytest.raises(ValueError, match=message):
        generated.around_markers(page, "own")
