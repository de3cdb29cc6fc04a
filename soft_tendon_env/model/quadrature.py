"""Quadrature error of a scene, and the number of intervals that it needs: the tip at rest, measured against a finer quadrature.

Routing, radius, reference curvature, strain fields and loads vary along the rod, and intervals longer than these variations miss them.
How long is too long is not read off the scene but measured: tensions within their limits hold the arm on two quadratures, and what
its tip moves by from the one to the other is the error of the coarser one (of fourth order, so that of the finer one is far smaller).
"""

import functools
import math
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.model.coordinates import actuation_fields
from soft_tendon_env.model.grid import at_points, make_grid, newton_cotes, screw_matrices
from soft_tendon_env.model.quadrature_trial import SOFTEST, TIGHT, Probe
from soft_tendon_env.scene.radius import RadiusProfile
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, breakpoints, segment_index
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array

SAFETY = 0.75
"""Part of the tolerance that the largest displacement found may reach: the tensions tried are not all there are."""
SAFETY_OF_SOFT = 0.33
"""Part of the tolerance where loads leave little of the arm's stiffness, so that it moves far from one set of tensions to the next."""
MASS_TOLERANCE = 0.02
"""Largest relative error of the rod's mass and of its moments about the base."""
LEAST_INERTIA = 0.1
"""Least part of its inertia that a combination of coordinates must keep: fields of high order need as many nodes."""
NO_INERTIA = 1e-9  # of the largest: a combination of coordinates that moves nothing on any quadrature
DENSE = 127  # intervals per piece, at least, on which the geometry shows
PER_WAVE = 4.0  # intervals that a wavelength of the geometry takes to show
RESOLVED = 0.1  # of the tolerance: error of the finer quadrature in the linear response to each tendon
CORNERS = 16  # sets of several tendons at their limits that are tried, all of them where there are no more
FINE = 32  # intervals from which on a quadrature with half as many again, five times more accurate, serves for comparison
HOPELESS = 96  # intervals from which on the search ends where twice as many do not even halve the error
OTHER = 1.0  # [rad] between equilibria on two quadratures above which they are not the same: what counts is how either places the arm
MAX_CUTS = 8  # of tensions that no strain balances
BEARABLE, LEAST_PART = 0.9, 0.01  # of the tensions at which the search for a strain stopped; of the tensions, where it never began
LOADED = 12  # of the tensions that are tried, those under which the arm is also balanced, which takes a search


class QuadratureWarning(UserWarning):
    """The quadrature is too coarse for the scene."""


class QuadratureEstimate(NamedTuple):
    """Error of a quadrature, and what is worst about it.

    `error` estimates the largest displacement of the tip at rest under tensions within their limits, as a share of the rod's length,
    with a margin for those not tried (inf: not even the coordinates are right). `problem` says what is worst, in words, where the
    quadrature is too coarse; it is empty where it suffices.
    """

    intervals: int  # per piece
    error: float
    problem: str


def intervals_in_use(scene: Scene) -> int:
    """Quadrature intervals per piece of the rod: those that the scene says, or those that it needs."""
    return scene.quadrature.intervals or needed_intervals(scene).intervals


def quadrature_estimate(scene: Scene, intervals: int | None = None) -> QuadratureEstimate:
    """Estimate of the error with this many intervals per piece (None: with those in use)."""
    intervals = intervals or scene.quadrature.intervals
    return needed_intervals(scene) if intervals is None else _Trial(scene).estimate(intervals)


def needed_intervals(scene: Scene) -> QuadratureEstimate:
    """The estimate for as few intervals as the scene's tolerance allows, from its `least` on; MOST_INTERVALS if none suffice."""
    return _Trial(scene).search(scene.quadrature.least)


def checked_probe(scene: Scene) -> Probe:
    """The arm on the quadrature in use. Warns (QuadratureWarning) where that is too coarse."""
    _check_turns(scene)
    trial, given = _Trial(scene), scene.quadrature.intervals
    found = trial.search(scene.quadrature.least) if given is None else trial.estimate(given)
    if found.problem:
        enough = found if given is None else trial.search(given)
        advice = f"not even {enough.intervals} would do"
        if not enough.problem:
            advice = f"{enough.intervals} would do, or leave quadrature.intervals out"
        text = f"quadrature too coarse: with {found.intervals} intervals per piece {found.problem}; {advice}"
        warnings.warn(text, QuadratureWarning, stacklevel=3)
    return trial.probe(found.intervals) if trial.scene.effects == scene.effects else Probe(scene, found.intervals)


