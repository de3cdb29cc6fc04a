"""How many intervals a scene needs: the estimate against the tip's true error, what is too coarse,
and how that is told."""

import contextlib
import warnings

import numpy as np
import pytest

from soft_tendon_env import (
    ConfigurationError,
    StrainLimitError,
    load_scene,
    static_equilibrium,
)
from soft_tendon_env.model import quadrature
from soft_tendon_env.model.build import QuadratureWarning, _check_turns, build_model
from soft_tendon_env.model.coordinates import resolving_intervals
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.quadrature import (
    CORNERS,
    QuadratureEstimate,
    QuadratureTest,
    _response,
    _share_at_rest,
    _tensions_to_try,
    _unloaded_share,
    inertia_kept,
)
from soft_tendon_env.scene.scene import MOST_INTERVALS

LOADS = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.01}
ANGULAR = ["torsion", "bend_y", "bend_z"]


def helices(turns):
    """Three tendons around the axis."""
    rate = 2 * np.pi * turns / 0.3
    routings = (
        {"type": "helix", "radius": 0.008, "angular_rate": rate, "phase": 120.0 * i}
        for i in range(3)
    )
    changes = {f"tendons__{i}__routing": routing for i, routing in enumerate(routings)}
    return three_tendon(**changes)


def three_tendon(**changes):
    return load_scene("three_tendon").replace(
        {key.replace("__", "."): value for key, value in changes.items()}
    )


def corners(scene, count=40):
    """Tendons slack or at their limits: each alone, all, and at random."""
    limits = [tendon.tension_limits[1] for tendon in scene.tendons]
    greatest = np.array(limits)
    random = np.random.default_rng(1)
    chosen = random.random((count, greatest.size)) < 0.5
    return greatest * np.unique(
        np.vstack([np.eye(greatest.size), np.ones(greatest.size), chosen]), axis=0
    )


def true_error(scene, intervals, fine=64):
    """Largest displacement of the tip at rest by this quadrature, against a fine one, as a share of
    the length."""
    coarse, exact = (
        build_model(scene.replace({"quadrature.intervals": count})) for count in (intervals, fine)
    )
    largest = 0.0
    for tension in corners(scene):
        near = static_equilibrium(exact, tension)
        found = static_equilibrium(coarse, tension, near.q)
        assert near.converged
        assert found.converged
        largest = max(
            largest,
            float(np.linalg.norm(found.tip_pose[:3, 3] - near.tip_pose[:3, 3])) / coarse.length,
        )
    return largest


def test_least_and_tolerance_are_kept():
    """The error is of fourth order in the number of intervals."""
    assert QuadratureTest(three_tendon()).search(4).intervals == 4
    scenes = [
        helices(3).replace({"quadrature.tolerance": tolerance}) for tolerance in (1e-2, 1e-4, 1e-6)
    ]
    counts = [QuadratureTest(scene).search(4).intervals for scene in scenes]
    ratios = np.divide(counts[1:], counts[:-1])
    np.testing.assert_allclose(np.log10(ratios), 0.5, atol=0.07)


@pytest.fixture
def searched(monkeypatch):
    """searched(excess): where the search from 4 intervals ends, and the numbers that it tried, for
    errors of this excess by the number of intervals."""

    def search(excess):
        test = QuadratureTest(three_tendon())
        tried = []

        def estimate(count):
            tried.append(count)
            found = excess(count)
            problem = ""
            if found > 1.0:
                problem = "too coarse"
            return QuadratureEstimate(count, found, problem, found)

        monkeypatch.setattr(test, "error_estimate", estimate)
        return test.search(4).intervals, tried

    return search


@pytest.mark.parametrize("enough", [4, 5, 30, 90, 200])
def test_the_search_goes_where_the_order_leads(searched, enough):
    """Errors of fourth order end it within a few percent, by doublings and one step more."""
    intervals, tried = searched(lambda count: (enough / count) ** 4)
    assert enough <= intervals <= 1.05 * enough + 1
    doublings = np.log2(enough / 4)
    assert len(tried) <= np.ceil(doublings) + 2
    assert tried == sorted(tried)


