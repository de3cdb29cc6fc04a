"""Approximate static equilibrium of an arm on one quadrature, by a trust region, in a millisecond: what quadratures are compared at.

The search is a trust region on the work of the unbalanced force f = B u - K + F: a step counts if f does work along it, so it
descends in energy, to a stable equilibrium, and needs no potential. It is not exact and follows no branch: see statics.py for that.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.motion.equilibrium import ROUND_OFF
from soft_tendon_env.mechanics.terms.evaluate import configure_from_rest, evaluate_at_rest
from soft_tendon_env.mechanics.types import Implicit, Loaded
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.coordinates import make_arm
from soft_tendon_env.model.grid import make_grid, screw_matrices
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

NEAR = 3e-3
"""Residual [rad], see `Probe.residual`, of a state that stands for the equilibrium beside it."""
TIGHT = 1e-6
"""Residual [rad] of a state whose tip counts as that of the equilibrium."""
FIRST_BEND = 1.5  # [rad] that the first part of a load bends the arm by, and that one step bends it by at first
GROWTH = 4.0  # of the parts of a load
HEAVIEST = 1e6  # [rad] that a load would bend the unloaded arm by, beyond which its first part is no smaller
MOST_BEND = 30.0  # [rad] by loads, five times around: what bends the arm further stands for nothing real
MOST_STRETCH = 1.0  # change of length, or shear, as a share of the length: a linear material law stands for nothing real beyond
DIFFERENCE = 1e-6  # [rad] of bending, for derivatives
MAX_STEPS = 50  # from a load that buckles the arm, a step can do no more than double a small bend
SOFTEST = 0.05  # least stiffness, of that without loads, that a step trusts in
NEUTRAL = 1e-3  # the same for an estimate, which is only the first where an arm is soft


class Held(NamedTuple):
    """A state near rest under a part of tensions and effects."""

    q: Array  # (n,)
    tension: Array  # (n_a,) [N], the part of it
    part: float
    compliance: Array  # (n, n), S^-1, eigenvalues bounded
    least: float  # eigenvalue of S, 1 for the unloaded arm


class _Modes(NamedTuple):
    """The stiffness S = V^-T diag(sizes) V^-1 in units of G, with V^T G V = I."""

    sizes: Array  # (n,)
    directions: Array  # V (n, n)


class Probe:
    """The arm of a scene with `intervals` per piece."""

    def __init__(self, scene: Scene, intervals: int) -> None:
        self.grid = make_grid(scene, intervals)
        self.arm = make_arm(scene, self.grid)
        strain, self.size, self.length = self.arm.strain, self.arm.strain.size, float(self.grid.breakpoints[-1])
        self.implicit = isinstance(strain, Implicit)
        self.has_loads = self.arm.effects.load or isinstance(strain, Loaded)
        self.rests_elsewhere = self.arm.effects.load or (isinstance(strain, Implicit) and strain.law.mixed)
        self.work = make_workspace(self.arm)
        bending = screw_matrices(scene, self.grid.points.ravel())[0][:, 1]
        self.energy = float(bending @ self.grid.weights.ravel()) / self.length**2

    @property
    def tip(self) -> Array:
        """Position (3,) of the tip [m]."""
        return self.work.pose.reshape(-1, 12, LANES)[-1, 9:, -1].copy()

    @property
    def tip_jacobian(self) -> Array:
        """Derivative (3, n) of the tip's position, base frame."""
        rotation = self.work.pose.reshape(-1, 12, LANES)[-1, :9, -1].reshape(3, 3)
        last = slice(-6 * LANES + LANES - 1, None, LANES)
        return np.asarray(rotation @ self.work.J.reshape(self.size, -1)[:, last].T[3:])

    def rest(self, tension: Array) -> Array:
        """Coordinates (n,) under tensions (n_a,) without effects, as far as they are known without a search."""
        return np.asarray(self.arm.strain.rest_coordinates(tension))

    def place(self, q: Array) -> float:
        """Strain and poses at q; the part of q that was reached, 1 where it has a strain."""
        block, reached = configure_from_rest(self.arm, q, ROUND_OFF, self.work)
        return 1.0 if block < 0 else float(reached)

    @property
    def stretch(self) -> float:
        """Largest stretch or shear, as a share of MOST_STRETCH; after place()."""
        linear = (self.work.xi - self.arm.rod.reference_strain).reshape(-1, 6, LANES)[:, 3:]
        return float(np.abs(linear).max()) / MOST_STRETCH

    def force(self, tension: Array, q: Array, part: float) -> Array | None:
        """f (n,) under the part of the effects, and all else of an evaluation in `work`, from the strain of the last call; None: none."""
        block = evaluate_at_rest(self.arm, tension, q, ROUND_OFF, self.work)
        force = self.work.drive + part * self.work.load
        return force if block < 0 and np.isfinite(force).all() else None

    def force_at(self, held: Held) -> Array | None:
        """f (n,) at the coordinates and loads of a state, wherever it was found."""
        return self.force(held.tension, held.q, held.part) if self.place(held.q) == 1.0 else None

    def relax(self) -> bool:
        """Evaluate the arm without tensions at q = 0; whether that can be done."""
        return self.force_at(Held(np.zeros(self.size), np.zeros(self.arm.tendons.size), 0.0, np.empty((0, 0)), 1.0)) is not None

    def hold(self, tension: Array, near: Array | None = None) -> Held | None:
        """A state near rest under tensions and effects, or under the largest part of them that it was found for; None: under none.

        near (n,): coordinates beside which there is likely one under the whole of them, such as those on another quadrature.
        """
        if near is not None and near.size == self.size and (beside := self.find(tension, near, 1.0, NEAR)) is not None:
            return beside
        q, held, reached = np.zeros(self.size), None, 0.0
        for part in self.parts(tension):
            q = q + self.rest((part - reached) * tension)
            found = self.find(part * tension, q, part, NEAR)
            if found is None or self.angle(found.q - self.rest(found.tension)) > MOST_BEND:
                break
            held, q, reached = found, found.q, part
        return held

    def parts(self, tension: Array) -> Array:
        """Growing parts of a load, up to 1; the first bends the arm by FIRST_BEND or less and takes at most twice its stiffness."""
        q = np.zeros(self.size)
        self.place(q)
        pulls = np.zeros_like(tension) if self.implicit else tension
        force = self.force(pulls, q, 1.0)
        angle = 0.0 if force is None else min(self.residual(force, q), HEAVIEST)  # infinite where tensions push past all stiffness
        modes = None if force is None else self.modes(pulls, q, 1.0)
        softened = 0.0 if modes is None else min(-float(modes.sizes[0]), HEAVIEST)  # an arm that its load buckles bends by far more
        return GROWTH ** np.arange(-np.ceil(np.log(max(angle / FIRST_BEND, softened, 1.0)) / np.log(GROWTH)), 1.0)

    def find(self, tension: Array, q: Array, part: float, tolerance: float) -> Held | None:
        """A state near rest, from q."""
        if self.place(q) < 1.0 or (force := self.force(tension, q, part)) is None:
            return None
        modes, limit, fresh = None, FIRST_BEND, False
        for _ in range(MAX_STEPS):
            if modes is None:
                modes, fresh = self.modes(tension, q, part), True
                if modes is None:
                    return None
            if self.residual(force, q) < tolerance:
                bounded = np.maximum(np.abs(modes.sizes), NEUTRAL)
                return Held(q, tension, part, modes.directions / bounded @ modes.directions.T, float(modes.sizes[0]))
            pull, size = modes.directions.T @ force, np.maximum(np.abs(modes.sizes), SOFTEST)
            step = pull / size
            bend = float(np.linalg.norm(step)) / np.sqrt(self.energy)
            step *= min(1.0, limit / bend)
            move, xi = modes.directions @ step, self.work.xi.copy()
            moved = self.force(tension, q + move, part)
            gain = 0.0 if moved is None else 0.5 * float(move @ (force + moved)) / float(pull @ step - 0.5 * size @ step**2)
            if moved is not None and gain > 0.0:
                q, force, fresh = q + move, moved, False
                limit = 2.0 * limit if gain > 0.7 and bend > limit else 0.5 * min(bend, limit) if gain < 0.3 else limit
                modes = modes if 0.9 < gain < 1.1 else None
            else:
                self.work.xi[:] = xi
                self.force(tension, q, part)
                limit, modes = (0.25 * min(bend, limit), modes) if fresh else (limit, None)
        return None

    def residual(self, force: Array, q: Array) -> float:
        """The angle [rad] by which the unbalanced force would bend the unloaded arm, as in `Equilibrium`; after force()."""
        try:
            unbalanced = float(force @ np.linalg.solve(self.work.G, force))
        except np.linalg.LinAlgError:
            return np.inf
        return float(np.sqrt(max(unbalanced, 0.0) / (self.energy + q @ self.work.G @ q)))

    def angle(self, change: Array) -> float:
        """The bend [rad] that stores as much energy as a change (n,) of coordinates; after force()."""
        return float(np.sqrt(max(change @ self.work.G @ change, 0.0) / self.energy))

    def modes(self, tension: Array, q: Array, part: float) -> _Modes | None:
        """The stiffness where force() was called last; None where it cannot be had."""
        G = self.work.G.copy()
        try:
            root = np.linalg.inv(np.linalg.cholesky(G))
        except np.linalg.LinAlgError:
            return None
        if not self.arm.effects.load:
            return _Modes(np.ones(self.size), root.T)
        force, xi, slopes = self.work.drive + part * self.work.load, self.work.xi.copy(), np.empty_like(G)
        steps = DIFFERENCE * np.sqrt(self.energy) * root
        for j, step in enumerate(steps):
            self.work.xi[:] = xi
            moved = self.force(tension, q + step, part)
            if moved is None:
                break
            slopes[:, j] = force - moved
        self.work.xi[:] = xi
        if self.force(tension, q, part) is None or moved is None:
            return None
        S = root @ slopes / (DIFFERENCE * np.sqrt(self.energy))
        sizes, directions = np.linalg.eigh(0.5 * (S + S.T))
        return _Modes(sizes, root.T @ directions)
