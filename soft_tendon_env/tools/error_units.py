"""Units in which errors are shown to people: lengths in millimetres, angles in degrees. What is computed and recorded stays in SI units."""

from typing import NamedTuple


class ErrorUnit(NamedTuple):
    """What a plot or a picture writes beside an error, and the factor that takes SI units to it."""

    label: str
    symbol: str  # empty where the error's unit depends on the scene
    factor: float

    @property
    def heading(self) -> str:
        """The same without the word error, as columns of tables have it."""
        name = self.label.removesuffix(" error")
        return f"{name} [{self.symbol}]" if self.symbol else name

    @property
    def titled(self) -> str:
        """The label with its unit, as axes have it."""
        return f"{self.label} [{self.symbol}]" if self.symbol else self.label

    def text(self, value: float) -> str:
        """A value, given in SI units, with three significant digits and its unit."""
        return f"{self.factor * value:.3g} {self.symbol}".rstrip()


SYMBOLS = {"position_error": ("mm", 1e3), "backbone_error": ("mm", 1e3), "angle_error": ("deg", 57.29577951308232)}


def error_unit(name: str) -> ErrorUnit:
    """How an error of this name, such as "position_error", is shown; one that is not known keeps its own unit."""
    return ErrorUnit(name.replace("_", " "), *SYMBOLS.get(name, ("", 1.0)))
