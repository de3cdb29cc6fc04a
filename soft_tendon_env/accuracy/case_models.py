"""Models under the loads of a trial, and their motions.

A motion ends where it strays from the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.accuracy.reference import (
    ReferenceMotion,
    continued,
    distance,
    pieces,
    start_at_rest,
    tip_path,
)
from soft_tendon_env.effects import Effects
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.types import Array


class TrialInput(NamedTuple):
    """One input of a trial."""

    reference: ReferenceMotion
    case: int  # of the loads
    rows: int = 0  # of commands through which the reference is certain; 0 of an equilibrium
    share: float = 1.0  # of the commands that motions usually have

    @property
    def bound(self) -> float:
        """Bound of the reference's error [m] as far as it is certain."""
        errors = self.reference.errors
        if self.rows < len(errors):
            return float(errors[self.rows])
        return np.inf

    def distance(self, path: Array | None) -> float:
        """Largest distance [m] of a path from the reference as far as that is certain."""
        tips = self.reference.tips
        samples = self.rows + 1
        if tips is None or len(tips) < samples:
            return np.nan
        return distance(path, tips[:samples])

    @property
    def commands(self) -> Array:
        """Commands (rows, n_a) of a motion, or tensions (n_a,) [N] of an equilibrium."""
        return self.reference.commands


class CaseModels:
    """A model under the loads of each case, and where its motions start."""

    def __init__(self, cases: Sequence[Effects], model: Model) -> None:
        self._cases = cases
        self._models = {0: model}
        self._starts: dict[int, State | None] = {}

    def model(self, case: int) -> Model:
        """The model under the loads of a case."""
        if case not in self._models:
            own = self._models[0]
            changes = {"effects": self._cases[case]}
            loaded = own.scene.replace(changes)
            self._models[case] = own.with_scene(loaded)
        return self._models[case]

    def path(self, test: TrialInput, hopeless: float = np.inf) -> Array | None:
        """Positions of the tip in a test as far as its reference is certain, see `tip_path`.

        None where it has none, or is farther from the reference than `hopeless` [m] at a time.
        """
        if test.reference.is_equilibrium:
            return tip_path(self.model(test.case), test.commands)
        path = self._begun(test, hopeless)
        sample_count = test.rows + 1
        is_whole = path is not None and len(path) == sample_count
        if not is_whole:
            return None
        return path

    def bounds(self, test: TrialInput) -> Array:
        """Bounds (samples,) [m] of the tip's distance in a motion up to each sample.

        They go as far as the model has the motion and the reference knows of it.
        """
        reference = test.reference
        samples = len(reference.errors)
        shorter = test._replace(rows=samples - 1)
        path = self._begun(shorter, np.inf)
        if path is None or reference.tips is None:
            return np.zeros(0)
        samples = len(path)
        expected = reference.tips[:samples]
        away = np.linalg.norm(path - expected, axis=1)
        errors = reference.errors[:samples]
        return np.asarray(np.maximum.accumulate(away) + errors)

    def _begun(self, test: TrialInput, hopeless: float) -> Array | None:
        """Positions of the tip (samples, 3) [m] in a motion, to where it strays or ends."""
        model = self.model(test.case)
        if test.case not in self._starts:
            self._starts[test.case] = start_at_rest(model)
        state = self._starts[test.case]
        tips = test.reference.tips
        assert tips is not None  # of every test that is kept

        # piece by piece, so that a motion which strays ends early
        path: Array | None = None
        commands = test.commands[: test.rows]
        for piece in pieces(model, commands, state):
            path = continued(path, piece)
            expected = tips[: len(path)]
            if distance(path, expected) > hopeless:
                return None
        return path
