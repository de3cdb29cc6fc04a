"""Loads under which an arm has several equilibria, or loses the one it has: which of them the
statics find, and what they say.

The answer wanted is that of an experiment: load the arm slowly, and see where it goes.
"""

import numpy as np
import pytest
import random_scenes

import soft_tendon_env as ste

KIRCHHOFF = ["torsion", "bend_y", "bend_z"]


def payload_of(mass, acceleration=(0.0, 0.0, -9.81)):
    return {"effects.gravity.acceleration": list(acceleration), "effects.tip_load.mass": mass}


@pytest.mark.parametrize(
    ("name", "payload", "acceleration"),
    [
        ("four_tendon", 0.5, (0.0, 0.0, -9.81)),
        pytest.param("three_tendon", 0.3, (0.0, 0.0, -9.81), marks=pytest.mark.slow),
        pytest.param("paper", 0.5, (0.0, 0.0, -9.81), marks=pytest.mark.slow),
        pytest.param("two_segment_six", 0.4, (0.0, 6.0, -8.0), marks=pytest.mark.slow),
        pytest.param("helical", 0.3, (-1.0, 9.0, 3.0), marks=pytest.mark.slow),
        pytest.param("paper moments 0-2", 0.3, (-3.0, 0.0, -9.0), marks=pytest.mark.slow),
    ],
)
def test_payloads_that_fold_the_arm(build, measured, tip_distance, name, payload, acceleration):
    """A payload that the arm can hardly carry, slack and under 12 random tensions: Newton at the
    full load lands on other equilibria, unstable or stable, up to half a metre away. Expected: the
    stable equilibrium that loading in moves of 0.02 rad reaches, to 1e-6 of the length."""
    model = build(name, payload_of(payload, acceleration))
    dice = np.random.default_rng(0)
    greatest = np.array([tendon.tension_limits[1] for tendon in model.scene.tendons])
    for u in [
        np.zeros(greatest.size),
        *dice.uniform(0.0, 0.5 * np.minimum(greatest, 20.0), (12, greatest.size)),
    ]:
        found = ste.static_equilibrium(model, u)
        assert found.converged, found.reason
        assert found.stable, found.reason
        assert found.load == 1.0, found.reason
        q, reached = random_scenes.slow_loading(model, u, move=0.02)
        assert reached == 1.0
        tip_pose = model.tip_pose(q)
        distance = tip_distance(found.tip_pose, tip_pose)
        measured("tip to slow loading [m]", distance)
        assert distance < 1e-6 * model.length


@pytest.mark.slow
def test_weight_that_grows_on_a_column(measured, one_segment):
    """A slender column stands on its base under a weight that grows: the straight column is an
    equilibrium at any weight. Expected: told as a bifurcation at Greenhill's load, 7.837 EI / L^3,
    to 1 %; the bent arm, hanging, where it may settle."""
    radius = 0.01
    density = 1000.0
    young = 1e6
    critical = 7.837 * young * radius**2 / 4 / density  # g at a length of 1 m
    strain = {"type": "explicit", "modes": [{"strains": KIRCHHOFF, "order": 6, "span": "rod"}]}
    for factor, stands in ((0.98, True), (1.02, False), (3.0, False)):
        changes = {
            "strain": strain,
            "quadrature.intervals": 16,
            "effects.gravity.acceleration": [-factor * critical, 0.0, 0.0],
        }
        model = one_segment(radius=radius, density=density, young_modulus=young, changes=changes)
        found = ste.static_equilibrium(model, np.zeros(3))
        assert (found.converged and found.stable) == stands
        if not stands:
            assert "bifurcation" in found.reason
            measured("load reached / Greenhill's", found.load * factor)
            assert found.load * factor == pytest.approx(1.0, abs=0.01)
            settled = ste.static_equilibrium(model, np.zeros(3), settle=True)
            assert settled.converged, settled.reason
            assert settled.stable, settled.reason
            assert settled.tip_pose[0, 3] < 0.999
            straight = 0.0 * settled.q
            assert model.energy(settled.q, straight).total < model.energy(straight, straight).total
    assert settled.tip_pose[0, 3] < -0.3  # at three times the load it has fallen over


@pytest.mark.slow
def test_follower_force_on_a_column(measured, one_segment):
    """A force that stays tangential to the tip (Beck's column): no other equilibrium exists, and
    the straight one begins to flutter. Expected: flutter is told at 20.05 EI / L^2, to 1 %."""
    radius = 0.01
    young = 1e6
    critical = 20.05 * young * np.pi * radius**4 / 4
    strain = {"type": "explicit", "modes": [{"strains": KIRCHHOFF, "order": 6, "span": "rod"}]}
    for factor, stands in ((0.98, True), (1.02, False), (2.0, False)):
        load = {
            "effects.tip_load.force": [-factor * critical, 0.0, 0.0],
            "effects.tip_load.frame": "tip",
        }
        changes = {"strain": strain, "quadrature.intervals": 16, **load}
        model = one_segment(radius=radius, young_modulus=young, damping=1e-3, changes=changes)
        found = ste.static_equilibrium(model, np.zeros(3))
        assert (found.converged and found.stable) == stands, found.reason
        if not stands:
            assert "flutter" in found.reason
            measured("load reached / Beck's", found.load * factor)
            assert found.load * factor == pytest.approx(1.0, abs=0.01)
    assert not ste.static_equilibrium(
        model, np.zeros(3), settle=True
    ).converged  # it has nowhere to rest


@pytest.mark.parametrize(
    "name",
    [
        "three_tendon",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("four_tendon", "paper")),
    ],
)
def test_statics_end_where_slow_motion_ends(build, measured, tip_distance, name):
    """Gravity and a payload that folds the arm, tensions that grow over 20 s in a simulation from
    the equilibrium without tension. Expected: after a rest the simulated tip is at the equilibrium
    that the statics find, to 1e-5 of the length."""
    payload = {"four_tendon": 0.5, "three_tendon": 0.3, "paper": 0.5}[name]
    model = build(name, payload_of(payload))
    dice = np.random.default_rng(1)
    u = dice.uniform(0.0, 4.0, model.tendon_count)
    rest = ste.static_equilibrium(model, np.zeros(model.tendon_count))
    initial = ste.Simulation(model).reset(rest.q)
    motion = ste.simulate(model, lambda t: min(t / 20.0, 1.0) * u, 150.0, 0.5, initial=initial)
    distance = tip_distance(motion.tip_pose[-1], ste.static_equilibrium(model, u).tip_pose)
    measured("tip to equilibrium [m]", distance)
    assert distance < 1e-5 * model.length
