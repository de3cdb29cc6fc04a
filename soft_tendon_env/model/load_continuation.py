"""Equilibrium path of a slowly loaded arm: numerical continuation of B u - K + F = 0 from the unloaded arm to its full load.

Predictor and corrector (Allgower and Georg, Introduction to Numerical Continuation Methods, 1990), with steps that show that they stayed on
the path: the cubic through both ends is an equilibrium in its middle too, to a small angle, and the arm is stable at all three.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.model.equilibrium_residual import NEUTRAL, At, Balance, Linearised, Stability
from soft_tendon_env.tools.types import Array

RESIDUAL, ON_THE_WAY = 1e-10, 1e-7
"""Residual, see statics.Equilibrium, below which forces count as balanced, at the full load and on the way to it."""
CORRECTION, STRAY, FIRST_REACH = 0.5, 0.1, 3.0
"""[rad] that Newton's method may go from the predicted equilibrium, that the middle of a step may be off the cubic through its ends, and
that the first step may move the arm to first order, its answer to the tensions alone left out."""
SHORTEST, BEYOND, LEAST_LOAD = 2e-5, 1e-2, 1e-7
"""Step, as a share of the load that was reached: a limit is told to this accuracy; how far past the end of its path an arm settles; and the
load below which no step is tried."""
MOST_LINEARISATIONS, MOST_CORRECTIONS, MOST_SETTLINGS = 5000, 25, 20
SLOW, FEW = 0.05, 8  # contraction of Newton's method above which its stiffness is computed anew; coordinates up to which that costs little
NEAR, SOFT, SOFTEST = 0.05, 0.3, 1e-2
"""[rad] from an equilibrium up to which a stiffness stands for its own, where the least eigenvalue, 1 for the unloaded arm, is above SOFT;
and that below which steps need be no shorter."""
WATCHED = 3  # softest modes whose stiffness is watched in the middle of a step
PUSH, FLOW_STEP, SHORTEST_FLOW = 1e-3, 0.1, 1e-9
"""[rad] out of an equilibrium that is not stable, and of a step of an arm that settles; step of its time, in that in which damping lets a
stiffness like the unloaded arm's relax."""
SNAPS = "the arm snaps to another shape (limit point: no equilibrium is near)"
BUCKLES = "the arm is no longer stable (bifurcation: it buckles)"
FLUTTERS = "the arm is no longer stable (flutter: oscillations grow)"


class Point(NamedTuple):
    """An equilibrium on the path."""

    at: At
    tangent: Array  # dq/dpart (n,)
    compliance: Array  # S^-1 (n, n)
    stability: Stability


class End(NamedTuple):
    """The last equilibrium of a path, and why it ends there; no reason at the full load."""

    point: Point
    reason: str


