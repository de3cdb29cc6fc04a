"""Figures 2 to 6 of the paper, as pictures and numbers, and what it says of them beside what is measured.

    python agents/reproduce_paper.py [--figures 2 3 4 5 6] [--seconds 10] [--write-docs] [--out out/paper]

Figures 3 and 4 belong together, and so do 5 and 6. What the paper does not give (inputs, wanted shapes, the circle's period) is ours:
see _paper_validation.py, _paper_shape.py and _paper_tip.py. The control laws act continuously in time, as the paper's; beside (39) is
what the package makes of it at a control period, see _paper_usable.py.
"""

import argparse
from pathlib import Path
from typing import Any

import _paper_shape
import _paper_tip
import _paper_validation
from _command import MISTAKES, command, said, writable_folder
from _paper_claims import Result, claims_table
from _records import write_json
from _tables import around_markers, write_between_markers

FIGURES = {2: _paper_validation, 3: _paper_shape, 4: _paper_shape, 5: _paper_tip, 6: _paper_tip}
LEAST_SECONDS = 1.0
DOCS = Path(__file__).parent.parent / "docs" / "paper.md"
MARKER = "figures"


@command("stopped")
def main() -> None:
    arguments = parse_arguments()
    modules = list(dict.fromkeys(FIGURES[figure] for figure in arguments.figures))
    results = {module: module.reproduce(arguments.seconds, arguments.out) for module in modules}
    for result in results.values():
        print(f"\n{tables_of(result)}")
    claims = [claim for result in results.values() for claim in result.claims]
    print(f"\n{sum(not claim.holds for claim in claims)} of {len(claims)} claims missed")
    numbers = {name: value for result in results.values() for name, value in result.numbers.items()}
    write_json(arguments.out / "numbers.json", {"claims": [claim._asdict() for claim in claims], **numbers})
    print(f"pictures: in {arguments.out}")
    if arguments.write_docs:
        write_between_markers(DOCS, MARKER, document(results))


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figures", nargs="+", type=int, choices=FIGURES, default=list(FIGURES))
    parser.add_argument("--seconds", type=float, default=10.0, help="try the script: end every motion after this, at least 1")
    parser.add_argument("--write-docs", action="store_true", help="write between the markers of docs/paper.md")
    parser.add_argument("--out", type=Path, default=Path("out") / "paper", help="folder of pictures and numbers")
    arguments = parser.parse_args()
    longest = max(_paper_validation.DURATION, _paper_shape.DURATION, _paper_tip.DURATION)
    if not LEAST_SECONDS <= arguments.seconds <= longest:
        parser.error(f"--seconds is {arguments.seconds:g}: it should be {LEAST_SECONDS:g} to {longest:g}")
    if arguments.write_docs and (arguments.seconds < longest or set(arguments.figures) != set(FIGURES)):
        parser.error(f"--write-docs needs all figures and at least {longest:g} seconds")
    try:
        if arguments.write_docs:
            around_markers(DOCS, MARKER)
        writable_folder(arguments.out)
    except MISTAKES as error:
        parser.error(said(error))
    return arguments


def document(results: dict[Any, Result]) -> str:
    """The sections of docs/paper.md."""
    sections = ["Written by `python agents/reproduce_paper.py --write-docs`, which draws them as well."]
    for module, result in results.items():
        title, _, text = module.__doc__.partition("\n\n")
        sections += [f"## {title.rstrip('.')}", text.strip(), tables_of(result)]
    return "\n\n".join(sections)


def tables_of(result: Result) -> str:
    return "\n\n".join(filter(None, [claims_table(result.claims), result.more]))


if __name__ == "__main__":
    main()
