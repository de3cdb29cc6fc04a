"""Every entry of every registry that ships has a row in a table of the documentation."""

import importlib
import re
from pathlib import Path

import pytest

from soft_tendon_env.envs.observation import GROUPS
from soft_tendon_env.envs.targets import TARGETS
from soft_tendon_env.evaluation.metrics import METRICS
from soft_tendon_env.tools import registry

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {
    "algorithm": "how_to/train_at_scale.md",
    "command": "reference/commands.md",
    "condition": "reference/commands.md",
    "controller": "how_to/controllers.md",
    "effect": "how_to/effects.md",
    "estimator": "how_to/controllers.md",
    "metric": "reference/symbols.md",
    "reward_term": "reference/environments.md",
    "routing": "tutorials/model_your_arm.md",
    "section": "tutorials/model_your_arm.md",
    "strain": "explanation/model.md",
    "taper": "tutorials/model_your_arm.md",
    "task": "reference/environments.md",
}
"""Pages with the tables of kinds."""
FILLED = {"observation_group": "observation groups", "target": "targets"}
"""Kinds whose tables docs/reference_tables.py makes, in reference/environments.md."""
CELLS = {
    "effect": lambda name: f"effects.{name}",
    "controller": lambda name: f"`{name.partition('/')[2]}`",
    "task": lambda name: f"`TendonRod-{name}-v0`",
}
"""Text of the first cells of a row by the name of an entry, where it is not the name in `code`."""


def entries():
    """Kinds and names of all that ships."""
    for kind, home in registry.KINDS.items():
        importlib.import_module(home)
        table = registry._registries[kind]
        for name in table:
            if table.module_of(name).startswith("soft_tendon_env."):
                yield kind, name


def rows(page):
    """Rows of the tables of a page."""
    return [line for line in (DOCS / page).read_text().splitlines() if line.startswith("|")]


def test_every_kind_has_a_table():
    assert registry.KINDS.keys() == PAGES.keys() | FILLED.keys()
    page = (DOCS / "reference/environments.md").read_text()
    for comment in FILLED.values():
        assert f"<!-- {comment} -->" in page


@pytest.mark.parametrize(
    ("kind", "name"), [entry for entry in entries() if entry[0] in PAGES], ids="-".join
)
def test_every_entry_has_a_row(kind, name):
    text = CELLS.get(kind, "`{}`".format)(name)
    pattern = re.compile(re.escape(text) + r"(?![\w-])")
    page = PAGES[kind]
    is_there = any(pattern.search(row) for row in rows(page))
    assert is_there, f"{page} has no row {text}"


def test_tables_that_are_filled_have_texts():
    for name, group in GROUPS.items():
        assert group.description, name
    for name, target in TARGETS.items():
        assert target.__doc__, name


def test_headings_of_metrics_are_those_of_their_table():
    firsts = [row.split("|")[1].strip() for row in rows(PAGES["metric"])]
    for metric in METRICS.values():
        assert metric.heading in firsts