class LoadPath:
    """The path of one arm under one load; most: linearisations of the balance after which it is given up."""

    def __init__(self, balance: Balance, most: int = MOST_LINEARISATIONS) -> None:
        self.balance, self.most = balance, most
        model = balance.model
        # with the statics-based strain q = [u; 0] balances the tensions (34): what is left to find is the answer to the effects
        self._answer = model.arm.strain.rest_coordinates(balance.tension)

    def start(self) -> Point:
        """The unloaded arm."""
        return self._point(self.balance.unloaded)

    def rest(self, settlings: int = 0) -> End:
        """Follow the path from the unloaded arm; where it ends let the arm go, at most so many times, and load it further."""
        end = self.end(self.start())
        for _ in range(settlings):
            if not end.reason or (point := self.settled(end)) is None:
                break
            end = self.end(point)
        return end

    def end(self, point: Point) -> End:
        """Follow the path from `point` to the full load, or to where it ends or loses stability."""
        moved = self.balance.angle(point.tangent - self._answer)
        step = 1.0 if moved <= FIRST_REACH else max(FIRST_REACH / moved, LEAST_LOAD)
        while point.at.part < 1.0:
            aim = min(point.at.part + step, 1.0)
            ahead = self.step(point, aim)
            if ahead is not None:
                step, point = 2.0 * (aim - point.at.part), ahead
                continue
            step = 0.5 * (aim - point.at.part)
            if step < max(SHORTEST * point.at.part, LEAST_LOAD):
                return End(point, self._reason(point))
            if self.balance.linearisations > self.most:
                self.balance.obstacle = f"the path is too winding, {self.most} iterations did not do"
                return End(point, self._reason(point))
        return End(point, "")

    def step(self, point: Point, aim: float) -> Point | None:
        """The equilibrium under `aim` of the load, if it is shown to be on the path through `point`."""
        h = aim - point.at.part
        predicted = point.at.q + h * point.tangent
        ahead = self.equilibrium(predicted, aim)
        if ahead is None or not self._holds(ahead.stability):
            return None
        soft = max(min(1.0, point.stability.least / SOFT, ahead.stability.least / SOFT), SOFTEST)  # branches lie close where it is soft
        middle = 0.5 * (point.at.q + ahead.at.q) + 0.125 * h * (point.tangent - ahead.tangent)
        is_near = self.balance.angle(ahead.at.q - predicted) <= soft * CORRECTION
        if (stray := self._stray(middle, point, ahead) if is_near else np.inf) is None:
            return None
        if not stray <= soft * STRAY:
            self.balance.obstacle = "the equilibria bend away from steps of any size"
            return None
        return ahead if self.balance.is_continuous(point.at.q, ahead.at.q) else None

    def equilibrium(self, q: Array, part: float) -> Point | None:
        """The equilibrium under this part of the load to which Newton's method leads from q (n,), with steps that shrink."""
        tolerance = RESIDUAL if part == 1.0 else ON_THE_WAY
        slow = SLOW if self.balance.size > FEW else 0.0
        here, last = self.balance.linearised(q, part), np.inf
        at = here and here.at
        for _ in range(MOST_CORRECTIONS + 1):  # the last one is looked at too
            if here is None or at is None:
                return None
            if at.residual <= tolerance:
                return self._point_near(at, here)
            change = here.compliance @ at.force
            size = self.balance.angle(change)
            if not size < last and at is here.at:
                self.balance.obstacle = f"Newton's method stalled at a residual of {at.residual:.2g}"
                return None
            if size > slow * last and at is not here.at:
                here = self.balance.linearised(at.q, part)
                at = here and here.at
            else:
                at, last = self.balance.at(at.q + change, part), size
        self.balance.obstacle = f"Newton's method did not balance the forces in {MOST_CORRECTIONS} iterations"
        return None

    def settled(self, end: End) -> Point | None:
        """Rest of an arm under the load just beyond the end of its path, to which it moves slowly: damping alone resists.

        The flow G q_dot = f by linearly implicit Euler steps of at most FLOW_STEP, from a small push along the softest mode.
        """
        from scipy.linalg import cho_factor, cho_solve  # here: it takes longer to import than all else that most scenes need

        before, part = end.point.at, min((1.0 + BEYOND) * end.point.at.part + LEAST_LOAD, 1.0)
        mode, h = end.point.stability.modes[:, 0], 0.1
        side = self.balance.product(mode, end.point.tangent) or mode[np.argmax(np.abs(mode))]
        here = self.balance.linearised(before.q + PUSH * np.copysign(1.0, side) * mode, part)
        while here is not None and self.balance.linearisations < self.most:
            if here.at.residual <= RESIDUAL:
                found = self._point(here)
                return found if self._holds(found.stability) else None
            try:
                root = cho_factor(here.at.G + 0.5 * h * (here.stiffness + here.stiffness.T))
            except np.linalg.LinAlgError:  # the step is too long for a motion that runs away from rest
                h *= 0.5
                continue
            change = h * cho_solve(root, here.at.force)
            size = self.balance.angle(change)
            ahead = self.balance.linearised(here.at.q + change, part) if size <= FLOW_STEP else None
            if ahead is not None:
                here, h = ahead, 2.0 * h if size < 0.5 * FLOW_STEP else h
            elif h > SHORTEST_FLOW:
                h *= 0.5
            else:
                return None
        return None

    def _point(self, here: Linearised) -> Point:
        return Point(here.at, here.tangent, here.compliance, self.balance.stability(here))

    def _point_near(self, at: At, here: Linearised) -> Point | None:
        """The point at an equilibrium, with the derivatives computed nearby where they will do."""
        if at is here.at or self.balance.angle(at.q - here.at.q) <= NEAR:
            near = self._point(here)._replace(at=at)
            if at is here.at or near.stability.has_potential and near.stability.least > SOFT:
                return near
        own = self.balance.linearised(at.q, at.part)
        return None if own is None else self._point(own)

    def _stray(self, middle: Array, point: Point, ahead: Point) -> float | None:
        """How far [rad] coordinates (n,) in the middle of a step are from an equilibrium; None where the arm is not stable."""
        part = 0.5 * (point.at.part + ahead.at.part)
        if not ahead.stability.has_potential:
            here = self.balance.linearised(middle, part)
            holds = here is not None and self._holds(self.balance.stability(here))
            return self.balance.angle(here.compliance @ here.at.force) if here is not None and holds else None
        watched = self.balance.curvature(middle, part, ahead.stability.modes[:, :WATCHED])
        if watched is None:
            return None
        at, curvature = watched
        least = float(np.linalg.eigvalsh(0.5 * (curvature + curvature.T))[0])
        if not self._holds(ahead.stability._replace(stable=least > -NEUTRAL * len(middle))):
            return None
        return max(self.balance.angle(end.compliance @ at.force) for end in (point, ahead))

    def _holds(self, stability: Stability) -> bool:
        if not stability.stable:
            self.balance.obstacle = FLUTTERS if stability.flutters else BUCKLES
        return stability.stable

    def _reason(self, point: Point) -> str:
        """Why the path goes no further than this point."""
        obstacle, stability = self.balance.obstacle, point.stability
        if stability.least < SOFT and not obstacle.startswith("no strain") and obstacle != FLUTTERS:
            softest = abs(self.balance.product(stability.modes[:, 0], point.tangent))
            obstacle = SNAPS if softest > 0.5 * self.balance.angle(point.tangent) else BUCKLES
        return f"beyond {100 * point.at.part:.4g} % of the load: {obstacle}"
