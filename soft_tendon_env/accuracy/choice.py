"""Choice of a trial: coordinates, quadrature and time steps of an arm.

It says how near to the converged reference they were.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from soft_tendon_env.accuracy.input_motions import DURATION
from soft_tendon_env.scene.scene import Scene, breakpoints, rod_length

SMOOTH_FIELDS = 2
"""Order of polynomials that a quadrature should integrate for leading POD modes, which are
smooth."""

SPARE_INTERVALS = 2
"""Intervals of a part of the rod above the order of its polynomials."""


class Accuracy(NamedTuple):
    """Accuracy that is asked of the tip, as shares of the rod's length.

    To begin with it is asked of the parts of a simulation too.
    """

    share: float  # largest distance of the tip from full physics
    fields: float  # as measured for passive fields that ship, or that `soft-tendon fields` made
    quadrature: float  # at rest, whatever the tensions within limits
    least: int  # intervals per piece
    tolerance: float  # of a time step


class Choice(NamedTuple):
    """Coordinates, quadrature and time steps that a trial chose, and the error that it measured."""

    strain: dict[str, Any]
    quadrature: dict[str, Any]
    integrator: dict[str, Any]
    coordinates: int
    # bound of the tip's distance from full physics, as a share of the length; inf: not known
    error: float
    # inputs under which full physics neither rests nor moves, since the arm buckles or diverges
    missing: int = 0
    # inputs under which refinements of full physics disagree: a column may fall either way
    not_unique: int = 0
    inputs: int = 0  # that were tried, those with them
    loads: dict[str, Any] | None = None  # table of the largest effects that were tried
    reach: float = 1.0  # multiple of the loads of the scene that began the trial, which these are
    seconds: float = DURATION  # [s] from the start of motions with less than what is asked for
    tensions: float = 1.0  # part of the tensions of usual motions that it speaks of
    # times [s] and bounds up to them, as shares of the length, where the error is not within what
    # is asked for to the end of motions
    growth: tuple[tuple[float, float], ...] = ()

    @property
    def left_out(self) -> int:
        """Inputs that the error does not speak of."""
        return self.missing + self.not_unique

    @property
    def speaks_of_all(self) -> bool:
        """Whether the error holds for all inputs, to the end of motions with usual tensions."""
        is_long = self.seconds >= DURATION
        has_usual_tensions = self.tensions == 1.0
        return not self.left_out and is_long and has_usual_tensions

    def applied_to(self, scene: Scene) -> Scene:
        """The scene with this choice."""
        parts = {
            "strain": self.strain,
            "quadrature": self.quadrature,
            "integrator": self.integrator,
        }
        return scene.replace(parts)

    def with_strain(self, scene: Scene, strain: dict[str, Any]) -> Choice:
        """Choice with another strain table, and at least as many intervals as that needs.

        The intervals are along the rod. Raises ConfigurationError.
        """
        changed = scene.replace({"strain": strain})
        has_fields = "fields" in strain.get("passive", ())
        if has_fields:
            order = SMOOTH_FIELDS
        else:
            order = changed.strain.highest_order

        # as many along the rod, whatever its pieces
        pieces_asked = breakpoints(scene).size - 1
        pieces_changed = breakpoints(changed).size - 1
        spread = pieces_asked / pieces_changed
        along = math.ceil(self.quadrature["least"] * spread)
        least = max(along, order + SPARE_INTERVALS)
        return self._replace(
            strain=strain,
            quadrature={**self.quadrature, "least": least},
        )

    def with_intervals(self, times: float) -> Choice:
        """The choice with so many times as many intervals."""
        least = math.ceil(times * self.quadrature["least"])
        return self._replace(quadrature={**self.quadrature, "least": least})

    def with_finer_steps(self, times: float) -> Choice:
        """The choice with a tolerance of time steps that is so many times less."""
        finer = self.integrator["tolerance"] / times
        return self._replace(integrator={**self.integrator, "tolerance": finer})

    def describe(self, scene: Scene) -> str:
        """The choice in words.

        It has the error that was measured, or why there is none and what to do.
        """
        strain = describe_strain(self.strain)
        kind = f"{strain}, {self.coordinates} coordinates,"
        if not math.isfinite(self.error):
            return f"{kind} are a guess, since {self.obstacle}"
        percent = 100 * self.error
        millimetres = 1e3 * self.error * rod_length(scene)
        share = f"{percent:.2g} % of the length"
        size = f"{millimetres:.2g} mm"
        return f"{kind} were within {share}, {size}, in a trial{self.limits}"

    @property
    def limits(self) -> str:
        """Words that say what the error does not speak of; empty where it speaks of everything."""
        words = ""
        if self.seconds < DURATION:
            words += f" of {self.seconds:.2g} s of motion"
        if self.tensions < 1.0:
            words += f" under {self.tensions:.3g} of the tensions of the usual motions"
        if self.left_out:
            words += f" without {self.left_out} inputs under which the arm's motion is not unique"
        return words

    def describe_growth(self, share: float) -> str:
        """How long motions stay within a share of the length, and how far off they are later."""
        known = [pair for pair in self.growth if math.isfinite(pair[1])]
        parts = []
        if 0.0 < self.seconds < DURATION:
            extent = f"{100 * share:.3g} % of the length for {self.seconds:.2g} s"
            parts.append(extent)
        if known and known[-1][1] > share:
            seconds, bound = known[-1]
            extent = f"{100 * bound:.2g} % after {seconds:.2g} s"
            parts.append(extent)
        if len(known) < len(self.growth):
            last = self.seconds
            if known:
                last = max(last, known[-1][0])
            parts.append(f"not known after {last:.2g} s")
        return ", ".join(parts)

    @property
    def obstacle(self) -> str:
        """Why the error is not known, and what to do."""
        if self.left_out < self.inputs:
            return (
                "none of the coordinates that were tried can follow full physics under these loads"
                " and tensions: reduce tension_limits or the loads, or give [strain] in the scene"
            )
        if self.missing > self.not_unique:
            return (
                "full physics has no motion under its loads and tensions (it buckles, diverges or"
                f" rests nowhere in {self.missing} of {self.inputs} inputs): reduce"
                " tension_limits or the loads, or add damping"
            )
        return (
            "the motion of full physics under its loads and tensions is not unique (refinements"
            f" disagree in {self.not_unique} of {self.inputs} inputs, as where a column falls"
            " either way): reduce tension_limits or the loads, or add damping"
        )


def describe_strain(strain: dict[str, Any]) -> str:
    """A strain table in words."""
    modes = strain.get("modes", strain.get("passive", []))
    if isinstance(modes, dict):
        return f"{modes['fields']} POD modes"
    if not modes:
        return "the tensions alone"
    first = modes[0]
    kind = "explicit strain"
    if "modes" not in strain:
        kind = f"passive {', '.join(first['strains'])}"
    if first["span"] == "rod":
        span = "the rod"
    else:
        span = "each part"
    return f"{kind} up to order {first['order']} over {span}"
