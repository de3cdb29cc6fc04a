"""Balance of an arm at rest: its stiffness, stability and flutter against closed forms, and where
an arm settles beyond its buckling load."""

import numpy as np
import pytest
from scipy.optimize import brentq

from soft_tendon_env.model.equilibrium_residual import Balance, Linearised
from soft_tendon_env.model.load_continuation import SOFT, LoadPath
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

LENGTH = 0.3  # [m]
BENDING = 5e5 * np.pi * 0.01**4 / 4  # [N m^2]
TENSION = np.array([2.0, 0.5, 1.0])  # [N]


@pytest.fixture
def balance(bent):
    """That of the arm with two curvatures under its weight."""
    with bent.workspace() as work:
        yield Balance(bent, TENSION, work)


def test_a_balance_has_its_derivatives(balance):
    """S = -df/dq, its inverse, and how the equilibrium moves with the part of the load."""
    q = np.array([1.5, -0.7])
    part = 0.6
    here = balance.linearise(q, part)
    size = np.abs(here.stiffness).max()
    h = 1e-5
    for column, unit in enumerate(np.eye(2)):
        ahead = balance.at(q + h * unit, part).force
        behind = balance.at(q - h * unit, part).force
        slope = (behind - ahead) / (2.0 * h)
        np.testing.assert_allclose(here.stiffness[:, column], slope, atol=1e-6 * size)
    product = here.compliance @ here.stiffness
    np.testing.assert_allclose(product, np.eye(2), atol=1e-9)
    more = balance.at(q, part + h).force
    less = balance.at(q, part - h).force
    rate = (more - less) / (2.0 * h)
    moved = here.stiffness @ here.tangent
    np.testing.assert_allclose(moved, rate, rtol=1e-6, atol=1e-9)


def test_the_residual_is_the_angle_that_the_force_bends_by(balance):
    """sqrt(f^T G^-1 f / (E + q^T G q)), with twice the energy E of bending by 1 rad."""
    q = np.array([1.5, -0.7])
    found = balance.at(q, 0.6)
    answer = np.linalg.solve(found.G, found.force)
    unbalanced = found.force @ answer
    stored = BENDING / LENGTH + q @ found.G @ q
    expected_residual = np.sqrt(unbalanced / stored)
    assert found.residual == pytest.approx(expected_residual)
    turned = balance.angle(answer)
    metric = BENDING * LENGTH
    squared = metric * (answer @ answer)
    expected_turned = np.sqrt(squared * LENGTH / BENDING)
    assert turned == pytest.approx(expected_turned)


def test_steps_along_a_path_are_cubics_through_equilibria(balance, monkeypatch):
    """Their middles are off one by the fourth power of the step, judged by either end's
    stiffness."""
    path = LoadPath(balance)
    begin = path.equilibrium(np.zeros(2), 0.4)
    strays = []
    seen = []
    stray = path._stray

    def recorded(middle, point, ahead):
        size = stray(middle, point, ahead)
        strays.append(size)
        part = 0.5 * (point.evaluation.part + ahead.evaluation.part)
        force = balance.at(middle, part).force
        ways = [balance.angle(end.compliance @ force) for end in (point, ahead)]
        seen.append(max(ways))
        return size

    monkeypatch.setattr(path, "_stray", recorded)
    for step in (0.2, 0.1):
        end = path.step(begin, 0.4 + step)
        assert end.evaluation.part == 0.4 + step
        assert end.evaluation.residual <= 1e-7
    assert np.log2(strays[0] / strays[1]) == pytest.approx(4.0, abs=0.3)
    np.testing.assert_allclose(strays, seen, rtol=1e-9)


@pytest.mark.parametrize(("stray", "is_taken"), [(0.09, True), (0.11, False)])
def test_steps_off_their_path_are_not_taken(balance, monkeypatch, stray, is_taken):
    """By more than a tenth of a radian in their middle, of an arm that is stiff at both ends."""
    path = LoadPath(balance)
    begin = path.equilibrium(np.zeros(2), 0.4)
    assert begin.stability.least > SOFT
    monkeypatch.setattr(path, "_stray", lambda *middle: stray)
    end = path.step(begin, 0.5)
    assert (end is not None) == is_taken
    assert bool(balance.obstacle) != is_taken


@pytest.mark.parametrize(("share", "is_continuous"), [(0.5, True), (1.5, False)])
def test_strains_break_where_pushes_outweigh_the_shear_stiffness(share, is_continuous):
    """T / |t| = G A of a straight tendon that pushes; what broke is said, and nothing else."""
    scene = load_scene("three_tendon")
    model = model_on(scene, 4)
    with model.workspace() as work:
        balance = Balance(model, np.zeros(3), work)
        stiffness = 5e5 / 3.0 * np.pi * 0.01**2
        push = model.rest_coordinates([-share * stiffness, 0.0, 0.0])
        assert balance.is_continuous(np.zeros(3), push) == is_continuous
        assert bool(balance.obstacle) != is_continuous
        if not is_continuous:
            assert "on the way: the tendons push past" in balance.obstacle


def with_stiffness(balance, stiffness):
    """The unloaded arm with another tangent stiffness, whose compliance is None where it has
    none."""
    here = balance.unloaded()
    compliance = balance._inverse(stiffness)
    return Linearised(balance, here.evaluation, stiffness, compliance, here.tangent)


