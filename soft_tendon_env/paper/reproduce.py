"""Figures 2 to 6 of the paper, as pictures and numbers.

What it says of them stands beside what is measured.

Figures 3 and 4 belong together, and so do 5 and 6. What the paper does not give (inputs, wanted
shapes, the circle's period) is ours: see validation.py, shape.py and tip.py. The control laws act
continuously in time, as the paper's; beside (39) is what the package makes of it at a control
period, see motion.py.
"""

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.tables import write_markdown
from soft_tendon_env.paper import shape, tip, validation
from soft_tendon_env.paper.report import Claim, Result


def reproduce(seconds: float, out: Path) -> None:
    """Draw the figures into a folder, print their tables, and write paper.md and numbers.json.

    Raises OSError.
    """
    figures = (validation, shape, tip)
    results = {module: module.reproduce(seconds, out) for module in figures}
    claims = list[Claim]()
    numbers = dict[str, Any]()
    for result in results.values():
        print(f"\n{result.tables}")
        claims += result.claims
        numbers |= result.numbers
    misses = (not claim.holds for claim in claims)
    missed = sum(misses)
    print(f"\n{missed} of {len(claims)} claims missed")
    claim_tables = [claim._asdict() for claim in claims]
    content = {"claims": claim_tables, **numbers}
    write_json(out / "numbers.json", content)
    write_markdown(out / "paper.md", document(results))


def document(results: Mapping[ModuleType, Result]) -> str:
    """Report of all figures in Markdown: a section for each, with its tables."""
    sections = list[str]()
    for module, result in results.items():
        documentation = module.__doc__ or ""
        title, _, text = documentation.partition("\n\n")
        heading = f"## {title.rstrip('.')}"
        sections += [heading, text.strip(), result.tables]
    return "\n\n".join(sections)
