"""`soft-tendon reproduce-paper`: Figures 2 to 6 of the paper, as pictures and numbers, beside what
it says of them."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.tools.configuration import Configuration

LONGEST = 10.0
"""Duration [s] of all motions."""


class ReproducePaper(Configuration):
    """Draw figures 2 to 6 of the paper, and print what it says of them beside what is measured."""

    seconds: Annotated[
        float,
        Field(
            ge=1.0, le=LONGEST, description="end every motion after this time [s], to try it out"
        ),
    ] = LONGEST
    out: str = Field(default="out/paper", description="folder of pictures and numbers")


def run(settings: ReproducePaper) -> None:
    """Draw, print and write."""
    with mistakes():
        require("pictures")
        out = writable_folder(Path(settings.out))
    from soft_tendon_env.paper.reproduce import reproduce

    reproduce(settings.seconds, out)
