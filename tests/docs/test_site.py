"""The hooks of the documentation site: equations, links to sources, cells of tables."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
pytest.importorskip("mkdocs", reason="the extra docs is not installed")
pytest.importorskip("latex2mathml", reason="the extra docs is not installed")
pytest.importorskip("griffe", reason="the extra docs is not installed")
import field_comments  # noqa: E402
import griffe  # noqa: E402
import site_hooks  # noqa: E402
import site_math  # noqa: E402
from mkdocs.exceptions import PluginError  # noqa: E402

CONFIG = SimpleNamespace(config_file_path=str(ROOT / "mkdocs.yml"))


def page(uri):
    return SimpleNamespace(file=SimpleNamespace(src_uri=uri, src_path=uri), meta={})


def test_equations_become_mathml():
    html = site_math.on_page_content(
        r'<p><span class="arithmatex">\(a &lt; \dot q\)</span></p>', page("a.md")
    )
    assert "<mover><mi>q</mi>" in html
    assert 'display="inline"' in html
    assert "arithmatex" not in html
    assert 'display="block"' in site_math.on_page_content(
        r'<div class="arithmatex">\[\frac{1}{2}\]</div>', page("a.md")
    )


@pytest.mark.parametrize(
    ("latex", "message"),
    [(r"\nothing x", r"\nothing in"), (r"\frac{a", "do not pair"), (r"a & b", "&")],
)
def test_equations_that_browsers_would_not_draw_are_refused(latex, message):
    with pytest.raises(PluginError) as error:
        site_math.on_page_content(
            rf'<span class="arithmatex">\({latex}\)</span>', page("how_to/a.md")
        )
    assert message in str(error.value)
    assert "how_to/a.md" in str(error.value)


@pytest.mark.parametrize(
    ("markdown", "shown"),
    [
        ("`examples/own_task.py`", "[`examples/own_task.py`](../sources/examples/own_task.py.md)"),
        ("[a task](../../examples/own_task.py)", "[a task](../sources/examples/own_task.py.md)"),
        ("`examples/none.py` and [a](../b.md)", "`examples/none.py` and [a](../b.md)"),
        ("```\n`examples/own_task.py`\n```", "```\n`examples/own_task.py`\n```"),
    ],
)
def test_source_files_are_linked(markdown, shown):
    assert site_hooks.on_page_markdown(markdown, page("how_to/extend.md"), CONFIG) == shown


@pytest.mark.parametrize(
    ("cell", "parts"),
    [
        ("1.8 (2.9)", ["1.8 (2.9)"]),
        ("-0.48 (-0.75 to -2.4e-05)", ["-0.48 (-0.75 to -2.4e-05)"]),
        ("416 / 418, 100 % bad", ["416 / 418", "100 % bad"]),
        ("3 columns", []),
    ],
)
def test_numbers_of_a_table_break_behind_a_comma_alone(cell, parts):
    html = site_hooks.on_page_content(f"<td>{cell}</td>", page("a.md"))
    assert re.findall(r'<span class="numbers">(.*?)</span>', html) == parts
    assert re.sub(r"</?span[^>]*>", "", html) == f"<td>{cell}</td>"


@pytest.mark.parametrize(("length", "kind"), [(40, ""), (41, ' class="text"')])
def test_long_texts_of_a_table_keep_some_width(length, kind):
    text = f"<code>{'a' * 8}</code>{' ' * (length - 8)}"
    assert site_hooks.on_page_content(f"<td>{text}</td>", page("a.md")) == f"<td{kind}>{text}</td>"


def shown_on(page):
    """Modules and names of the scene that a page of the API shows."""
    text = (ROOT / "docs" / "api" / page).read_text(encoding="utf-8")
    modules = re.findall(r"^::: (soft_tendon_env\.scene\.\w+)\n.*members: \[([^\]]*)\]", text, re.M)
    return [(module, name) for module, names in modules for name in names.split(", ")]


def test_every_key_of_a_scene_has_a_description():
    package = griffe.load("soft_tendon_env.scene", search_paths=[ROOT])
    fields = [
        field
        for module, name in shown_on("scene.md")
        for field in package[module.rpartition(".")[2]][name].attributes.values()
        if field_comments.is_field(field)
    ]
    assert len(fields) > 50
    undescribed = [field.path for field in fields if not field_comments.description(field)]
    assert undescribed == []


def test_fields_have_the_comment_beside_or_above_them(tmp_path):
    source = """
from typing import NamedTuple

class Row(NamedTuple):
    time: float  # [s]
    # (n,) of the strain,
    # in its units
    q: list
    step: float = 0.02
"""
    (tmp_path / "rows.py").write_text(source)
    fields = griffe.load("rows", search_paths=[tmp_path])["Row"].attributes
    texts = {name: field_comments.description(field) for name, field in fields.items()}
    expected = {"time": "[s]", "q": "(n,) of the strain, in its units", "step": "default `0.02`"}
    assert texts == expected
