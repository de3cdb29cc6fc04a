"""State of a simulation: everything that the next step depends on, in memory and as a file."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from soft_tendon_env.tools.files import read_arrays
from soft_tendon_env.tools.types import Array

STATE = "state that State.save wrote"
LATER = ("effects", "names")
"""Fields that files may lack."""


@dataclass(frozen=True, eq=False)
class State:
    """State of a simulation, everything that the next step depends on: a saved state continues bit for bit.

    time [s]; q, q_dot (n,) coordinates and rates; strain (points, 6) at the quadrature points, from which the next solution starts;
    step [s] the size to try next, where steps follow a tolerance: those of fixed size begin with the scene's; effects (m,) the internal
    states of the scene's effects, one after the other; names: what q and effects are of, see `Model.state_names`. A state without names
    is taken where it has no internal states.
    """

    time: float
    q: Array
    q_dot: Array
    strain: Array
    step: float
    effects: Array = field(default_factory=lambda: np.zeros(0))
    names: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"State(at {self.time:g} s, {self.q.size} coordinates, {self.effects.size} internal states)"

    def save(self, path: str | Path) -> None:
        """Saves the state to an .npz file."""
        with open(path, "wb") as file:
            # names first: a damaged length in an archive hides what comes behind it, which then is missing
            np.savez(file, **{own.name: getattr(self, own.name) for own in reversed(fields(self))})

    @classmethod
    def load(cls, path: str | Path) -> State:
        """Loads a state that `save` wrote. Raises TypeError, OSError or ValueError."""
        saved = read_arrays(path, [own.name for own in fields(cls) if own.name not in LATER], STATE, optional=LATER)
        try:
            time, step = float(saved.pop("time")), float(saved.pop("step"))
            names = tuple(map(str, saved.pop("names", ())))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path} holds no {STATE}: {error}") from error
        return cls(time=time, step=step, names=names, **saved)