def _check_turns(scene: Scene) -> None:
    """Raises ConfigurationError where the stress-free rod turns more often than the finest quadrature could tell."""
    most = MOST_INTERVALS * (breakpoints(scene).size - 1)
    for i, segment in enumerate(scene.segments):
        turns = math.hypot(*segment.curvature) * segment.length / (2.0 * math.pi)
        if turns > most:
            text = f"is {shown(segment.curvature)}: it turns the segment {turns:.3g} times, and the finest quadrature tells {most} turns"
            raise ConfigurationError([Problem(("segments", i, "curvature"), text)])


class _Trial:
    """A scene on several quadratures, and the tensions that they are compared at.

    What the arm comes upon in places only, as obstacles, is left out: an arm that just touches one on the one quadrature and just misses
    it on the other is as far off with any number of intervals.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene.model_copy(update={"effects": scene.effects.everywhere()})
        self.probes, self.verdicts = dict[int, Probe](), dict[int, tuple[QuadratureEstimate, float]]()
        self.limits = np.array([tendon.tension_limits for tendon in scene.tendons])
        self.slack = np.clip(0.0, *self.limits.T)
        self.least = 1.0  # stiffness of the arm in the states that the last quadrature was compared at, 1 without loads
        self.rests = dict[bytes, Array]()  # coordinates at which each of the tensions held the arm on the last quadrature
        tendons = np.arange(len(self.limits))
        self.pulled = [(i, limit) for i in tendons for limit in self.limits[i] if limit != self.slack[i]]
        self.alone = [np.where(tendons == i, limit, self.slack) for i, limit in self.pulled]
        self.together = [self.limits[tendons, corner] for corner in _corners(tendons.size)]

    def search(self, intervals: int) -> QuadratureEstimate:
        """The estimate for the first number from this one on that suffices, in steps as the fourth order suggests."""
        before = np.inf  # the excess with half as many, where that was tried
        while True:
            found, excess = self.verdict(intervals)
            hopeless = intervals >= max(HOPELESS, self.resolving) and excess > 0.5 * before
            if not found.problem or intervals == MOST_INTERVALS or hopeless:
                return found
            factor = min(1.05 * excess**0.25, 2.0)
            before = excess if factor == 2.0 else np.inf
            intervals = min(max(intervals + 1, int(np.ceil(intervals * factor))), MOST_INTERVALS)

    def estimate(self, intervals: int) -> QuadratureEstimate:
        """The estimate for this many intervals."""
        if (half := (intervals - 1) // 2) >= self.scene.quadrature.least:  # what suffices with half of them needs no finer quadrature
            self.probe(intervals)
            found, _ = self.verdict(half)
            if not found.problem:
                return QuadratureEstimate(intervals, found.error / 8.0, "")
        return self.verdict(intervals)[0]

    def verdict(self, intervals: int) -> tuple[QuadratureEstimate, float]:
        """The estimate, and by what factor the worst of its errors exceeds what is allowed."""
        if intervals not in self.verdicts:
            self.verdicts[intervals] = self.judged(intervals)
        return self.verdicts[intervals]

    def judged(self, intervals: int) -> tuple[QuadratureEstimate, float]:
        """The verdict on a number of intervals not yet tried."""
        with np.errstate(all="ignore"):  # forces of a hopeless quadrature may be infinite or NaN
            coarse, fine = self.probe(intervals), self.finer(intervals)
            self.least = 1.0
            share, cause = self.displacement(coarse, fine) if coarse.size == fine.size else (np.inf, "")
            mass, segment = self.mass_error(intervals)
            kept, coordinate = inertia_kept(coarse, fine) if coarse.size == fine.size else (1.0, 0)
        error = share / (SAFETY if self.least > SOFTEST else SAFETY_OF_SOFT)
        displaced = f"the tip is off by about {100 * error:.2g} % of the length, {1e3 * error * coarse.length:.2g} mm, {cause}"
        lost = f"{coarse.size} coordinates are told apart of {fine.size}"
        problems = (
            (error / self.scene.quadrature.tolerance, displaced if np.isfinite(error) else lost),
            (mass / MASS_TOLERANCE, f"the rod's mass is off by {100 * mass:.2g} %, most of it in segment {segment}"),
            (LEAST_INERTIA / max(kept, LEAST_INERTIA**4), f"coordinate {coordinate} keeps {100 * kept:.2g} % of its inertia"),
        )
        excess, problem = max(problems)
        return QuadratureEstimate(intervals, error, problem if excess > 1.0 else ""), excess

    def probe(self, intervals: int) -> Probe:
        """The arm with this many intervals per piece."""
        if intervals not in self.probes:
            self.probes[intervals] = Probe(self.scene, intervals)
        return self.probes[intervals]

    def finer(self, intervals: int) -> Probe:
        """A quadrature so much finer that its own error does not count; one that is there already, if any is."""
        least = max(2 * intervals + 1 if intervals < FINE else 3 * intervals // 2 + 1, self.resolving)
        return self.probe(min((count for count in self.probes if least <= count <= 2 * least), default=least))

    def displacement(self, coarse: Probe, fine: Probe) -> tuple[float, str]:
        """The tip's largest displacement that was found, as a share of the length, and what makes it, in words."""
        if coarse.size == 0:
            return 0.0, ""
        at_rest = functools.partial(self.share_at_rest, coarse, fine)
        if coarse.implicit:
            shares = [(_share_of_tensions(coarse, fine, tension), tension) for tension in [*self.alone, *self.together]]
            if isinstance(coarse.arm.strain, Loaded):
                shares.append((_share_of_tensions(coarse, fine, self.slack), self.slack))
            self.climb(shares, functools.partial(_share_of_tensions, coarse, fine))
            alone = [share for share, _ in shares[: len(self.alone)]]
            if coarse.rests_elsewhere:
                worst = sorted(shares, key=lambda found: found[0], reverse=True)[: LOADED // 2]
                halves = [0.5 * (self.slack + tension) for tension in self.together[: LOADED // 3]]  # pulls straighten what bends by loads
                tensions = [self.slack, *(tension for _, tension in worst), *self.together[: LOADED // 2], *halves]
                once = {tension.tobytes(): tension for tension in tensions}.values()
                found = [(share, tension) for tension in once if (share := at_rest(tension)) is not None]
                shares = found or shares
        else:
            shares = [(at_rest(tension) or 0.0, tension) for tension in [self.slack, *self.alone, *self.together[: LOADED // 2]]]
            alone = [share for share, _ in shares[1 : 1 + len(self.alone)]]
        share, tension = max(shares, key=lambda found: found[0])
        loads = max((found for found, where in shares if np.array_equal(where, self.slack)), default=0.0)
        if coarse.has_loads and loads >= 0.5 * share:
            return share, "most of it under the loads alone"
        among = [(alone[i], *self.pulled[i]) for i in range(len(alone)) if tension[self.pulled[i][0]] == self.pulled[i][1]]
        _, tendon, limit = max(among, default=(0.0, *self.pulled[0]))
        return share, f"worst by tendon {tendon} at {limit:g} N"

    def share_at_rest(self, coarse: Probe, fine: Probe, tension: Array) -> float | None:
        """How far the tip moves between the quadratures, at rest under tensions and loads or the part of them that the arm can bear."""
        held = coarse.hold(_bearable(coarse, fine, tension) if coarse.implicit else tension, self.rests.get(tension.tobytes()))
        if held is None or fine.place(held.q) < 1.0:
            return None
        self.least = min(self.least, held.least)
        if held.part == 1.0:
            self.rests[tension.tobytes()] = held.q
        force, finer_force = coarse.force_at(held), fine.force_at(held)
        if force is None or finer_force is None:
            return None
        apart = fine.tip - coarse.tip
        moved = apart + fine.tip_jacobian @ held.compliance @ (finer_force - force)
        if max(float(np.linalg.norm(apart)), float(np.linalg.norm(moved))) <= 0.5 * self.scene.quadrature.tolerance * coarse.length:
            return float(np.linalg.norm(moved)) / coarse.length
        settled = coarse.find(held.tension, held.q, held.part, TIGHT)  # the linear answer is far off
        finer = None if settled is None else fine.find(held.tension, settled.q, held.part, TIGHT)
        if settled is None or finer is None or fine.angle(finer.q - settled.q) > OTHER:
            return float(np.linalg.norm(apart)) / coarse.length
        coarse.place(settled.q)
        fine.place(finer.q)
        return float(np.linalg.norm(fine.tip - coarse.tip)) / coarse.length

    def climb(self, shares: list[tuple[float, Array]], share_of: Callable[[Array], float]) -> None:
        """From the worst tensions tried, one tendon after the other to its other limit, as long as that is worse; adds what it tries."""
        share, tension = max(shares, key=lambda found: found[0])
        for tendon, (least, greatest) in enumerate(self.limits):
            other = tension.copy()
            other[tendon] = least if tension[tendon] == greatest else greatest
            shares.append((share_of(other), other))
            if shares[-1][0] > share:
                share, tension = shares[-1]

    @functools.cached_property
    def dense(self) -> int:
        """Intervals per piece on which the geometry shows: DENSE, or as many as its shortest wavelength takes."""
        profiles = [segment.radius for segment in self.scene.segments if isinstance(segment.radius, RadiusProfile)]
        shortest = min(shape.wavelength() for shape in (*(tendon.routing for tendon in self.scene.tendons), *profiles))
        return int(np.clip(PER_WAVE * np.diff(breakpoints(self.scene)).max() / shortest, DENSE, MOST_INTERVALS))

    @functools.cached_property
    def resolving(self) -> int:
        """Intervals per piece that a comparison takes as the finer ones at least: with nodes for every field, and with the linear
        response to each tendon as on DENSE ones. Coarser ones could agree with each other and be both wrong."""
        count = max(2 * self.scene.quadrature.least + 1, 3 * (self.scene.strain.highest_order + 1))
        exact = self.responses(self.dense)
        size = np.maximum(1.0, np.abs(exact).max(axis=(1, 2), keepdims=True))
        allowed = RESOLVED * self.scene.quadrature.tolerance
        while count < self.dense:
            excess = float((np.abs(self.responses(count) - exact) / size).max()) / allowed
            if excess <= 1.0:
                break
            count = int(np.ceil(count * np.clip(1.05 * excess**0.25, 1.1, 2.0)))
        return min(count, MOST_INTERVALS)

    def responses(self, intervals: int) -> Array:
        """Moments 0 to 2 about the tip of the strains that each tendon's greatest pull makes of the straight arm, (n_a, 3, 6), as shares
        of the rod's length and as angles."""
        grid = make_grid(self.scene, intervals)
        here = at_points(self.scene, grid)
        strains = actuation_fields(here) * (1.0 / here.elasticity) * np.abs(self.limits).max(axis=1)[:, None, None, None]
        length = grid.breakpoints[-1]
        lever = (1.0 - grid.points / length) ** np.arange(3.0)[:, None, None]
        return np.einsum("pmz,amzc->apc", lever * grid.weights, strains) / np.array([1.0, 1.0, 1.0, length, length, length])

    def mass_error(self, intervals: int) -> tuple[float, int]:
        """Relative error of the rod's mass and of its first two moments about the base, and the segment that makes most of it."""
        grid, weights = make_grid(self.scene, self.dense), newton_cotes(intervals)
        length = grid.breakpoints[-1]

        def moments(places: Array) -> Array:
            density = screw_matrices(self.scene, places.ravel())[2][:, 3].reshape(places.shape)
            return density * (places / length) ** np.arange(3.0).reshape(3, *[1] * places.ndim)

        starts, sizes = grid.breakpoints[:-1], np.diff(grid.breakpoints)
        inside = 1e-9
        nodes = starts[:, None] + sizes[:, None] * np.clip(np.linspace(0.0, 1.0, intervals + 1), inside, 1.0 - inside)
        real = grid.real
        exact = (moments(grid.points[real]) * grid.weights[real]).reshape(3, starts.size, -1).sum(axis=2)
        errors = (moments(nodes) * weights * sizes[:, None]).sum(axis=2) - exact
        worst = int(np.abs(errors[0]).argmax())
        segment = int(segment_index(self.scene, starts[worst] + 0.5 * sizes[worst]))
        return float(np.abs(errors.sum(axis=1) / exact.sum(axis=1)).max()), segment


def _corners(tendons: int) -> NDArray[np.int64]:
    """Which limit several tendons are at, (corners, n_a): first all at their greatest."""
    if 2**tendons <= CORNERS:
        return np.indices((2,) * tendons).reshape(tendons, -1).T[::-1].astype(np.int64)
    drawn = np.random.default_rng(0).integers(2, size=(CORNERS, tendons))
    drawn[0] = 1
    return drawn


def inertia_kept(coarse: Probe, fine: Probe) -> tuple[float, int]:
    """The least part of its inertia that a combination of coordinates keeps at rest, and the coordinate that has most of it."""
    if not (coarse.relax() and fine.relax()):
        return 1.0, 0
    scale = 1.0 / np.sqrt(np.maximum(np.diag(fine.work.M), np.finfo(float).tiny))
    sizes, directions = np.linalg.eigh(fine.work.M * np.outer(scale, scale))
    moving = sizes > NO_INERTIA * sizes[-1]
    unit = scale[:, None] * directions[:, moving] / np.sqrt(sizes[moving])
    kept, combinations = np.linalg.eigh(unit.T @ coarse.work.M @ unit)
    return max(float(kept[0]), 0.0), int(np.abs(directions[:, moving] @ combinations[:, 0]).argmax())


def _share_of_tensions(coarse: Probe, fine: Probe, tension: Array) -> float:
    """How far the tip moves between the quadratures under tensions alone, as a share of the length; statics-based strain only."""
    tension = _bearable(coarse, fine, tension)
    return float(np.linalg.norm(coarse.tip - fine.tip)) / coarse.length


def _bearable(coarse: Probe, fine: Probe, tension: Array) -> Array:
    """The tensions, or about the largest part of them for which there is a bearable strain on both quadratures, which is left there."""
    for _ in range(MAX_CUTS):
        part = min(coarse.place(coarse.rest(tension)), fine.place(fine.rest(tension)))
        part /= max(coarse.stretch, fine.stretch, 1.0)
        if part == 1.0:
            break
        tension = BEARABLE * max(part, LEAST_PART) * tension
    return tension
