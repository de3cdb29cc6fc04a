"""Equilibrium path of a slowly loaded arm: numerical continuation of B u - K + F = 0 from the
unloaded arm to its full load.

Predictor and corrector (Allgower and Georg, Introduction to Numerical Continuation Methods, 1990),
with steps that show that they stayed on the path: the cubic through both ends is an equilibrium in
its middle too, to a small angle, and the arm is stable at all three.
"""

import numpy as np

from soft_tendon_env.model.equilibrium_residual import NEUTRAL, At, Balance, Linearised, Stability
from soft_tendon_env.tools.types import Array

RESIDUAL, ON_THE_WAY = (
    1e-10,
    1e-7,
)  # residual below which forces count as balanced, at the full load and on the way to it
CORRECTION, STRAY, FIRST_REACH = 0.5, 0.1, 3.0
"""[rad] that Newton's method may go from the predicted equilibrium, that the middle of a step may
be off the cubic through its ends, and that the first step may move the arm to first order, its
answer to the tensions alone left out."""
SHORTEST, BEYOND, LEAST_LOAD = (
    2e-5,
    1e-2,
    1e-7,
)  # steps, and how far past its path's end an arm settles, of the load reached; least step
MOST_LINEARISATIONS, MOST_CORRECTIONS, MOST_SETTLINGS = 5000, 25, 20
SLOW, FEW = (
    0.05,
    8,
    # contraction of Newton's method above which its stiffness is computed anew; coordinates up to
    # which that costs little
)
NEAR, SOFT, SOFTEST = 0.05, 0.3, 1e-2
"""[rad] from an equilibrium up to which a stiffness stands for its own where the least eigenvalue
is above SOFT; that of shortest steps."""
WATCHED = 3  # softest modes whose stiffness is watched in the middle of a step
PUSH, FLOW_STEP, SHORTEST_FLOW = (
    1e-3,
    0.1,
    1e-9,
)  # [rad] out of an unstable equilibrium, and of a step that settles; step of its time
SNAPS = "the arm snaps to another shape (limit point: no equilibrium is near)"
BUCKLES = "the arm is no longer stable (bifurcation: it buckles)"
FLUTTERS = "the arm is no longer stable (flutter: oscillations grow)"