@pytest.mark.parametrize(("share", "flutters"), [(0.9, False), (1.1, True)])
def test_loads_that_turn_the_arm_about_make_it_flutter(balance, share, flutters):
    """m q_ddot + d q_dot + (k 1 + c J) q = 0 has s^2 m + s d + k = +-i c, which grows beyond c = d
    sqrt(k / m)."""
    still = np.zeros(2)
    terms = balance.model.terms(still, still)
    mass = terms.mass[0, 0]
    damping = terms.damping[0, 0]
    stiffness = BENDING * LENGTH
    expected_mass = mass * np.eye(2)
    np.testing.assert_allclose(terms.mass, expected_mass, rtol=1e-9, atol=1e-12)
    expected_damping = damping * np.eye(2)
    np.testing.assert_allclose(terms.damping, expected_damping, rtol=1e-9, atol=1e-12)
    circulation = share * damping * np.sqrt(stiffness / mass)
    turning = circulation * np.array([[0.0, 1.0], [-1.0, 0.0]])
    stability = with_stiffness(balance, stiffness * np.eye(2) + turning).stability
    assert not stability.has_potential
    assert stability.flutters == flutters
    assert stability.stable != flutters
    # the real part is that of the springs alone
    assert stability.least == pytest.approx(1.0)


@pytest.mark.parametrize(("least", "stable"), [(0.3, True), (0.0, True), (-0.01, False)])
def test_an_arm_is_stable_down_to_no_stiffness(balance, least, stable):
    """By the least eigenvalue over that of the unloaded arm, whose mode bends by 1 rad."""
    direction = np.array([0.6, 0.8])
    other = np.array([-0.8, 0.6])
    stiffness = least * np.outer(direction, direction) + np.outer(other, other)
    point = with_stiffness(balance, BENDING * LENGTH * stiffness)
    stability = point.stability
    assert stability.has_potential
    assert stability.stable == stable
    assert stability.least == pytest.approx(least, abs=1e-9)
    softest = stability.modes[:, 0]
    assert balance.angle(softest) == pytest.approx(1.0)
    assert abs(softest @ other) < 1e-9


def test_neutral_modes_have_no_compliance_and_others_theirs(balance):
    """Where a buckled column rests to any side."""
    direction = np.array([0.6, 0.8])
    stiff = BENDING * LENGTH * np.outer(direction, direction)
    compliance = balance._inverse(stiff)
    expected = np.outer(direction, direction) / (BENDING * LENGTH)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(compliance, expected, atol=1e-9 * largest)
    singular = np.array([[1.0, 1.0], [0.0, 0.0]])
    assert balance._inverse(BENDING * LENGTH * singular) is None
    assert "gives way without further load" in balance.obstacle


@pytest.mark.parametrize(
    ("tangent", "reason"),
    [([0.6, 0.8], "snaps"), ([-0.8, 0.6], "buckles")],
    ids=["snaps", "buckles"],
)
def test_a_soft_arm_snaps_along_its_softest_mode_and_buckles_beside_it(balance, tangent, reason):
    """By the way on which the load moves it: a limit point, or a bifurcation."""
    softest = np.array([0.6, 0.8])
    other = np.array([-0.8, 0.6])
    stiffness = 0.1 * np.outer(softest, softest) + np.outer(other, other)
    point = with_stiffness(balance, BENDING * LENGTH * stiffness)
    moved = Linearised(
        balance, point.evaluation, point.stiffness, point.compliance, np.array(tangent)
    )
    percent = 100.0 * point.evaluation.part
    told = LoadPath(balance)._reason(moved)
    assert told.startswith(f"beyond {percent:.4g} % of the load: the arm ")
    assert reason in told


CRITICAL = 3.0 * BENDING / LENGTH**2
"""Push [N] at which an arm with one constant curvature buckles: the energy EI k^2 L / 2 + P sin(k
L) / k has no least at k = 0 beyond it."""


@pytest.mark.parametrize("share", [0.9, 1.004, 1.2, 1.6])
def test_a_column_settles_beyond_its_buckling_load_at_the_least_of_its_energy(share):
    """Slowly loaded it buckles there; let go it comes to rest bent to either side."""
    push = share * CRITICAL
    modes = [{"strains": ["bend_z"], "order": 0, "span": "rod"}]
    changes = {
        "strain": {"type": "explicit", "modes": modes},
        "effects.tip_load.force": [-push, 0.0, 0.0],
    }
    scene = load_scene("three_tendon").replace(changes)
    model = model_on(scene, 4)
    slack = np.zeros(3)
    loaded = static_equilibrium(model, slack)
    settled = static_equilibrium(model, slack, settle=True)
    assert settled.converged
    assert settled.stable
    if share < 1.0:
        assert loaded.converged
        np.testing.assert_allclose(settled.q, 0.0, atol=1e-9)
        return
    assert not loaded.converged
    assert "buckles" in loaded.reason
    assert loaded.load == pytest.approx(1.0 / share, rel=2e-3)

    def slope(k):
        angle = k * LENGTH
        shortening = angle * np.cos(angle) - np.sin(angle)
        return BENDING * LENGTH * k + push * shortening / k**2

    expected = brentq(slope, 0.1, np.pi / LENGTH)
    assert abs(settled.q[0]) == pytest.approx(expected, rel=1e-5)


def test_loads_that_flutter_leave_nowhere_to_settle(fluttering):
    """A force that follows the tip has no potential, and no energy that is least."""
    found = static_equilibrium(fluttering, np.zeros(3))
    assert not found.converged
    assert "flutter" in found.reason
    # the rod's own rotary inertia and shear are small
    assert found.load == pytest.approx(1.0 / 1.1, rel=0.02)
