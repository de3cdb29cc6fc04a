"""Building a model: its coordinates are checked, and its quadrature is chosen by what the tip at
rest moves by on a finer one."""

import functools
import math
import warnings
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.grid import over_nodes, screw_matrices
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.model.model import Model, is_singular, model_on
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, breakpoints
from soft_tendon_env.scene.units import warn_of_units
from soft_tendon_env.tools.checks import checked_type, shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array

# part of the tolerance that the largest displacement found may reach, since not all tensions are
# tried
SAFETY = 0.75
MASS_TOLERANCE, LEAST_INERTIA = (
    0.02,
    0.1,
)  # largest relative error of the rod's mass; least part of its inertia that a motion keeps
# share of the largest up to which a combination of coordinates has no inertia on any quadrature
NO_INERTIA = 1e-9
PER_WAVE = 4.0  # intervals of the finer quadrature for the shortest wavelength of the geometry
CORNERS, SETTLED = (
    32,
    6,
    # sets of tendons at their limits that are tried; of the worst tensions equilibria are solved
    # under
)
HOPELESS = (
    96  # intervals from which on the search ends where twice as many do not even halve the error
)
FARTHEST = 2.0  # lengths from the base beyond which no tip is
MOST_HALVINGS, MOST_LINEARISATIONS = (
    40,
    100,
)  # of tensions that no strain balances; on the path to an equilibrium
FALL, MARGIN = (
    3.0,
    2.0,
    # bend [rad] along its softest mode of an arm whose path ends and that falls over; factor for
    # other such shapes
)


def build_model(scene: Scene) -> Model:
    """Model of a scene as it says: chooses its quadrature and prepares the arrays of its kernels.
    At a fidelity: accuracy.fidelity.

    Raises TypeError, ConfigurationError if its coordinates are not independent or its stress-free
    rod turns too often for any quadrature. Warns if `quadrature.intervals` is too coarse
    (`QuadratureWarning`) and where numbers look as if not in SI units (`UnitsWarning`).
    """
    checked_type("scene", scene, Scene, "see load_scene")
    warn_of_units(scene)
    most = MOST_INTERVALS * (breakpoints(scene).size - 1)
    for i, segment in enumerate(scene.segments):
        if (turns := math.hypot(*segment.curvature) * segment.length / (2.0 * math.pi)) > most:
            text = (
                f"is {shown(segment.curvature)}: it turns the segment {turns:.3g} times, and the"
                f" finest quadrature tells {most} turns"
            )
            raise ConfigurationError([Problem(("segments", i, "curvature"), text)])
    test, given = QuadratureTest(scene), scene.quadrature.intervals
    found = test.search(scene.quadrature.least) if given is None else test.error_estimate(given)
    if found.problem:
        enough = found if given is None else test.search(given)
        advice = (
            "not even {} would do"
            if enough.problem
            else "{} would do, or leave quadrature.intervals out"
        )
        text = (
            f"quadrature too coarse: with {found.intervals} intervals per piece {found.problem};"
            f" {advice.format(enough.intervals)}"
        )
        warnings.warn(text, QuadratureWarning, stacklevel=2)
    model = (
        test.model(found.intervals)
        if test.scene.effects == scene.effects
        else model_on(scene, found.intervals)
    )
    n = model.coordinate_count
    if n == 0:
        raise ConfigurationError(
            [
                Problem(
                    ("strain",),
                    "gives no coordinates: no tendon and no passive field strains the rod",
                )
            ]
        )
    try:
        terms = model.terms(np.zeros(n), np.zeros(n))
    except StrainLimitError as error:  # the unloaded arm has a strain
        text = (
            f"is true, but without tensions the arm does not hold the loads: {error}; leave it out,"
            " for loads that buckle the arm"
        )
        raise ConfigurationError([Problem(("strain", "include_loads"), text)]) from error
    if is_singular(terms.stiffness):
        text = (
            f"gives {n} coordinates of which some strain the rod alike at the points of"
            f" {model.grid.per_piece} quadrature intervals"
        )
        raise ConfigurationError(
            [
                Problem(
                    ("strain",),
                    f"{text} per piece: drop a field, or leave quadrature.intervals out, if given",
                )
            ]
        )
    if is_singular(terms.mass):
        text = (
            f"{n} coordinates are too many for {model.grid.per_piece} quadrature intervals per"
            " piece: the mass matrix is singular"
        )
        warnings.warn(text, stacklevel=2)
    return model


class QuadratureWarning(UserWarning):
    """The quadrature is too coarse for the scene."""


