"""Error estimates of quadratures, and the choice of one.

They are what the tip at rest moves by, and what masses change by, on a finer quadrature.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model.coordinates import resolving_intervals
from soft_tendon_env.model.equilibrium_residual import Balance, Linearised
from soft_tendon_env.model.grid import mass_moment_over_nodes, mass_moment_over_points
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.model.model import Model, is_singular, model_on
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.types import Array

# part of the tolerance that the largest displacement of those tried may reach, since not all
# tensions are tried
SAFETY = 0.75
# largest relative error of the moment of the rod's mass
MASS_TOLERANCE = 0.02
# least part of its inertia that a combination of coordinates keeps
LEAST_INERTIA = 0.1
# share of the largest up to which a combination of coordinates has no inertia on any quadrature
NO_INERTIA = 1e-9
# sets of tendons at their limits that are tried
CORNERS = 32
# of the worst tensions without loads, how many equilibria are solved under
SETTLED = 6
# intervals from which on the search ends where twice as many do not even halve the error
HOPELESS = 96
# share of the error that twice as many intervals leave where more are hopeless
HARDLY_LESS = 0.5
# the error falls with the fourth order of the intervals' lengths
ORDER = 4
# factor of the intervals beside what the order suggests
SPARE = 1.05
# lengths from the base beyond which no tip is
FARTHEST = 2.0
# halvings of tensions that no strain balances
MOST_HALVINGS = 40
# linearisations on the path to an equilibrium of the coarse quadrature
MOST_LINEARISATIONS = 100
# bend [rad] along its softest mode of an arm whose path ends and that falls over
FALL = 3.0
# factor of a fallen arm's displacement, for other such shapes
MARGIN = 2.0


class QuadratureEstimate(NamedTuple):
    """Error of a quadrature, and what is worst about it."""

    intervals: int  # per piece
    # of the tip at rest, as a share of the length, a margin included; inf: not even the coordinates
    # are right
    error: float
    problem: str  # what is worst where the quadrature is too coarse; empty where it suffices
    excess: float  # by what factor the worst of its errors exceeds what is allowed


class Displacement(NamedTuple):
    """Displacement of the tip at rest between two quadratures."""

    share: float  # of the length
    tension: Array  # (n_a,) [N]


class QuadratureTest:
    """A scene on several quadratures, and the tensions that they are compared at.

    Obstacles and actuators are left out.
    """

    def __init__(self, scene: Scene) -> None:
        everywhere = scene.effects.everywhere()
        self.scene = scene.model_copy(update={"effects": everywhere})
        build = functools.partial(model_on, self.scene)
        self.model = functools.cache(build)
        limits = [tendon.tension_limits for tendon in scene.tendons]
        self.limits = np.array(limits)
        least, greatest = self.limits.T
        self.slack = np.clip(0.0, least, greatest)
        self.tensions = _tensions_to_try(self.limits, self.slack)
        self.resolving = resolving_intervals(scene)

    def search(self, intervals: int) -> QuadratureEstimate:
        """The estimate for the first number of intervals from this one on that suffices.

        It goes in steps as the order suggests, up to MOST_INTERVALS.
        """
        fine = max(HOPELESS, self.resolving)
        excess_of_half = np.inf  # with half as many intervals, where that was tried
        while True:
            estimate = self.error_estimate(intervals)
            hardly_less = estimate.excess > HARDLY_LESS * excess_of_half
            is_hopeless = intervals >= fine and hardly_less
            if not estimate.problem or is_hopeless or intervals == MOST_INTERVALS:
                return estimate
            by_order = estimate.excess ** (1 / ORDER)
            factor = min(SPARE * by_order, 2.0)
            if factor == 2.0:
                excess_of_half = estimate.excess
            else:
                excess_of_half = np.inf
            suggested = math.ceil(intervals * factor)
            more = max(intervals + 1, suggested)
            intervals = min(more, MOST_INTERVALS)

    def error_estimate(self, intervals: int) -> QuadratureEstimate:
        """The estimate with this many intervals per piece, against a finer quadrature."""
        twice = 2 * intervals + 1
        coarse = self.model(intervals)
        fine = self.model(max(twice, self.resolving))
        # by build_model, on any quadrature
        refused = QuadratureEstimate(intervals, error=0.0, problem="", excess=0.0)
        if fine.coordinate_count == 0:
            return refused
        try:
            error, kept, problem = self._at_rest(coarse, fine)
        except StrainLimitError:
            # without tensions the loads inside of its strain buckle the arm
            return refused
        mass = _mass_error(coarse, fine)
        mass_problem = f"the moment of the rod's mass is off by {100 * mass:.2g} %"
        inertia_problem = f"a combination of coordinates keeps {100 * kept:.2g} % of its inertia"
        tolerance = self.scene.quadrature.tolerance
        some_inertia = max(kept, LEAST_INERTIA**4)
        excess, worst_problem = max(
            (error / tolerance, problem),
            (mass / MASS_TOLERANCE, mass_problem),
            (LEAST_INERTIA / some_inertia, inertia_problem),
        )
        return QuadratureEstimate(
            intervals,
            error=error,
            problem=worst_problem if excess > 1.0 else "",
            excess=excess,
        )

    def displacement(self, coarse: Model, fine: Model) -> Displacement:
        """Largest displacement of the tip at rest between two quadratures, of tensions tried."""
        responses = (_response(coarse), _response(fine))
        unloaded = list[Displacement]()
        for tension in self.tensions:
            share = _unloaded_share(coarse, fine, responses, tension)
            unloaded.append(Displacement(share, tension))
        unloaded.sort(key=_share_of, reverse=True)
        arm = coarse.arm
        has_loads = bool(arm.effects.load)
        if isinstance(arm.strain, Implicit) and not has_loads:
            # they are at rest there
            return unloaded[0]
        worst = [displacement.tension for displacement in unloaded[:SETTLED]]
        if has_loads:
            full = self.limits[:, 1]
            half = 0.5 * (self.slack + full)
            worst = [self.slack, full, half, *worst]
        coarse_response, _ = responses
        answer = np.zeros(coarse.coordinate_count)  # to the loads
        at_rest = list[Displacement]()
        for tension in worst:
            guess = answer + coarse_response @ tension
            share, rest = _share_at_rest(coarse, fine, tension, guess)
            at_rest.append(Displacement(share, tension))
            if tension is self.slack:
                answer = rest
        return max(at_rest, key=_share_of)

    def _at_rest(self, coarse: Model, fine: Model) -> tuple[float, float, str]:
        """Error of the tip at rest, the least inertia kept, and the error in words.

        Raises:
            StrainLimitError: where the loads inside of its strain buckle the arm.
        """
        count = fine.coordinate_count
        # forces of a hopeless quadrature may be infinite or NaN
        with np.errstate(all="ignore"):
            has_all = coarse.coordinate_count == count
            if not has_all or is_singular(coarse.metric):
                problem = f"its points do not tell all {count} coordinates apart"
                return np.inf, 1.0, problem
            share, tension = self.displacement(coarse, fine)
            kept = inertia_kept(coarse, fine)
        error = share / SAFETY
        if coarse.arm.effects.load:
            loads = " and loads"
        else:
            loads = ""
        size = "so far off that the arm has no rest"
        if np.isfinite(error):
            length = 1e3 * error * coarse.length
            size = f"off by about {100 * error:.2g} % of the length, {length:.2g} mm,"
        problem = f"the tip is {size} under tensions {shown_numbers(tension)} N{loads}"
        return error, kept, problem


def inertia_kept(coarse: Model, fine: Model) -> float:
    """The least part of its inertia that a combination of coordinates keeps at rest."""
    still = np.zeros(coarse.coordinate_count)
    M = coarse.terms(still, still).mass
    M_fine = fine.terms(still, still).mass
    # combinations that have inertia, of one unit each on the fine quadrature
    least_inertia = np.finfo(float).tiny
    diagonal = np.maximum(np.diag(M_fine), least_inertia)
    scale = 1.0 / np.sqrt(diagonal)
    scaled = M_fine * np.outer(scale, scale)
    sizes, directions = np.linalg.eigh(scaled)
    is_moving = sizes > NO_INERTIA * sizes[-1]
    moving_directions = directions[:, is_moving]
    moving = scale[:, None] * moving_directions
    roots = np.sqrt(sizes[is_moving])
    unit = moving / roots
    # their inertia on the coarse one
    coarse_inertia = unit.T @ M @ unit
    kept = np.linalg.eigvalsh(coarse_inertia)
    least = float(kept[0])
    return max(least, 0.0)


def _tensions_to_try(limits: Array, slack: Array) -> list[Array]:
    """Tensions (n_a,) [N] without repetitions: sets of tendons at their limits, each alone, none.

    Args:
        limits: least and greatest tension of each tendon (n_a, 2) [N].
        slack: the tensions next to none (n_a,) [N].
    """
    count = len(limits)
    tendons = np.arange(count)
    if 2**count <= CORNERS:
        two_sides = (2,) * count
        corners = np.indices(two_sides).reshape(count, -1)
        sides = np.flip(corners.T, axis=0)
    else:
        random = np.random.default_rng(0)
        sides = random.integers(2, size=(CORNERS, count))
    sides[0] = 1  # all at their greatest
    tensions = [limits[tendons, side] for side in sides]
    for i, tendon_limits in enumerate(limits):
        for limit in tendon_limits:
            alone = slack.copy()
            alone[i] = limit
            tensions.append(alone)
    tensions.append(slack)
    distinct = {tension.tobytes(): tension for tension in tensions}
    return list(distinct.values())


def _mass_error(coarse: Model, fine: Model) -> float:
    """Relative error of the moment of the rod's mass about its base."""
    moment = mass_moment_over_nodes(coarse.scene, coarse.grid)
    exact = mass_moment_over_points(fine.scene, fine.grid)
    return abs(moment / exact - 1.0)


