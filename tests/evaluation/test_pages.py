import json

import pytest

from soft_tendon_env.evaluation import pages
from soft_tendon_env.evaluation.pages import Page, Stamp


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A folder in the place of the clone, with a script and a configuration."""
    for name in ("benchmarks/own.py", "configs/own.toml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("before")
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "command, line, source",
    [
        (("/usr/bin/soft-tendon", "compare", "--config", "own"), "soft-tendon compare --config own", "configs/own.toml"),
        (("benchmarks/own.py", "--write-docs"), "python benchmarks/own.py --write-docs", "benchmarks/own.py"),
    ],
)
def test_a_stamp_says_what_a_block_was_made_by_and_follows_what_it_depends_on(command, line, source, clone, monkeypatch):
    monkeypatch.chdir(clone)
    made = Stamp.of(command, "fast")
    assert made.command == line and made.sources == [source] and made.preset == "fast"
    assert Stamp.read(f"text {made.text()} text") == made and f"`{line}`" in made.text()
    assert not made.changed()
    (clone / source).write_text("after")
    assert made.changed()
    (clone / source).unlink()
    assert made.changed()


def test_a_folder_and_the_package_count_without_documents_docstrings_and_what_python_compiles(clone, monkeypatch):
    source = clone / "configs" / "own.py"
    source.write_text('"""Words."""\nVALUE = 1\n')
    made = Stamp.of(("soft-tendon", "demo"), "fast", ["configs"])
    (clone / "configs" / "__pycache__").mkdir()
    (clone / "configs" / "__pycache__" / "own.cpython-311.pyc").write_bytes(b"compiled")
    (clone / "configs" / "README.md").write_text("a document")
    source.write_text('"""Other words."""\nVALUE = 1\n')
    assert not made.changed()
    (clone / "configs" / "new.toml").write_text("")
    assert made.changed()
    made = Stamp.of(("soft-tendon", "demo"), "fast", ["configs"])
    source.write_text('"""Other words."""\nVALUE = 2\n')
    assert made.changed()
    made = Stamp.of(("soft-tendon", "demo"), "fast")
    monkeypatch.setattr(pages, "package_version", lambda: "of other code")
    assert made.changed()


def test_what_a_script_imports_counts(clone, monkeypatch):
    """The parts of the package that no result of an episode depends on, and files beside it, and what these import."""
    (clone / "benchmarks" / "_own.py").write_text("from soft_tendon_env.robots import clock\nfrom soft_tendon_env.cli import main\n")
    (clone / "benchmarks" / "own.py").write_text("from _own import clock\nfrom soft_tendon_env.envs import IDS\nimport _thread\n")
    (clone / "soft_tendon_env" / "robots").mkdir(parents=True)
    (clone / "soft_tendon_env" / "recording").mkdir()
    (clone / "soft_tendon_env" / "robots" / "clock.py").write_text("from soft_tendon_env.recording import timeline\n")
    monkeypatch.chdir(clone)
    (clone / "out").mkdir()
    (clone / "out" / "own.rrd").write_text("what another command wrote")
    made = Stamp.of(("benchmarks/own.py", "out/own.rrd"), "fast")
    assert made.sources == ["benchmarks/_own.py", "benchmarks/own.py", "soft_tendon_env/recording", "soft_tendon_env/robots"]
    (clone / "soft_tendon_env" / "recording" / "timeline.py").write_text("STEP = 1\n")
    assert made.changed()


def test_a_page_keeps_what_stands_around_a_block(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- own -->\nold\n<!-- /own -->\nafter\n")
    Page(str(path), ["own"], "fine").write("own", "| table |")
    text = path.read_text()
    assert text.startswith("before\n<!-- own -->\n<!-- made ") and text.endswith("\n\n| table |\n<!-- /own -->\nafter\n")
    assert Stamp.read(text).preset == "fine" and "old" not in text


def test_what_is_no_stamp_is_refused(tmp_path):
    assert Stamp.read("no stamp") is None
    with pytest.raises(ValueError, match="a stamp should have command, commit"):
        Stamp.read(f"<!-- made {json.dumps({'command': 'x'})} -->")
