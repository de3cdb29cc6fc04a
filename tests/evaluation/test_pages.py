import json

import pytest

from soft_tendon_env.evaluation import pages
from soft_tendon_env.evaluation.pages import Page, Stamp


def test_a_stamp_says_what_a_block_was_made_by(tmp_path, monkeypatch):
    (tmp_path / "own.py").touch()
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)
    for command, line in (
        (("/usr/bin/soft-tendon", "compare", "--config", "own"), "soft-tendon compare --config own"),
        (("own.py", "--write-docs"), "python own.py --write-docs"),
    ):
        made = Stamp.of(command)
        assert made.command == line and f"<!-- made {json.dumps(made._asdict())} -->" in made.text() and f"`{line}`" in made.text()


def test_a_page_keeps_what_stands_around_a_block(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- own -->\nold\n<!-- /own -->\nafter\n")
    Page(str(path), ["own"]).write("own", "| table |")
    text = path.read_text()
    assert text.startswith("before\n<!-- own -->\n<!-- made ") and text.endswith("\n\n| table |\n<!-- /own -->\nafter\n")
    assert "\nold\n" not in text
    with pytest.raises(ValueError, match="should have the lines <!-- other --> and <!-- /other -->"):
        Page(str(path), ["other"])