def _share_of(displacement: Displacement) -> float:
    """The share of a displacement, to sort by."""
    return displacement.share


def _response(model: Model) -> Array:
    """Coordinates at rest by tensions (n, n_a) without effects.

    They are those of the strain law, or those of an explicit basis to first order.
    """
    strain = model.arm.strain
    if isinstance(strain, Implicit):
        unit_tensions = np.eye(model.tendon_count)
        columns = [strain.rest_coordinates(tension) for tension in unit_tensions]
        return np.transpose(columns)
    still = np.zeros(model.coordinate_count)
    B = model.terms(still, still).actuation
    return np.asarray(np.linalg.solve(model.metric, B))


def _unloaded_share(
    coarse: Model, fine: Model, responses: tuple[Array, Array], tension: Array
) -> float:
    """Distance of the tips on two quadratures, as a share of the length, under tensions alone.

    Where they have no strain, it is under the half, quarter.. of them that has one.
    """
    base = coarse.arm.base[9:]
    coarse_response, fine_response = responses
    for _ in range(MOST_HALVINGS):
        try:
            tip = _tip(coarse, coarse_response @ tension)
            fine_tip = _tip(fine, fine_response @ tension)
        except StrainLimitError:
            tension = 0.5 * tension
            continue
        from_base = [tip - base, fine_tip - base]
        distances = np.linalg.norm(from_base, axis=1)
        allowed = FARTHEST * coarse.length
        if distances.max() <= allowed:
            displacement = np.linalg.norm(fine_tip - tip)
            return float(displacement) / coarse.length
        tension = 0.5 * tension
    return 0.0


