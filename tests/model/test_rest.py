"""Rest of an arm under tensions and loads: where simulations begin, and where a diverged one is;
equilibria beside others, and arms that rest nowhere."""

import pickle

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.reference_model import rest_near
from soft_tendon_env.model.simulation import NoEquilibriumError, Simulation, SimulationDiverged
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

LENGTH = 0.3  # [m]
BENDING = 5e5 * np.pi * 0.01**4 / 4  # [N m^2]
CRITICAL = 3.0 * BENDING / LENGTH**2  # [N] at which one constant curvature buckles
SLACK = np.zeros(3)
PULLED = np.array([2.0, 0.0, 1.0])
PUSH = "effects.tip_load.force"


def column(share):
    """The arm with one constant curvature under a share of its buckling load."""
    modes = [{"strains": ["bend_z"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    push = -share * CRITICAL
    changes = {"strain": strain, PUSH: [push, 0.0, 0.0]}
    scene = load_scene("three_tendon").replace(changes)
    return model_on(scene, 4)


@pytest.mark.parametrize("weight", [0.0, -9.81])
@pytest.mark.parametrize("tension", [SLACK, PULLED], ids=["slack", "pulled"])
def test_a_simulation_that_begins_at_rest_stays(build, weight, tension):
    """Under the weight alone, tensions alone or both; some tendons may be slack."""
    gravity = {"effects.gravity.acceleration": [0.0, 0.0, weight]}
    model = build("three_tendon", gravity)
    simulation = Simulation(model)
    start = simulation.reset_at_rest(tension, time=2.0)
    assert start.time == 2.0
    equilibrium = static_equilibrium(simulation.model, tension)
    np.testing.assert_allclose(start.q, equilibrium.q, rtol=1e-9, atol=1e-12)
    assert not start.q_dot.any()
    simulation.step(tension, 0.1)
    later = simulation.state
    tip = simulation.tip_pose
    np.testing.assert_allclose(later.q, start.q, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(tip, equilibrium.tip_pose, atol=1e-8)


def test_arms_that_rest_nowhere_begin_nowhere(fluttering):
    """A force beyond Beck's that follows the tip of a hardly damped rod."""
    simulation = Simulation(fluttering)
    with pytest.raises(NoEquilibriumError, match="at rest nowhere .*flutter"):
        simulation.reset_at_rest()


def test_equilibria_are_stable_ones_where_that_is_asked():
    """Of a column beyond its buckling load, straight and bent; none is far from a slowly loaded
    one."""
    buckled = column(1.2)
    straight = np.zeros(1)
    bent = static_equilibrium(buckled, SLACK, settle=True).q
    assert abs(bent[0]) > 1.0
    near_bent = rest_near(buckled, 1.02 * bent, SLACK, 1.0, True)
    np.testing.assert_allclose(near_bent, bent, rtol=1e-7)
    unstable = rest_near(buckled, straight, SLACK, 1.0, False)
    np.testing.assert_allclose(unstable, straight, atol=1e-12)
    assert rest_near(buckled, straight, SLACK, 1.0, True) is None
    # a part of the load has the equilibrium that is near
    part = rest_near(buckled, straight, SLACK, 0.95, True)
    np.testing.assert_allclose(part, straight, atol=1e-12)


def test_a_diverged_simulation_is_at_its_last_good_state(build):
    """With its tip there, and the command that it could not follow; also from another process."""
    model = build("three_tendon", {"quadrature.intervals": 2})
    simulation = Simulation(model)
    simulation.step(PULLED, 0.1)
    begun = simulation.state
    absurd = np.array([1e6, 0.0, 0.0])
    table = [PULLED, absurd]
    with pytest.raises(SimulationDiverged) as raised:
        ste.simulate(model, table, 0.2, 0.1, begun)
    error = raised.value
    assert error.state.time >= 0.2
    np.testing.assert_array_equal(error.command, absurd)
    with pytest.raises(SimulationDiverged) as raised:
        simulation.step(absurd, 0.1)
    error = raised.value
    last = error.state
    tip = model.tip_pose(last.q)
    np.testing.assert_array_equal(simulation.state.q, last.q)
    np.testing.assert_allclose(simulation.tip_pose, tip, atol=1e-9)
    text = pickle.dumps(error)
    copy = pickle.loads(text)
    assert str(copy) == str(error)
    assert "under tensions [1e+06, 0, 0] N: " in str(copy)
    np.testing.assert_array_equal(copy.state.q, last.q)
    displaced = SimulationDiverged(last, "stuck", PULLED, "m")
    assert "under commands [2, 0, 1] m: stuck" in str(displaced)
