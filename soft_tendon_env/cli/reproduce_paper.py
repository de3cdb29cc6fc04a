"""`soft-tendon reproduce-paper`: Figures 2 to 6 of the paper, as pictures and numbers, beside what it says of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem

MARKER = "figures"
Figure = Literal[2, 3, 4, 5, 6]
ALL: tuple[Figure, ...] = (2, 3, 4, 5, 6)
LONGEST = 10.0  # [s] of all motions


class ReproducePaper(Configuration):
    """Draw figures 2 to 6 of the paper, and print what it says of them beside what is measured.

    Attributes:
        figures: numbers of the figures; 3 and 4 belong together, and so do 5 and 6.
        seconds: end every motion after this time [s], at least 1, to try it out.
        write_docs: a file, such as docs/appendix/paper.md, in which all also goes between <!-- figures --> and <!-- /figures -->.
        out: folder of pictures and numbers.
    """

    figures: tuple[Figure, ...] = Field(default=ALL, min_length=1)
    seconds: Annotated[float, Field(ge=1.0, le=LONGEST)] = LONGEST
    write_docs: str | None = None
    out: str = "out/paper"

    @model_validator(mode="after")
    def _documents_all(self) -> "ReproducePaper":
        if self.write_docs is not None and (self.seconds < LONGEST or set(self.figures) != set(ALL)):
            raise ConfigurationError([Problem(("write_docs",), f"needs all figures and {LONGEST:g} seconds")])
        return self


def run(arguments: Sequence[str]) -> None:
    """Draw, print and write."""
    parser = Parser("reproduce-paper", ReproducePaper)
    settings = parser.read(arguments)
    out = Path(settings.out)
    with parser.mistakes():
        require("pictures")
        page = Page(settings.write_docs, [MARKER])
        writable_folder(out)
    from soft_tendon_env.paper.reproduce import document, reproduce

    results = reproduce(settings.figures, settings.seconds, out)
    if settings.write_docs is not None:  # of which all figures are there
        page.write(MARKER, document(results))