@pytest.mark.parametrize(
    ("order", "last"), [(0.5, 128), (1.5, MOST_INTERVALS)], ids=["hopeless", "slow"]
)
def test_the_search_ends_where_twice_as_many_do_not_even_halve_the_error(searched, order, last):
    """From 96 intervals on; else it goes on to the finest."""
    intervals, _ = searched(lambda count: 1e9 / count**order)
    assert intervals == last


def modes(order):
    return [{"strains": ANGULAR, "order": order, "span": "rod"}]


KINDS = {
    "helical": load_scene("helical"),
    "loaded": helices(2).replace(LOADS),
    "passive": helices(2).replace({"strain.passive": modes(2), **LOADS}),
    "explicit": helices(2).replace({"strain": {"type": "explicit", "modes": modes(4)}}),
}


@pytest.mark.parametrize("intervals", [4, 8])
@pytest.mark.parametrize("scene", [pytest.param(scene, id=name) for name, scene in KINDS.items()])
def test_the_estimate_is_the_largest_error_and_a_margin(scene, intervals):
    estimate = QuadratureTest(scene).error_estimate(intervals).error
    true = true_error(scene, intervals)
    assert true < estimate < 2.0 * true


@pytest.mark.parametrize(("share", "is_told"), [(0.95, True), (1.05, False)])
def test_an_error_above_the_tolerance_is_a_problem(share, is_told):
    error = QuadratureTest(helices(2)).error_estimate(8).error
    changes = {"quadrature.tolerance": share * error}
    allowed = helices(2).replace(changes)
    estimate = QuadratureTest(allowed).error_estimate(8)
    assert estimate.excess == pytest.approx(1.0 / share, rel=1e-9)
    assert bool(estimate.problem) == is_told


def test_the_mass_of_a_disc_is_not_missed():
    """A disc on the arm strains nothing, and is all the more mass."""
    disc = {
        "type": "table",
        "arc_length": [0.0, 0.13, 0.14, 0.16, 0.17, 0.3],
        "radius": [0.01, 0.01, 0.02, 0.02, 0.01, 0.01],
    }
    scene = three_tendon(segments__0__radius=disc, quadrature__tolerance=1.0)
    assert (
        "the moment of the rod's mass is off by" in QuadratureTest(scene).error_estimate(6).problem
    )
    test = QuadratureTest(scene).search(scene.quadrature.least)
    counts = test.intervals, 400
    mass, exact = (
        build_model(scene.replace({"quadrature.intervals": count})).arm.rod.mass for count in counts
    )
    assert abs(mass / exact - 1.0) < 0.02


