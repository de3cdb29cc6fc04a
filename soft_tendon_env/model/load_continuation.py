"""Equilibrium path of a slowly loaded arm by numerical continuation.

It solves B u - K + F = 0 from the unloaded arm to its full load.

Predictor and corrector (Allgower and Georg, Introduction to Numerical Continuation Methods, 1990),
with steps that show that they stayed on the path: the cubic through both ends is an equilibrium in
its middle too, to a small angle, and the arm is stable at all three.
"""

import numpy as np

from soft_tendon_env.model.equilibrium_residual import (
    NEUTRAL,
    Balance,
    Evaluation,
    Linearised,
    Stability,
)
from soft_tendon_env.tools.types import Array

# residual below which forces count as balanced, at the full load
RESIDUAL = 1e-10
# the same on the way to the full load
ON_THE_WAY = 1e-7
# way [rad] that Newton's method may go from the predicted equilibrium
CORRECTION = 0.5
# angle [rad] that the middle of a step may be off the cubic through its ends
STRAY = 0.1
# way [rad] that the first step may move the arm to first order, its answer to the tensions alone
# left out
FIRST_REACH = 3.0
# shortest step, as a share of the load reached
SHORTEST = 2e-5
# how far past its path's end an arm settles, as a share of the load reached
BEYOND = 1e-2
# least step, as a share of the full load
LEAST_LOAD = 1e-7
# linearisations of the balance after which a path is given up
MOST_LINEARISATIONS = 5000
# iterations of Newton's method
MOST_CORRECTIONS = 25
# times that an arm settles beyond the ends of its paths
MOST_SETTLINGS = 20
# contraction of Newton's method above which its stiffness is computed anew
SLOW = 0.05
# coordinates up to which computing it anew costs little
FEW = 8
# angle [rad] from an equilibrium up to which a stiffness stands for its own
NEAR = 0.05
# least eigenvalue of a stiffness, 1 for the unloaded arm, below which branches lie close
SOFT = 0.3
# share of the allowed angles of steps that is left where the arm is softest
SOFTEST = 1e-2
# softest modes whose stiffness is watched in the middle of a step
WATCHED = 3
# push [rad] out of an unstable equilibrium
PUSH = 1e-3
# angle [rad] of a step that settles
FLOW_STEP = 0.1
# first step of time of an arm that settles, in units of its flow
FIRST_FLOW = 0.1
# shortest step of time of an arm that settles
SHORTEST_FLOW = 1e-9
# reasons why paths end
SNAPS = "the arm snaps to another shape (limit point: no equilibrium is near)"
BUCKLES = "the arm is no longer stable (bifurcation: it buckles)"
FLUTTERS = "the arm is no longer stable (flutter: oscillations grow)"