def _share_at_rest(coarse: Model, fine: Model, tension: Array, guess: Array) -> tuple[float, Array]:
    """`_unloaded_share` at rest under tensions and loads, and coordinates (n,) there.

    It has a margin for an arm that falls over.
    """
    with coarse.workspace() as work, fine.workspace() as fine_work:
        balance = Balance(coarse, tension, work)
        fine_balance = Balance(fine, tension, fine_work)
        path = LoadPath(balance, MOST_LINEARISATIONS)
        fine_path = LoadPath(fine_balance)
        end = _rest(path, guess)
        has_fallen = end.evaluation.part < 1.0
        q = end.evaluation.q
        fine_q = q
        if has_fallen:
            softest_mode = end.stability.modes[:, 0]
            q = q + FALL * softest_mode
            fine_q = q
        else:
            near = fine_path.equilibrium(q, 1.0)
            if near is not None:
                fine_q = near.evaluation.q
    try:
        fine_tip = _tip(fine, fine_q)
        tip = _tip(coarse, q)
    except StrainLimitError:
        return 0.0, guess
    displacement = np.linalg.norm(fine_tip - tip)
    share = float(displacement) / coarse.length
    if has_fallen:
        share *= MARGIN
    return share, q


def _tip(model: Model, q: Array) -> Array:
    """Position (3,) [m] of the tip at q (n,).

    Raises StrainLimitError.
    """
    pose = model.tip_pose(q)
    return pose[:3, 3]


def _rest(path: LoadPath, guess: Array) -> Linearised:
    """The stable equilibrium near a guess (n,), or the last one of a slowly loaded arm."""
    if guess.any():
        near = path.equilibrium(guess, 1.0)
        if near is not None and near.stability.stable:
            return near
    end, _ = path.rest()
    return end