def test_too_few_intervals_are_told_with_tensions_error_and_what_would_do():
    changes = {"quadrature.intervals": 6, "tendons.1.tension_limits": [0.0, 8.0]}
    scene = helices(3).replace(changes)
    with pytest.warns(QuadratureWarning) as caught:
        build_model(scene)
    enough = QuadratureTest(scene).search(6).intervals
    estimate = QuadratureTest(scene).error_estimate(6)
    off = (
        f"the tip is off by about {100 * estimate.error:.2g} % of the length,"
        f" {300 * estimate.error:.2g} mm"
    )
    assert (
        f"with 6 intervals per piece {off}, under tensions [0, 8, 0] N; {enough} would do"
        in str(caught[0].message)
    )
    with warnings.catch_warnings(action="error", category=QuadratureWarning):
        build_model(scene.replace({"quadrature.intervals": enough}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strain__strains": ["torsion"]}, "gives no coordinates"),
        (
            {
                "strain__include_loads": True,
                "effects__gravity__acceleration": [-9.81, 0.0, 0.0],
                "effects__tip_load__mass": 0.5,
            },
            "does not hold the loads",
        ),
    ],
)
def test_arms_that_no_quadrature_makes_a_model_of_are_refused(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        build_model(three_tendon(**changes))


def test_tensions_are_tried_at_all_corners_and_alone():
    """None twice; of many tendons some corners."""
    rows = [[0.0, 5.0], [-1.0, 3.0], [2.0, 4.0]]
    limits = np.array(rows)
    slack = np.array([0.0, 0.0, 2.0])
    tried = _tensions_to_try(limits, slack)
    sides_of_box = np.ndindex(2, 2, 2)
    corners = {tuple(limits[range(3), sides]) for sides in sides_of_box}
    alone = {
        tuple(np.where(np.arange(3) == i, limits[i, side], slack))
        for i in range(3)
        for side in (0, 1)
    }
    expected = corners | alone | {tuple(slack)}
    assert {tuple(tension) for tension in tried} == expected
    assert len(tried) == len(expected)
    np.testing.assert_array_equal(tried[0], limits[:, 1])
    many = np.tile([0.0, 1.0], (10, 1))
    tried = _tensions_to_try(many, np.zeros(10))
    assert CORNERS < len(tried) <= CORNERS + 11
    np.testing.assert_array_equal(tried[0], 1.0)


def test_finer_quadratures_resolve_waves_and_fields():
    """Four intervals a wave, three for each Legendre function of a field."""
    assert resolving_intervals(three_tendon()) == 3
    assert resolving_intervals(helices(3)) == pytest.approx(4 * 3, abs=1)
    assert resolving_intervals(helices(12)) == pytest.approx(4 * 12, abs=1)
    changes = {"tendons.1.routing": helices(12).tendons[1].routing}
    one_fast = helices(3).replace(changes)
    assert resolving_intervals(one_fast) == pytest.approx(4 * 12, abs=1)
    two_pieces = helices(12).replace({"tendons.*.end": 0.2})
    assert resolving_intervals(two_pieces) == pytest.approx(4 * 12 * 2 / 3, abs=1)
    explicit = three_tendon(strain={"type": "explicit", "modes": modes(7)})
    assert resolving_intervals(explicit) == 24
    assert resolving_intervals(helices(1e5)) == MOST_INTERVALS


def test_the_least_inertia_is_that_of_the_worst_combination():
    """Of two constant curvatures on one interval, whose node at the tip alone has mass; against
    that on many."""
    test = QuadratureTest(three_tendon(strain={"type": "explicit", "modes": modes(0)}))
    coarse = test.model(1)
    fine = test.model(12)
    still = np.zeros(3)
    M = coarse.terms(still, still).mass
    M_fine = fine.terms(still, still).mass
    product = np.linalg.solve(M_fine, M)
    ratios = np.linalg.eigvals(product).real
    least = pytest.approx(ratios.min(), rel=1e-9)
    assert inertia_kept(coarse, fine) == least
    assert inertia_kept(fine, fine) == pytest.approx(1.0)


def test_the_displacement_is_that_of_the_tips_under_the_worst_tension():
    """Of all that are tried, as a share of the length."""
    changes = {"tendons.1.tension_limits": [0.0, 8.0]}
    scene = helices(3).replace(changes)
    test = QuadratureTest(scene)
    coarse = test.model(5)
    fine = test.model(24)
    worst = test.displacement(coarse, fine)
    shares = []
    for tension in test.tensions:
        tips = []
        for model in (coarse, fine):
            q = model.rest_coordinates(tension)
            tips.append(model.tip_pose(q)[:3, 3])
        way = tips[1] - tips[0]
        share = np.linalg.norm(way) / 0.3
        shares.append(share)
    assert worst.share == pytest.approx(max(shares), rel=1e-9)
    place = int(np.argmax(shares))
    np.testing.assert_array_equal(worst.tension, test.tensions[place])


def test_an_arm_that_falls_over_is_compared_where_it_is_bent_by_three_radians():
    """Beyond its buckling load there is no rest to compare; a factor of 2 is for other shapes."""
    length = 0.3
    bending = 5e5 * np.pi * 0.01**4 / 4
    # the load at which one constant curvature buckles
    critical = 3.0 * bending / length**2
    push = [-1.5 * critical, 0.0, 0.0]
    one_curvature = {"strains": ["bend_z"], "order": 0, "span": "rod"}
    strain = {"type": "explicit", "modes": [one_curvature]}
    scene = three_tendon(strain=strain, effects__tip_load__force=push)
    coarse = model_on(scene, 2)
    fine = model_on(scene, 12)
    slack = np.zeros(3)
    share, q = _share_at_rest(coarse, fine, slack, np.zeros(1))
    angle = abs(q[0]) * length
    assert angle == pytest.approx(3.0, rel=1e-6)
    way = fine.tip_pose(q) - coarse.tip_pose(q)
    displacement = np.linalg.norm(way[:3, 3])
    assert displacement > 0.0
    expected_share = 2.0 * displacement / length
    assert share == pytest.approx(expected_share)


@pytest.mark.parametrize(("share", "is_refused"), [(0.99, False), (1.01, True)])
def test_rods_that_turn_more_often_than_there_are_intervals_are_refused(share, is_refused):
    """Of two pieces, one of which ends with a tendon."""
    turns = share * 2 * MOST_INTERVALS
    whole = turns * 2 * np.pi / 0.3
    curvature = [0.0, 0.6 * whole, 0.8 * whole]
    scene = three_tendon(segments__0__curvature=curvature, tendons__0__end=0.2)
    refused = pytest.raises(ConfigurationError, match="finest quadrature tells")
    with refused if is_refused else contextlib.nullcontext():
        _check_turns(scene)


@pytest.mark.parametrize(
    ("error", "mass", "kept", "excess", "problem"),
    [
        (0.8, 0.0, 1.0, 0.8, ""),
        (3.0, 0.03, 1.0, 3.0, "the tip is off"),
        (0.1, 0.03, 1.0, 1.5, "the moment of the rod's mass is off by 3 %"),
        (0.1, 0.0, 0.05, 2.0, "a combination of coordinates keeps 5 % of its inertia"),
        (0.1, 0.0, 0.0, 1e3, "keeps 0 % of its inertia"),
        (0.1, 0.019, 0.11, 0.95, ""),
    ],
)
def test_the_worst_of_the_errors_says_what_is_too_coarse(
    monkeypatch, error, mass, kept, excess, problem
):
    """Of the tip, by the scene's tolerance; of the mass, by 2 %; of the inertia, a tenth of which
    has to be left."""
    test = QuadratureTest(three_tendon(quadrature__tolerance=1e-3))
    monkeypatch.setattr(test, "_at_rest", lambda *models: (1e-3 * error, kept, "the tip is off"))
    monkeypatch.setattr(quadrature, "_mass_error", lambda *models: mass)
    estimate = test.error_estimate(4)
    assert estimate.excess == pytest.approx(excess)
    assert estimate.error == pytest.approx(1e-3 * error)
    assert problem in estimate.problem
    assert bool(estimate.problem) == bool(problem)


def test_tensions_that_no_strain_balances_are_halved_until_one_does():
    """On both quadratures; their tips are no farther away than two lengths."""
    scene = helices(2)
    test = QuadratureTest(scene)
    models = (test.model(6), test.model(24))
    responses = tuple(_response(model) for model in models)
    absurd = np.array([4e3, 0.0, 0.0])
    found = _unloaded_share(*models, responses, absurd)

    def share_under(tension):
        tips = [model.tip_pose(model.rest_coordinates(tension))[:3, 3] for model in models]
        way = tips[1] - tips[0]
        return np.linalg.norm(way) / 0.3

    tension = absurd
    while True:
        with contextlib.suppress(StrainLimitError):
            expected = share_under(tension)
            break
        tension = 0.5 * tension
    assert tension[0] < absurd[0]
    assert found == pytest.approx(expected)


def test_loaded_arms_are_compared_slack_tense_and_half_way():
    """And under the worst tensions of the unloaded arm: no share there is larger."""
    scene = helices(2).replace(LOADS)
    test = QuadratureTest(scene)
    coarse = test.model(5)
    fine = test.model(16)
    worst = test.displacement(coarse, fine)
    full = test.limits[:, 1]
    for tension in (test.slack, 0.5 * full, full):
        guess = static_equilibrium(coarse, tension).q
        share, _ = _share_at_rest(coarse, fine, tension, guess)
        assert share <= worst.share * (1.0 + 1e-6)
    found = static_equilibrium(coarse, worst.tension)
    exact = static_equilibrium(fine, worst.tension, found.q)
    way = exact.tip_pose - found.tip_pose
    off = np.linalg.norm(way[:3, 3])
    assert worst.share == pytest.approx(off / 0.3, rel=1e-5)


def test_fields_that_strain_a_rod_alike_are_refused():
    """At the points of one interval a quadratic field is a constant one."""
    strain = {"type": "explicit", "modes": [{"strains": ANGULAR, "order": 2, "span": "rod"}]}
    coarse = three_tendon(strain=strain, quadrature__intervals=1)
    with pytest.raises(ConfigurationError, match="9 coordinates of which some strain the rod"):
        build_model(coarse)
