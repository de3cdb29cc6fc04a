"""Models under the loads of a trial, and their motions.

A motion ends where it strays from the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.accuracy.reference import (
    ReferenceMotion,
    distance,
    start_at_rest,
    tip_path,
    trajectory,
)
from soft_tendon_env.effects import Effects
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.types import Array

LOOKED_AT = 5
"""Rows of tensions after which a motion ends that is too far from full physics already."""


class TrialInput(NamedTuple):
    """One input of a trial."""

    reference: ReferenceMotion
    case: int  # of the loads

    @property
    def tensions(self) -> Array:
        """(rows, n_a) [N] of a motion, (n_a,) of an equilibrium."""
        return self.reference.tensions


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
            loaded = own.scene.replace({"effects": self._cases[case]})
            self._models[case] = own.with_scene(loaded)
        return self._models[case]

    def path(self, test: TrialInput, hopeless: float = np.inf) -> Array | None:
        """Positions of the tip in a test, see `tip_path`.

        None where it has none, or is farther from the reference than `hopeless` [m] at a time.
        """
        model = self.model(test.case)
        if test.reference.is_equilibrium:
            return tip_path(model, test.tensions)
        if test.case not in self._starts:
            self._starts[test.case] = start_at_rest(model)
        state = self._starts[test.case]
        tips = test.reference.tips
        assert tips is not None  # of every test that is kept

        # piece by piece, so that a motion which strays ends early; a state continues bit for bit
        pieces = []
        for begin in range(0, len(test.tensions), LOOKED_AT):
            rows = test.tensions[begin : begin + LOOKED_AT]
            motion = None if state is None else trajectory(model, rows, state)
            if motion is None:
                return None
            piece = motion.tip_pose[:, :3, 3]
            end = begin + len(piece)
            if distance(piece, tips[begin:end]) > hopeless:
                return None
            state = motion.final
            # a piece begins with the last sample of the one before
            pieces.append(piece[1:] if begin else piece)
        return np.concatenate(pieces)
