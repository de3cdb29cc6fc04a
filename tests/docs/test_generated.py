"""Generated tables and pictures: every one is listed, with a command and a configuration that
exist."""

import re
import sys
from pathlib import Path

import generated
import pytest

from soft_tendon_env.evaluation.pages import Stamp

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
    stamp = Stamp.of(("soft-tendon", "own"))
    assert generated.read_stamp(f"text {stamp.text()} text") == stamp
    assert generated.read_stamp("no stamp") is None
    assert generated.has_changed(None)
    assert generated.has_changed("0" * 40)


def test_pictures_are_shown():
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = {name for entry in generated.listed() for name in entry.pictures}
    assert all(Path(name).name in shown and (ROOT / name).is_file() for name in pictures)


def test_what_is_current_is_left_and_what_changed_or_failed_is_made(listed, monkeypatch, capsys):
    entry = '[[made]]\npage = "docs/own.md"\nblocks = ["own"]\ncommand = "{command}"\nminutes = 2\n'
    root = listed(entry.format(command="soft-tendon own"), "<!-- own -->\nold\n<!-- /own -->\n")
    page, played = root / "docs" / "own.md", []
    monkeypatch.setattr(
        generated, "succeeds", lambda command: played.append(command[-1]) or write(True)
    )

    def write(good):
        stamp = Stamp.of(("soft-tendon", "own"))._replace(commit="HEAD").text()
        page.write_text(f"<!-- own -->\n{stamp}\n<!-- /own -->\n")
        return good

    monkeypatch.setattr(generated, "has_changed", lambda commit: False)
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 0
    assert "about 2.0 minutes" in capsys.readouterr().out
    assert generated.main() == 0
    assert "0 to be made" in capsys.readouterr().out
    assert played == ["own"]
    assert generated.listed()[0].minutes == 0.1
    assert generated.LIST.read_text().count("minutes") == 1
    monkeypatch.setattr(generated, "has_changed", lambda commit: True)
    monkeypatch.setattr(sys, "argv", ["generated.py", "--list"])
    assert generated.main() == 0
    assert "has changed since" in capsys.readouterr().out
    assert played == ["own"]
    monkeypatch.setattr(generated, "succeeds", lambda command: write(False))
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 1
    assert "failed: soft-tendon own" in capsys.readouterr().err
