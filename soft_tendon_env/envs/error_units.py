"""Display units of tracking errors: lengths in millimetres, angles in degrees. What is computed and recorded stays in SI units."""

from typing import NamedTuple


class ErrorUnit(NamedTuple):
    """Label and unit symbol of an error in plots and pictures, and the factor from SI units to that unit."""

    label: str
    symbol: str  # empty where the error's unit depends on the scene
    factor: float

    @property
    def heading(self) -> str:
        """Label without the word "error", and its unit: the heading of a table's column."""
        name = self.label.removesuffix(" error")
        return f"{name} [{self.symbol}]" if self.symbol else name

    @property
    def titled(self) -> str:
        """Label with its unit, as on the axis of a plot."""
        return f"{self.label} [{self.symbol}]" if self.symbol else self.label

    def text(self, value: float) -> str:
        """Text of a value given in SI units: three significant digits and the display unit."""
        return f"{self.factor * value:.3g} {self.symbol}".rstrip()


SYMBOLS = {
    "position_error": ("mm", 1e3),
    "backbone_error": ("mm", 1e3),
    "angle_error": ("deg", 57.29577951308232),
    "penetration": ("mm", 1e3),
    "contact_force": ("N", 1.0),
}


def error_unit(name: str) -> ErrorUnit:
    """Display unit of an error by its name, such as "position_error"; a name that is not known keeps SI units."""
    return ErrorUnit(name.replace("_", " "), *SYMBOLS.get(name, ("", 1.0)))