class QuadratureEstimate(NamedTuple):
    """Error of a quadrature, and what is worst about it."""

    intervals: int  # per piece
    # of the tip at rest, as a share of the length, a margin included; inf: not even the coordinates
    # are right
    error: float
    problem: str  # what is worst where the quadrature is too coarse; empty where it suffices
    excess: float  # by what factor the worst of its errors exceeds what is allowed


class QuadratureTest:
    """A scene on several quadratures, and the tensions that they are compared at; obstacles are
    left out."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene.model_copy(update={"effects": scene.effects.everywhere()})
        self.model = functools.cache(functools.partial(model_on, self.scene))
        self.limits = np.array([tendon.tension_limits for tendon in scene.tendons])
        self.slack, count = np.clip(0.0, *self.limits.T), len(self.limits)
        alone = [
            np.where(np.arange(count) == i, limit, self.slack)
            for i in range(count)
            for limit in self.limits[i]
        ]
        few = 2**count <= CORNERS
        sides = (
            np.indices((2,) * count).reshape(count, -1).T[::-1]
            if few
            else np.random.default_rng(0).integers(2, size=(CORNERS, count))
        )
        sides[0] = 1  # all at their greatest
        together = [self.limits[np.arange(count), side] for side in sides]
        self.tensions = list(
            {tension.tobytes(): tension for tension in [*together, *alone, self.slack]}.values()
        )
        tapers = [taper for segment in scene.segments for taper in segment.shape.tapers().values()]
        shortest = min(
            shape.wavelength() for shape in (*(tendon.routing for tendon in scene.tendons), *tapers)
        )
        per_piece = math.ceil(PER_WAVE * np.diff(breakpoints(scene)).max() / shortest)
        # that a finer quadrature has at least: coarser ones could agree with each other and be both
        # wrong
        self.resolving = min(max(per_piece, 3 * (scene.strain.highest_order + 1)), MOST_INTERVALS)

    def search(self, intervals: int) -> QuadratureEstimate:
        """The estimate for the first number from this one on that suffices, in steps as the fourth
        order suggests; or MOST_INTERVALS."""
        before = np.inf  # the excess with half as many, where that was tried
        while True:
            found = self.error_estimate(intervals)
            hopeless = intervals >= max(HOPELESS, self.resolving) and found.excess > 0.5 * before
            if not found.problem or intervals == MOST_INTERVALS or hopeless:
                return found
            factor = min(1.05 * found.excess**0.25, 2.0)
            before = found.excess if factor == 2.0 else np.inf
            intervals = min(max(intervals + 1, math.ceil(intervals * factor)), MOST_INTERVALS)

    def error_estimate(self, intervals: int) -> QuadratureEstimate:
        """The estimate with this many intervals per piece, against a finer quadrature."""
        coarse, fine = self.model(intervals), self.model(max(2 * intervals + 1, self.resolving))
        error, kept, problem = (
            np.inf,
            1.0,
            f"its points do not tell all {fine.coordinate_count} coordinates apart",
        )
        refused = QuadratureEstimate(intervals, 0.0, "", 0.0)  # by build_model, on any quadrature
        if fine.coordinate_count == 0:
            return refused
        with np.errstate(all="ignore"):  # forces of a hopeless quadrature may be infinite or NaN
            try:
                if coarse.coordinate_count == fine.coordinate_count and not is_singular(
                    coarse.metric
                ):
                    share, tension = self.displacement(coarse, fine)
                    error, kept = share / SAFETY, inertia_kept(coarse, fine)
                    off = (
                        f"the tip is off by about {100 * error:.2g} % of the length,"
                        f" {1e3 * error * coarse.length:.2g} mm"
                    )
                    problem = (
                        f"{off}, under tensions {shown_numbers(tension)}"
                        f" N{' and loads' if coarse.arm.effects.load else ''}"
                    )
            except (
                StrainLimitError
            ):  # without tensions the loads inside of its strain buckle the arm
                return refused

        def moment(places: Array) -> Array:  # of the rod's mass about the base, per length
            return places[:, None] * screw_matrices(self.scene, places)[2][:, 3:4]

        exact = moment(fine.grid.points.ravel())[:, 0] @ fine.grid.weights.ravel()
        mass = abs(float(over_nodes(coarse.grid, moment).sum() / exact) - 1.0)
        excess, problem = max(
            (error / self.scene.quadrature.tolerance, problem),
            (mass / MASS_TOLERANCE, f"the moment of the rod's mass is off by {100 * mass:.2g} %"),
            (
                LEAST_INERTIA / max(kept, LEAST_INERTIA**4),
                f"a combination of coordinates keeps {100 * kept:.2g} % of its inertia",
            ),
        )
        return QuadratureEstimate(intervals, error, problem if excess > 1.0 else "", excess)

    def displacement(self, coarse: Model, fine: Model) -> tuple[float, Array]:
        """Largest displacement of the tip at rest that was found between two quadratures, as a
        share of the length, and the tensions."""
        responses = [_response(model) for model in (coarse, fine)]
        shares = [
            (_unloaded_share(coarse, fine, responses, tension), tension)
            for tension in self.tensions
        ]
        shares.sort(key=lambda found: found[0], reverse=True)
        if (
            isinstance(coarse.arm.strain, Implicit) and not coarse.arm.effects.load
        ):  # they are at rest there
            return shares[0]
        full, q, rests = (
            self.limits[:, 1],
            np.zeros(coarse.coordinate_count),
            list[tuple[float, Array]](),
        )
        loaded = [self.slack, full, 0.5 * (self.slack + full)] if coarse.arm.effects.load else []
        for tension in loaded + [tension for _, tension in shares[:SETTLED]]:
            share, rest = _share_at_rest(coarse, fine, tension, q + responses[0] @ tension)
            rests.append((share, tension))
            q = rest if tension is self.slack else q  # the answer to the loads
        return max(rests, key=lambda found: found[0])


def inertia_kept(coarse: Model, fine: Model) -> float:
    """The least part of its inertia that a combination of coordinates keeps at rest."""
    still = np.zeros(coarse.coordinate_count)
    M, exact = (model.terms(still, still).mass for model in (coarse, fine))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(exact), np.finfo(float).tiny))
    sizes, directions = np.linalg.eigh(exact * np.outer(scale, scale))
    moving = sizes > NO_INERTIA * sizes[-1]
    unit = scale[:, None] * directions[:, moving] / np.sqrt(sizes[moving])
    return max(float(np.linalg.eigvalsh(unit.T @ M @ unit)[0]), 0.0)


def _response(model: Model) -> Array:
    """Coordinates at rest by tensions (n, n_a) without effects: those of the strain law, or those
    of an explicit basis to first order."""
    if isinstance(model.arm.strain, Implicit):
        return np.transpose(
            [model.arm.strain.rest_coordinates(tension) for tension in np.eye(model.tendon_count)]
        )
    still = np.zeros(model.coordinate_count)
    return np.asarray(np.linalg.solve(model.metric, model.terms(still, still).actuation))


def _unloaded_share(coarse: Model, fine: Model, responses: list[Array], tension: Array) -> float:
    """Distance of the tips on two quadratures, as a share of the length, under tensions alone, or
    the half, quarter.. that has a strain."""
    for _ in range(MOST_HALVINGS):
        try:
            tips = [
                model.tip_pose(by @ tension)[:3, 3]
                for model, by in zip((coarse, fine), responses, strict=True)
            ]
        except StrainLimitError:
            tips = [np.full(3, np.inf)]
        if (
            np.linalg.norm(np.array(tips) - coarse.arm.base[9:], axis=1).max()
            <= FARTHEST * coarse.length
        ):
            return float(np.linalg.norm(tips[1] - tips[0])) / coarse.length
        tension = 0.5 * tension
    return 0.0


def _share_at_rest(coarse: Model, fine: Model, tension: Array, guess: Array) -> tuple[float, Array]:
    """`_unloaded_share` at rest under tensions and loads, and coordinates (n,) there; with a margin
    for an arm that falls over."""
    with coarse.workspace() as work, fine.workspace() as fine_work:
        path, finer = (
            LoadPath(Balance(coarse, tension, work), MOST_LINEARISATIONS),
            LoadPath(Balance(fine, tension, fine_work)),
        )
        found = path.equilibrium(guess, 1.0) if guess.any() else None
        if found is None or not found.stability.stable:
            found, _ = path.rest()
        fallen = found.at.part < 1.0
        q = found.at.q + FALL * found.stability.modes[:, 0] if fallen else found.at.q
        near = None if fallen else finer.equilibrium(q, 1.0)
    try:
        apart = fine.tip_pose(q if near is None else near.at.q) - coarse.tip_pose(q)
    except StrainLimitError:
        return 0.0, guess
    return (MARGIN if fallen else 1.0) * float(np.linalg.norm(apart[:3, 3])) / coarse.length, q