class LoadPath:
    """The path of one arm under one load."""

    def __init__(self, balance: Balance, most: int = MOST_LINEARISATIONS) -> None:
        """most: linearisations of the balance after which the path is given up."""
        self.balance = balance
        self.most = most
        # with the statics-based strain q = [u; 0] balances the tensions (34): what is left to find
        # is the answer to the effects
        strain = balance.model.arm.strain
        self._answer = strain.rest_coordinates(balance.tension)

    def rest(self, settlings: int = 0) -> tuple[Linearised, str]:
        """The last equilibrium on the path, and why it ends there, "" at the full load.

        Args:
            settlings: times that the arm settles at most, before it reaches the full load.
        """
        begin = self.balance.unloaded()
        end, reason = self.follow(begin)
        for _ in range(settlings):
            if not reason:
                break
            settled = self.settle(end)
            if settled is None:
                break
            end, reason = self.follow(settled)
        return end, reason

    def follow(self, point: Linearised) -> tuple[Linearised, str]:
        """Follow the path to the full load, or to where it ends or loses stability; see `rest`.

        Args:
            point: of the path, from which it is followed.
        """
        balance = self.balance
        change = point.tangent - self._answer
        way = balance.angle(change)
        step = 1.0
        if way > FIRST_REACH:
            step = max(FIRST_REACH / way, LEAST_LOAD)
        while point.evaluation.part < 1.0:
            part = point.evaluation.part
            aim = min(part + step, 1.0)
            ahead = self.step(point, aim)
            if ahead is not None:
                step = 2.0 * (aim - part)
                point = ahead
                continue
            step = 0.5 * (aim - part)
            shortest = max(SHORTEST * part, LEAST_LOAD)
            is_shortest = step < shortest
            is_too_long = balance.linearisations > self.most
            if is_too_long and not is_shortest:
                balance.obstacle = f"the path is too winding, {self.most} iterations did not do"
            if is_shortest or is_too_long:
                return point, self._reason(point)
        return point, ""

    def step(self, point: Linearised, aim: float) -> Linearised | None:
        """The equilibrium under `aim` of the load, if it is shown to be on the path.

        Args:
            point: of the path, where the step begins.
            aim: part of the load, 0 to 1.
        """
        balance = self.balance
        q = point.evaluation.q
        h = aim - point.evaluation.part
        predicted = q + h * point.tangent
        ahead = self.equilibrium(predicted, aim)
        if ahead is None or not self._is_stable(ahead.stability):
            return None
        # branches lie close where the arm is soft
        least = min(point.stability.least, ahead.stability.least)
        softness = min(1.0, least / SOFT)
        soft = max(softness, SOFTEST)
        q_ahead = ahead.evaluation.q
        correction = balance.angle(q_ahead - predicted)
        if correction <= soft * CORRECTION:
            # of the cubic through both ends
            tangent_change = point.tangent - ahead.tangent
            mean = 0.5 * (q + q_ahead)
            bow = 0.125 * h * tangent_change
            middle = mean + bow
            stray = self._stray(middle, point, ahead)
            if stray is None:
                return None
        else:
            stray = np.inf
        if not stray <= soft * STRAY:
            balance.obstacle = "the equilibria bend away from steps of any size"
            return None
        if not balance.is_continuous(q, q_ahead):
            return None
        return ahead

    def equilibrium(self, q: Array, part: float) -> Linearised | None:
        """The equilibrium under this part of the load to which Newton's method leads.

        Its steps have to shrink.

        Args:
            q: coordinates (n,) to start from.
            part: of the load, 0 to 1.
        """
        balance = self.balance
        if part == 1.0:
            tolerance = RESIDUAL
        else:
            tolerance = ON_THE_WAY
        if balance.size > FEW:
            slow = SLOW
        else:
            slow = 0.0
        linearised = balance.linearise(q, part)
        if linearised is None:
            current = None
        else:
            current = linearised.evaluation
        last_size = np.inf
        # what the last correction leads to is looked at too
        for _ in range(MOST_CORRECTIONS + 1):
            if linearised is None or current is None:
                return None
            if current.residual <= tolerance:
                return self._point_at(current, linearised)
            change = linearised.compliance @ current.force
            size = balance.angle(change)
            # whether the stiffness is that of these coordinates
            is_own = current is linearised.evaluation
            if is_own and not size < last_size:
                balance.obstacle = (
                    f"Newton's method stalled at a residual of {current.residual:.2g}"
                )
                return None
            if size > slow * last_size and not is_own:
                linearised = balance.linearise(current.q, part)
                if linearised is None:
                    current = None
                else:
                    current = linearised.evaluation
            else:
                current = balance.at(current.q + change, part)
                last_size = size
        balance.obstacle = (
            f"Newton's method did not balance the forces in {MOST_CORRECTIONS} iterations"
        )
        return None

    def settle(self, end: Linearised) -> Linearised | None:
        """Rest of an arm under the load just beyond the end of its path.

        It follows the flow G q_dot = f from a small push along the softest mode.

        Args:
            end: of the path.
        """
        balance = self.balance
        enlarged = (1.0 + BEYOND) * end.evaluation.part
        beyond = enlarged + LEAST_LOAD
        part = min(beyond, 1.0)
        mode = end.stability.modes[:, 0]
        place = np.argmax(np.abs(mode))
        largest_entry = mode[place]
        side = balance.product(mode, end.tangent) or largest_entry
        sign = np.copysign(1.0, side)
        push = PUSH * sign * mode
        pushed = end.evaluation.q + push
        point = balance.linearise(pushed, part)
        h = FIRST_FLOW
        while point is not None and balance.linearisations < self.most:
            if point.evaluation.residual <= RESIDUAL:
                if not self._is_stable(point.stability):
                    return None
                return point
            q = point.evaluation.q
            change = _flow(point, h)
            size = balance.angle(change)
            ahead = None
            if size <= FLOW_STEP:
                ahead = balance.linearise(q + change, part)
            if ahead is not None:
                point = ahead
                if size < 0.5 * FLOW_STEP:
                    h *= 2.0
            elif h > SHORTEST_FLOW:
                h *= 0.5
            else:
                return None
        return None

    def _point_at(self, equilibrium: Evaluation, linearised: Linearised) -> Linearised | None:
        """Balance around an equilibrium, linearised.

        The derivatives are those computed nearby where they will do.
        """
        if equilibrium is linearised.evaluation:
            return linearised
        difference = equilibrium.q - linearised.evaluation.q
        way = self.balance.angle(difference)
        stability = linearised.stability
        is_stiff = stability.has_potential and stability.least > SOFT
        if way <= NEAR and is_stiff:
            linearised.evaluation = equilibrium
            return linearised
        return self.balance.linearise(equilibrium.q, equilibrium.part)

    def _stray(self, middle: Array, point: Linearised, ahead: Linearised) -> float | None:
        """How far [rad] the middle of a step is from an equilibrium.

        Args:
            middle: coordinates (n,).
            point: where the step begins.
            ahead: where it ends.

        Returns:
            The angle; None where the arm is not stable.
        """
        balance = self.balance
        sum_of_parts = point.evaluation.part + ahead.evaluation.part
        part = 0.5 * sum_of_parts
        if not ahead.stability.has_potential:
            linearised = balance.linearise(middle, part)
            if linearised is None or not self._is_stable(linearised.stability):
                return None
            force = linearised.evaluation.force
            return balance.angle(linearised.compliance @ force)
        watched = ahead.stability.modes[:, :WATCHED]
        balanced = balance.curvature(middle, part, watched)
        if balanced is None:
            return None
        at_middle, curvature = balanced
        symmetric = 0.5 * (curvature + curvature.T)
        eigenvalues = np.linalg.eigvalsh(symmetric)
        least = float(eigenvalues[0])
        is_stable = least > -NEUTRAL * len(middle)
        stability = ahead.stability._replace(stable=is_stable)
        if not self._is_stable(stability):
            return None
        # by the stiffnesses at either end
        force = at_middle.force
        from_point = balance.angle(point.compliance @ force)
        from_ahead = balance.angle(ahead.compliance @ force)
        return max(from_point, from_ahead)

    def _is_stable(self, stability: Stability) -> bool:
        """Whether it is; the obstacle where it is not."""
        if not stability.stable:
            if stability.flutters:
                self.balance.obstacle = FLUTTERS
            else:
                self.balance.obstacle = BUCKLES
        return stability.stable

    def _reason(self, point: Linearised) -> str:
        """Why the path goes no further than this point."""
        balance = self.balance
        obstacle = balance.obstacle
        stability = point.stability
        is_known = obstacle.startswith("no strain") or obstacle == FLUTTERS
        if stability.least < SOFT and not is_known:
            softest_mode = stability.modes[:, 0]
            along_mode = abs(balance.product(softest_mode, point.tangent))
            tangent_size = balance.angle(point.tangent)
            # at a limit point the path goes on along the softest mode, at a bifurcation it does not
            snaps = along_mode > 0.5 * tangent_size
            if snaps:
                obstacle = SNAPS
            else:
                obstacle = BUCKLES
        percent = 100 * point.evaluation.part
        return f"beyond {percent:.4g} % of the load: {obstacle}"


def _flow(point: Linearised, h: float) -> Array:
    """Change of coordinates (n,) by a linearly implicit step of the flow G q_dot = f.

    It is infinite where the step is too long for a motion that runs away from rest.

    Args:
        point: the balance to first order.
        h: the step of time.
    """
    # here: it takes longer to import than all else that most scenes need
    from scipy.linalg import cho_factor, cho_solve

    force = point.evaluation.force
    symmetric = point.stiffness + point.stiffness.T
    try:
        damping = 0.5 * h * symmetric
        root = cho_factor(point.evaluation.G + damping)
    except np.linalg.LinAlgError:
        return np.full_like(force, np.inf)
    rate = cho_solve(root, force)
    return np.asarray(h * rate)
