"""State of a simulation: everything that the next step depends on, in memory and as a file."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE
from soft_tendon_env.mechanics.motion.scratch import Motion
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_array, checked_number, checked_type
from soft_tendon_env.tools.files import read_arrays
from soft_tendon_env.tools.types import Array

SAME_STRAIN = 1e-6
"""Relative difference of strains that counts as none."""

SHORTEST = 1e-12
"""Time [s] that may count as a time step."""

STATE = "state that State.save wrote"
"""Name of the content of a state's file, for errors."""


@dataclass(frozen=True, eq=False)
class State:
    """State of a simulation, all that the next step depends on.

    A saved state continues bit for bit.
    """

    time: float  # [s]
    q: Array  # (n,) coordinates
    q_dot: Array  # (n,) rates
    strain: Array  # (points, 6) at the quadrature points, from which the next solution starts
    step: float  # [s], the size to try next, where steps follow a tolerance
    effects: Array = field(
        default_factory=lambda: np.zeros(0)
    )  # (m,) internal states of the scene's effects, one after the other
    names: tuple[str, ...] = ()  # of these effects, see `Model.state_names`

    def __repr__(self) -> str:
        return (
            f"State(at {self.time:g} s, {self.q.size} coordinates, {self.effects.size} internal"
            " states)"
        )

    def save(self, path: str | Path) -> None:
        """Saves the state to an .npz file.

        Args:
            path: of the file.

        Raises:
            OSError: if the file cannot be written.
        """
        values = {}
        for entry in reversed(fields(self)):
            values[entry.name] = getattr(self, entry.name)
        with open(path, "wb") as file:
            np.savez(file, **values)

    @classmethod
    def load(cls, path: str | Path) -> State:
        """Loads a state that `save` wrote.

        Args:
            path: of the .npz file.

        Returns:
            The state, equal to the saved one bit for bit.

        Raises:
            TypeError: for what is no path.
            OSError: if the file cannot be read.
            ValueError: for a file that holds no state.
        """
        saved = read_arrays(path, STATE)
        try:
            time = float(saved.pop("time"))
            step = float(saved.pop("step"))
            names = tuple(map(str, saved.pop("names")))
            return cls(time=time, step=step, names=names, **saved)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} holds no {STATE}: {error}") from error


def checked_motion(model: Model, state: State) -> tuple[Motion, float]:
    """Motion of a state, in arrays of its own, and the step [s] to try next.

    Raises TypeError, ValueError where it is not of the model.
    """
    checked_type("state", state, State, "see Simulation.state")
    q, q_dot = (
        checked_array(f"state.{name}", getattr(state, name), (model.coordinate_count,))
        for name in ("q", "q_dot")
    )
    points = int(model.grid.real.sum())
    shape = (2 * points, 6)
    strain = checked_array("state.strain", state.strain, shape)
    if tuple(state.names) != model.state_names:
        wanted, given = (
            " + ".join(names) or "no effects with states"
            for names in (model.state_names, state.names)
        )
        raise ValueError(
            f"state.names should be those of the model's states, {wanted}; this state is of {given}"
        )
    effects = checked_array("state.effects", state.effects, model.arm.effects.state.shape)
    time = checked_number("state.time", state.time, -np.inf, "a finite number")
    clock = np.array([time])
    packed = model.grid.packed(strain)
    motion = Motion(q, q_dot, packed, effects, clock)
    with model.workspace() as work:
        work.strain.xi[:] = motion.xi
        failed = strain_from_guess(
            model.arm, motion.q, STEP_TOLERANCE, work.strain, work.kinematics
        )
        found = model.grid.unpacked(work.strain.xi)  # empty intervals have no strain that matters
    if failed >= 0 or not np.allclose(
        found, strain, rtol=SAME_STRAIN, atol=SAME_STRAIN * np.abs(strain).max()
    ):
        raise ValueError(
            "state.strain should be the strain at state.q; to start from other coordinates, use"
            " Simulation.reset(q, q_dot)"
        )
    return motion, checked_number(
        "state.step", state.step, SHORTEST, "a positive number of seconds"
    )


def state_of(model: Model, motion: Motion, step: float) -> State:
    """State of a motion, its arrays copied, with the step [s] to try next."""
    strain = model.grid.unpacked(motion.xi)
    effects = motion.state.copy()
    return State(
        float(motion.clock[0]),
        motion.q.copy(),
        motion.q_dot.copy(),
        strain,
        step,
        effects,
        model.state_names,
    )
