"""Generated tables and pictures: every one is listed, with a command and a configuration that exist."""

import re
import sys
from pathlib import Path

import pytest

from soft_tendon_env.evaluation.pages import MADE, Stamp

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
import generated  # noqa: E402

sys.path.remove(str(ROOT / "docs"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.fixture
def listed(tmp_path, monkeypatch):
    """listed(text, page): the list, in a folder in the place of the clone, with this one page."""

    def make(text, page):
        (tmp_path / "docs" / "pictures").mkdir(parents=True)
        (tmp_path / "docs" / "own.md").write_text(page)
        path = tmp_path / "docs" / "generated.toml"
        path.write_text(text)
        for name, value in (("ROOT", tmp_path), ("LIST", path), ("STAMPS", tmp_path / "docs" / "pictures" / "stamps.json")):
            monkeypatch.setattr(generated, name, value)
        return tmp_path

    return make


def test_every_generated_block_is_listed_once_and_is_there():
    made = [(own.page, block) for own in generated.listed() if own.page for block in own.blocks]
    blocks = [
        (page.relative_to(ROOT).as_posix(), block)
        for page in PAGES
        for block in re.findall(r"^<!-- /(.+) -->$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert sorted(made) == sorted(blocks)
    whole = {own.page for own in generated.listed() if own.page and not own.blocks}
    stamped = {page.relative_to(ROOT).as_posix() for page in PAGES if MADE.search(page.read_text(encoding="utf-8"))}
    assert stamped <= whole | {page for page, _ in made}
    for own in generated.listed():
        own.stale()  # reads pages and stamps, and raises for what is not there


def test_pictures_are_shown_and_copies_are_kept(listed, monkeypatch):
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = {name for own in generated.listed() for name in own.pictures}
    assert all(Path(name).name in shown and (ROOT / name).is_file() for name in pictures)
    entry = '[[made]]\npage = "docs/own.md"\ncommand = "soft-tendon own"\npictures = ["docs/own.png"]\ncopied_from = "out"\n'
    root = listed(entry, "")
    monkeypatch.setattr(generated, "succeeds", lambda command: (root / "out" / "own.png").write_text("picture") > 0)
    (root / "out").mkdir()
    (own,) = generated.listed()
    assert own.make() and (root / "docs" / "own.png").read_text() == "picture" and own.names == ["docs/own.md", "docs/own.png"]


def test_what_is_current_is_left_and_what_changed_or_failed_is_made(listed, monkeypatch, capsys):
    entry = '[[made]]\npage = "docs/own.md"\nblocks = ["own"]\ncommand = "{command}"\nminutes = 2\n'
    root = listed(entry.format(command="soft-tendon own"), "<!-- own -->\nold\n<!-- /own -->\n")
    page, played = root / "docs" / "own.md", []
    monkeypatch.setattr(generated, "succeeds", lambda command: played.append(command[-1]) or write(True))

    def write(good):
        stamp = Stamp.of(("soft-tendon", "own"))._replace(commit="HEAD").text()
        page.write_text(f"<!-- own -->\n{stamp}\n<!-- /own -->\n")
        return good

    monkeypatch.setattr(Stamp, "changed", lambda stamp: False)
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 0 and "about 2.0 minutes" in capsys.readouterr().out
    assert generated.main() == 0 and "0 to be made" in capsys.readouterr().out and played == ["own"]
    assert generated.listed()[0].minutes == 0.1 and generated.LIST.read_text().count("minutes") == 1
    monkeypatch.setattr(Stamp, "changed", lambda stamp: True)
    monkeypatch.setattr(sys, "argv", ["generated.py", "--list"])
    assert generated.main() == 0 and "has changed since" in capsys.readouterr().out and played == ["own"]
    monkeypatch.setattr(generated, "succeeds", lambda command: write(False))
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 1 and "failed: soft-tendon own" in capsys.readouterr().err


def test_a_picture_has_its_stamp_beside_it(listed, monkeypatch, capsys):
    root = listed('[[made]]\npictures = ["docs/pictures/own.png"]\ncommand = "python own.py"\n', "")
    monkeypatch.setattr(generated, "succeeds", lambda command: (root / "docs/pictures/own.png").touch() or True)
    monkeypatch.setattr("soft_tendon_env.evaluation.pages.ROOT", root)
    (root / "own.py").touch()
    monkeypatch.setattr(sys, "argv", ["generated.py"])
    assert generated.main() == 0 and "1 to be made" in capsys.readouterr().out
    monkeypatch.setattr(Stamp, "changed", lambda stamp: False)
    assert generated.not_current() == {}


def test_names_that_are_not_listed_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["generated.py", "docs/none.md"])
    with pytest.raises(SystemExit):
        generated.main()
    assert "docs/none.md is not in docs/generated.toml: docs/appendix/speed.md" in capsys.readouterr().err
