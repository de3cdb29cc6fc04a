"""States near rest, found fast: against the statics, where there is no equilibrium, and parts of loads."""

import numpy as np
import pytest

from soft_tendon_env.model.quadrature_trial import TIGHT, Probe
from soft_tendon_env.model.statics import static_equilibrium, static_stiffness

GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
FORCE = {"effects.tip_load.force": [-0.05, 0.02, 0.1]}
MODES = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 2, "span": "rod"}]
ARMS = {
    "unloaded": {},
    "gravity": GRAVITY,
    "passive": {"strain.passive": MODES, **GRAVITY, **FORCE},
    "explicit": {"strain": {"type": "explicit", "modes": MODES}, **GRAVITY},
}


def probe_and_model(build, name, changes):
    model = build(name, {**changes, "quadrature.intervals": 6})
    return Probe(model.scene, 6), model


@pytest.mark.parametrize("changes", [pytest.param(changes, id=name) for name, changes in ARMS.items()])
@pytest.mark.parametrize("name", ("three_tendon", "four_tendon"))
def test_a_tight_state_is_the_equilibrium(build, name, changes):
    probe, model = probe_and_model(build, name, changes)
    tension = 0.4 * np.array([tendon.tension_limits[1] for tendon in model.scene.tendons]) * (np.arange(model.tendon_count) != 1)
    held = probe.find(tension, probe.rest(tension), 1.0, TIGHT)
    rest = static_equilibrium(model, tension, held.q)
    assert probe.place(held.q) == 1.0 and rest.converged
    np.testing.assert_allclose(probe.tip, rest.tip_pose[:3, 3], atol=3e-6 * model.length)


def test_hold_is_near_rest_under_all_of_a_load(build):
    probe, model = probe_and_model(build, "three_tendon", {**GRAVITY, "effects.tip_load.mass": 0.02})
    tension = np.array([3.0, 0.0, 1.0])
    held = probe.hold(tension)
    assert held.part == 1.0 and probe.parts(tension)[0] < 1.0
    np.testing.assert_array_equal(held.tension, tension)
    rest = static_equilibrium(model, tension, held.q)
    assert rest.converged and probe.place(held.q) == 1.0
    np.testing.assert_allclose(probe.tip, rest.tip_pose[:3, 3], atol=5e-3 * model.length)


def test_the_compliance_is_the_inverse_stiffness(build):
    probe, model = probe_and_model(build, "helical", {**GRAVITY, "strain.passive": MODES})
    tension = np.array([5.0, 0.0, 0.0, 5.0, 0.0])
    on_the_way = probe.find(tension, probe.rest(tension), 1.0, TIGHT)  # its stiffness is that of one of the last steps
    held = probe.find(tension, on_the_way.q, 1.0, TIGHT)
    stiffness = static_stiffness(model, held.q, tension)
    np.testing.assert_allclose(np.linalg.eigvals(on_the_way.compliance @ stiffness), 1.0, atol=0.1)
    np.testing.assert_allclose(np.linalg.eigvals(held.compliance @ stiffness), 1.0, atol=1e-3)


def test_the_tip_jacobian_is_the_derivative_of_the_tip(build):
    probe, _ = probe_and_model(build, "helical", {})
    q, still = np.array([4.0, 1.0, 0.0, 3.0, 2.0]), np.zeros(5)
    probe.place(q)
    probe.force(still, q, 1.0)
    jacobian, tips = probe.tip_jacobian, []
    for j in range(5):
        for sign in (1.0, -1.0):
            probe.place(q + sign * 1e-5 * np.eye(5)[j])
            tips.append(probe.tip)
    np.testing.assert_allclose(jacobian.T, (np.array(tips[::2]) - tips[1::2]) / 2e-5, atol=1e-9)


def test_no_state_where_there_is_no_strain(build):
    probe, _ = probe_and_model(build, "three_tendon", {})
    absurd = np.array([-1e6, 0.0, 0.0])
    assert probe.place(probe.rest(absurd)) < 1.0
    assert probe.find(absurd, probe.rest(absurd), 1.0, TIGHT) is None and probe.hold(absurd) is None


def test_hold_stops_at_the_part_of_a_load_that_bends_an_arm_that_far(build):
    """A pull at the tip, following it, a thousand times what bends the arm: no state but under a part of it."""
    probe, _ = probe_and_model(build, "three_tendon", {"effects.tip_load.force": [-300.0, 1.0, 0.0], "effects.tip_load.frame": "tip"})
    held = probe.hold(np.zeros(3))
    assert held is None or held.part < 1.0