class LoadPath:
    """The path of one arm under one load; most: linearisations of the balance after which it is
    given up."""

    def __init__(self, balance: Balance, most: int = MOST_LINEARISATIONS) -> None:
        self.balance, self.most = balance, most
        # with the statics-based strain q = [u; 0] balances the tensions (34): what is left to find
        # is the answer to the effects
        self._answer = balance.model.arm.strain.rest_coordinates(balance.tension)

    def rest(self, settlings: int = 0) -> tuple[Linearised, str]:
        """The last equilibrium on the path, and why it ends there, "" at the full load; before that
        the arm settles so often at most."""
        end, reason = self.follow(self.balance.unloaded())
        for _ in range(settlings):
            if not reason or (point := self.settle(end)) is None:
                break
            end, reason = self.follow(point)
        return end, reason

    def follow(self, point: Linearised) -> tuple[Linearised, str]:
        """Follow the path from `point` to the full load, or to where it ends or loses stability;
        see `rest`."""
        moved = self.balance.angle(point.tangent - self._answer)
        step = 1.0 if moved <= FIRST_REACH else max(FIRST_REACH / moved, LEAST_LOAD)
        while point.at.part < 1.0:
            aim = min(point.at.part + step, 1.0)
            ahead = self.step(point, aim)
            if ahead is not None:
                step, point = 2.0 * (aim - point.at.part), ahead
                continue
            step = 0.5 * (aim - point.at.part)
            is_shortest = step < max(SHORTEST * point.at.part, LEAST_LOAD)
            if not is_shortest and self.balance.linearisations > self.most:
                self.balance.obstacle = (
                    f"the path is too winding, {self.most} iterations did not do"
                )
            if is_shortest or self.balance.linearisations > self.most:
                return point, self._reason(point)
        return point, ""

    def step(self, point: Linearised, aim: float) -> Linearised | None:
        """The equilibrium under `aim` of the load, if it is shown to be on the path through
        `point`."""
        h = aim - point.at.part
        predicted = point.at.q + h * point.tangent
        ahead = self.equilibrium(predicted, aim)
        if ahead is None or not self._is_stable(ahead.stability):
            return None
        soft = max(
            min(1.0, point.stability.least / SOFT, ahead.stability.least / SOFT), SOFTEST
        )  # branches lie close where it is soft
        middle = 0.5 * (point.at.q + ahead.at.q) + 0.125 * h * (point.tangent - ahead.tangent)
        is_near = self.balance.angle(ahead.at.q - predicted) <= soft * CORRECTION
        if (stray := self._stray(middle, point, ahead) if is_near else np.inf) is None:
            return None
        if not stray <= soft * STRAY:
            self.balance.obstacle = "the equilibria bend away from steps of any size"
            return None
        return ahead if self.balance.is_continuous(point.at.q, ahead.at.q) else None

    def equilibrium(self, q: Array, part: float) -> Linearised | None:
        """The equilibrium under this part of the load to which Newton's method leads from q (n,),
        with steps that shrink."""
        tolerance = RESIDUAL if part == 1.0 else ON_THE_WAY
        slow = SLOW if self.balance.size > FEW else 0.0
        here, last = self.balance.linearise(q, part), np.inf
        at = None if here is None else here.at
        for _ in range(MOST_CORRECTIONS + 1):  # the last one is looked at too
            if here is None or at is None:
                return None
            if at.residual <= tolerance:
                return self._point_at(at, here)
            change = here.compliance @ at.force
            size = self.balance.angle(change)
            if not size < last and at is here.at:
                self.balance.obstacle = (
                    f"Newton's method stalled at a residual of {at.residual:.2g}"
                )
                return None
            if size > slow * last and at is not here.at:
                here = self.balance.linearise(at.q, part)
                at = None if here is None else here.at
            else:
                at, last = self.balance.at(at.q + change, part), size
        self.balance.obstacle = (
            f"Newton's method did not balance the forces in {MOST_CORRECTIONS} iterations"
        )
        return None

    def settle(self, end: Linearised) -> Linearised | None:
        """Rest of an arm under the load just beyond the end of its path: the flow G q_dot = f from
        a small push along the softest mode."""
        from scipy.linalg import (
            cho_factor,
            cho_solve,
        )  # here: it takes longer to import than all else that most scenes need

        part, mode, h = (
            min((1.0 + BEYOND) * end.at.part + LEAST_LOAD, 1.0),
            end.stability.modes[:, 0],
            0.1,
        )
        side = self.balance.product(mode, end.tangent) or mode[np.argmax(np.abs(mode))]
        here = self.balance.linearise(end.at.q + PUSH * np.copysign(1.0, side) * mode, part)
        while here is not None and self.balance.linearisations < self.most:
            if here.at.residual <= RESIDUAL:
                return here if self._is_stable(here.stability) else None
            try:
                root = cho_factor(here.at.G + 0.5 * h * (here.stiffness + here.stiffness.T))
            except (
                np.linalg.LinAlgError
            ):  # the step is too long for a motion that runs away from rest
                h *= 0.5
                continue
            change = h * cho_solve(root, here.at.force)
            size = self.balance.angle(change)
            ahead = self.balance.linearise(here.at.q + change, part) if size <= FLOW_STEP else None
            if ahead is not None:
                here, h = ahead, 2.0 * h if size < 0.5 * FLOW_STEP else h
            elif h > SHORTEST_FLOW:
                h *= 0.5
            else:
                return None
        return None

    def _point_at(self, at: At, here: Linearised) -> Linearised | None:
        """The balance around an equilibrium, with the derivatives computed nearby where they will
        do."""
        if at is here.at:
            return here
        if (
            self.balance.angle(at.q - here.at.q) <= NEAR
            and here.stability.has_potential
            and here.stability.least > SOFT
        ):
            here.at = at
            return here
        return self.balance.linearise(at.q, at.part)

    def _stray(self, middle: Array, point: Linearised, ahead: Linearised) -> float | None:
        """How far [rad] coordinates (n,) in the middle of a step are from an equilibrium; None
        where the arm is not stable."""
        part = 0.5 * (point.at.part + ahead.at.part)
        if not ahead.stability.has_potential:
            here = self.balance.linearise(middle, part)
            if here is None or not self._is_stable(here.stability):
                return None
            return self.balance.angle(here.compliance @ here.at.force)
        found = self.balance.curvature(middle, part, ahead.stability.modes[:, :WATCHED])
        if found is None:
            return None
        at, curvature = found
        least = float(np.linalg.eigvalsh(0.5 * (curvature + curvature.T))[0])
        if not self._is_stable(ahead.stability._replace(stable=least > -NEUTRAL * len(middle))):
            return None
        return max(self.balance.angle(end.compliance @ at.force) for end in (point, ahead))

    def _is_stable(self, stability: Stability) -> bool:
        """Whether it is; the obstacle where it is not."""
        if not stability.stable:
            self.balance.obstacle = FLUTTERS if stability.flutters else BUCKLES
        return stability.stable

    def _reason(self, point: Linearised) -> str:
        """Why the path goes no further than this point."""
        obstacle, stability = self.balance.obstacle, point.stability
        if stability.least < SOFT and not obstacle.startswith("no strain") and obstacle != FLUTTERS:
            softest = abs(self.balance.product(stability.modes[:, 0], point.tangent))
            obstacle = SNAPS if softest > 0.5 * self.balance.angle(point.tangent) else BUCKLES
        return f"beyond {100 * point.at.part:.4g} % of the load: {obstacle}"
