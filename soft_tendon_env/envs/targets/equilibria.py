"""Static equilibria of an arm under many tensions together: what `static_equilibrium` finds for each, in compiled rows.

The usual case is computed, step for step as `LoadPath` does it, for all of them at once: one step to the full load, on which the arm keeps
stiff. Whatever is not usual is left to `static_equilibrium`. So the numbers are the same, bit for bit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.mechanics.motion.equilibrium import Linearisation, Samples, linearise_balances, strain_is_continuous
from soft_tendon_env.mechanics.motion.scratch import Scratch
from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model import load_continuation as continuation
from soft_tendon_env.model.equilibrium_residual import ASYMMETRIC, NEUTRAL
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

Marks = NDArray[np.bool_]


class Balances(NamedTuple):
    """The balance of forces of m samples, see model/equilibrium_residual.py; rows without a strain have no finite residual."""

    force: Array  # (m, n)
    residual: Array  # (m,)
    rate: Array  # (m, n) df/dpart
    slopes: Array  # (m, n, directions) -df/dq


class Linearised(NamedTuple):
    """The balance of m samples to first order, as `balance.Linearised` is that of one."""

    force: Array  # (m, n)
    residual: Array  # (m,)
    usual: Marks  # (m,) whether there is a strain, and a stiffness that has a potential and is far from lost
    tangent: Array  # (m, n) dq/dpart
    compliance: Array  # (m, n, n)
    modes: Array  # (m, n, n) of the stiffness, softest first


class Equilibria:
    """Equilibria of one model, on the threads of some arms."""

    def __init__(self, arms: Arms, model: Model) -> None:
        self._arms, self.model, self._energy = arms, model, model.bending_energy
        diagonal = np.diag(model.metric)
        self._scale = np.sqrt(self._energy / diagonal)  # of the directions along which stiffnesses are found
        self._diagonal, self._directions = diagonal, np.diag(self._scale)[None]

    def on_path(self, tension: Array) -> tuple[Array, Marks]:
        """Coordinates (m, n) of slowly loaded arms under tensions (m, n_a), and where that was found: the first step of `LoadPath.end`."""
        strain, none = self.model.arm.strain, np.zeros((len(tension), self.model.coordinate_count))
        if isinstance(strain, Implicit) and strain.law.mixed:  # of redundant tendons `static_equilibrium` warns
            return none, np.zeros(len(tension), dtype=bool)
        unloaded, G = self._balances(tension, none, 0.0, True)
        rest = np.linalg.inv(G[0])
        tangent = _products(np.broadcast_to(rest, G.shape), unloaded.rate)
        answer = np.stack([strain.rest_coordinates(u) for u in tension])
        goes = (unloaded.residual <= continuation.ON_THE_WAY) & (self._angles(tangent - answer) <= continuation.FIRST_REACH)
        goes &= strain.has_potential
        predicted = none + 1.0 * tangent
        ahead = self._linearised(tension, predicted)
        q, found = self._newton(tension, predicted, ahead)
        corrected = self._angles(q - predicted)
        if (corrected[found] > continuation.NEAR).any():  # the stiffness at the prediction does not stand for that at the equilibrium
            own, near = self._linearised(tension, q), corrected <= continuation.NEAR
            ahead = Linearised(*(np.where(near.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(ahead, own, strict=True)))
        goes &= found & ahead.usual & (corrected <= continuation.CORRECTION)
        middle = 0.5 * (none + q) + 0.125 * (tangent - ahead.tangent)
        watched = ahead.modes[:, :, :continuation.WATCHED]
        between = self._balances(tension, middle, 0.5, False, watched.swapaxes(1, 2))[0]
        curvature = watched.swapaxes(1, 2) @ between.slopes / self._energy
        least = np.linalg.eigvalsh(0.5 * (curvature + curvature.swapaxes(1, 2)))[:, 0]
        goes &= np.isfinite(between.residual) & (least > -NEUTRAL * middle.shape[1])
        for compliance in (np.broadcast_to(rest, G.shape), ahead.compliance):
            goes &= self._angles(_products(compliance, between.force)) <= continuation.STRAY
        with self.model.workspace() as work:
            for i in np.flatnonzero(goes):
                goes[i] = strain_is_continuous(self.model.arm, none[i], q[i], work)
        return q, goes

    def beside(self, tension: Array, guess: Array) -> tuple[Array, Marks]:
        """Coordinates (m, n) of the equilibria under tensions (m, n_a) next to guesses (m, n), and where they were found."""
        start = self._linearised(tension, guess, with_path=False)
        q, found = self._newton(tension, guess, start)
        return q, found & (self._angles(q - guess) <= continuation.NEAR)

    def _linearised(self, tension: Array, q: Array, with_path: bool = True) -> Linearised:
        """The balance under the full load and its derivatives at q (m, n); without tangent and modes where no path is followed."""
        here = self._balances(tension, q, 1.0, with_path, self._directions)[0]
        there_is = np.isfinite(here.residual)
        stiffness = np.where(there_is[:, None, None], here.slopes / self._scale, self.model.metric)
        least, modes = self._modes(stiffness, with_path)
        usual = there_is & (least > continuation.SOFT)
        compliance = np.linalg.inv(np.where(usual[:, None, None], stiffness, self.model.metric))
        usual &= np.abs(self._diagonal * np.diagonal(compliance, axis1=1, axis2=2)).max(axis=1) < 0.1 / NEUTRAL
        return Linearised(here.force, here.residual, usual, _products(compliance, here.rate), compliance, modes)

    def _newton(self, tension: Array, guess: Array, start: Linearised) -> tuple[Array, Marks]:
        """Coordinates (m, n) to which Newton's method leads with the stiffness at the guesses, and where it does so at once:
        `LoadPath.equilibrium`."""
        q, last, compliance = guess.copy(), np.full(len(guess), np.inf), start.compliance
        force, residual, usual = start.force.copy(), start.residual.copy(), start.usual.copy()
        corrections = continuation.MOST_CORRECTIONS if guess.shape[1] > continuation.FEW else 1  # few: another stiffness each time
        for _ in range(corrections):
            rows = np.flatnonzero(usual & ~(residual <= continuation.RESIDUAL))
            if not rows.size:
                break
            change = _products(compliance[rows], force[rows])
            size = self._angles(change)
            usual[rows] = goes = np.where(np.isinf(last[rows]), size < np.inf, size <= continuation.SLOW * last[rows])
            rows, change = rows[goes], change[goes]
            q[rows], last[rows] = q[rows] + change, size[goes]
            at = self._balances(tension[rows], q[rows], 1.0, False)[0]
            force[rows], residual[rows] = at.force, at.residual
        return q, usual & (residual <= continuation.RESIDUAL)

    def _balances(self, tension: Array, q: Array, part: float, with_rate: bool, directions: Array | None = None) -> tuple[Balances, Array]:
        """The balance at q (m, n), with slopes along directions (m or 1, k, n) if there are any, and G (m, n, n)."""
        m, n = q.shape
        along = np.empty((1, 0, n)) if directions is None else directions
        along = np.ascontiguousarray(np.broadcast_to(along, (m, *along.shape[1:])))
        out = Linearisation(np.zeros((m, n)), np.tile(np.eye(n), (m, 1, 1)), np.zeros((m, n)), np.zeros((m, n, along.shape[1])))
        found = np.zeros(m, dtype=bool)

        def work(members: Indices, scratch: Scratch) -> None:
            with self.model.workspace() as own:
                linearise_balances(self.model.arm, Samples(tension, q, along), part, with_rate, members, own, out, found)

        self._arms.share(work, np.arange(m, dtype=np.int64))
        found &= np.isfinite(out.slopes).all(axis=(1, 2))
        out.slopes[~found] = 0.0
        return Balances(out.force, self._residuals(q, out, found), out.rate, out.slopes), out.G

    def _residuals(self, q: Array, out: Linearisation, found: Marks) -> Array:
        """Residuals (m,), see `statics.Equilibrium`; infinite where there are none."""
        try:
            with np.errstate(all="ignore"):
                unbalanced = (out.force * np.linalg.solve(out.G, out.force[..., None])[..., 0]).sum(axis=1)
                residual = np.sqrt(unbalanced / (self._energy + ((q[:, None] @ out.G)[:, 0] * q).sum(axis=1)))
        except np.linalg.LinAlgError:
            return np.full(len(q), np.inf)
        return np.where(found & np.isfinite(residual), residual, np.inf)

    def _angles(self, changes: Array) -> Array:
        """Sizes (m,) of changes of coordinates (m, n), see `Balance.angle`."""
        with np.errstate(all="ignore"):
            return np.asarray(np.sqrt(np.maximum(((changes @ self.model.metric) * changes).sum(axis=1), 0.0) / self._energy))

    def _modes(self, stiffness: Array, with_vectors: bool) -> tuple[Array, Array]:
        """Least eigenvalues (m,) of stiffnesses (m, n, n), minus infinity without a potential; and their modes (m, n, n) if asked for."""
        unit = self.model.metric_unit
        S = unit.T @ stiffness @ unit
        symmetric, S = _sizes(S - S.swapaxes(1, 2)) <= ASYMMETRIC * _sizes(S), 0.5 * (S + S.swapaxes(1, 2))
        if not with_vectors:
            return np.where(symmetric, np.linalg.eigvalsh(S)[:, 0], -np.inf), S[:, :0]
        values, vectors = np.linalg.eigh(S)
        return np.where(symmetric, values[:, 0], -np.inf), unit @ vectors * np.sqrt(self._energy)


def _sizes(matrices: Array) -> Array:
    """Frobenius norms (m,) of matrices (m, n, n)."""
    return np.asarray(np.sqrt((matrices * matrices).sum(axis=(1, 2))))


def _products(matrices: Array, vectors: Array) -> Array:
    """Products (m, n) of matrices (m, n, n) with vectors (m, n), each as it is alone, to the last bit."""
    return np.stack([matrix @ vector for matrix, vector in zip(matrices, vectors, strict=True)]) if len(vectors) else vectors
