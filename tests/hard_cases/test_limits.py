"""The strain limit.

A tendon that pulls with the section's shear stiffness pulls its own chord down to nothing: beyond
that tension no strain balances it, the matrix A of (31) is singular at the limit, and Newton's
method next to it has no root to find. Pushing has its own limit.
"""

import re

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.statics import static_equilibrium

STEPS = [pytest.param(0.0005, marks=pytest.mark.slow), 0.01]
"""Steps [s]: the short ones cost twenty times as much."""
NAMES_THE_PLACE = re.compile(r"tendon \d+ at arc length [\d.]+ m, with [-\d.e+]+ N, (pulls|pushes)")


@pytest.fixture(scope="module")
def pull_limit(build, one_pulled):
    """Greatest tension [N] of tendon 0 of the paper's arm that has an equilibrium, to 1e-3."""
    model = build("paper")
    below = 200.0
    above = 400.0
    while above - below > 1e-3:
        middle = 0.5 * (below + above)
        if static_equilibrium(model, one_pulled(model, 0, middle)).converged:
            below = middle
        else:
            above = middle
    return below


@pytest.mark.parametrize("part", [0.95, 0.999])
def test_statics_next_to_the_limit(build, measured, one_pulled, pull_limit, part):
    """Tendon 0 of the paper's arm is pulled to 95 and 99.9 % of its limit, which is found by
    bisection. Expected: the equilibrium is found, q equals the tensions, and the residual is
    round-off."""
    model = build("paper")
    u = one_pulled(model, 0, part * pull_limit)
    rest = static_equilibrium(model, u)
    measured("limit [N]", pull_limit)
    measured("residual", rest.residual)
    assert 250 < pull_limit < 260
    assert rest.converged
    assert rest.residual < 1e-12
    difference = rest.q - u
    assert np.abs(difference).max() < 1e-9


@pytest.mark.parametrize("tension", [1.001, 1.2, 100.0])
def test_statics_beyond_the_limit(build, measured, one_pulled, pull_limit, tension):
    """There is no equilibrium for tendon 0 beyond the limit; Newton's method would wander.
    Expected: `converged` is false, the reason names tendon, arc length and share of the load, and q
    is the last equilibrium on the way."""
    model = build("paper")
    rest = static_equilibrium(model, one_pulled(model, 0, tension * pull_limit))
    assert not rest.converged
    assert "tendon 0 at arc length" in rest.reason
    assert "% of the load" in rest.reason
    assert np.isfinite(rest.tip_pose).all()
    assert rest.iterations < 1000
    measured("reached [N]", rest.q[0])
    assert 0.95 * pull_limit < rest.q[0] <= pull_limit + 1e-2


@pytest.mark.parametrize("tension", [-300.0, -400.0, -1e4])
def test_statics_of_a_push(build, measured, one_pulled, tension):
    """Pushing tendons soften the section until it shears away, for tendon 0 of the paper's arm at
    about -320 N. Expected: -300 N converges; -400 N and -10 kN do not, with a reason that names
    tendon and arc length."""
    model = build("paper")
    rest = static_equilibrium(model, one_pulled(model, 0, tension))
    measured("reached [N]", rest.q[0])
    if tension == -300.0:
        assert rest.converged
        assert rest.residual < 1e-12
    else:
        assert not rest.converged
        assert "tendon 0" in rest.reason
        assert "pushes" in rest.reason
        assert -325 < rest.q[0] < -310
        assert np.isfinite(rest.tip_pose).all()


def test_coordinates_beyond_the_limit(build, measured, pull_limit):
    """Coordinates from outside (a saved state, an optimiser) may lie where no strain exists.
    Expected: every method of the model raises StrainLimitError that names tendon and arc length."""
    model = build("paper")
    q = np.zeros(10)
    rest = np.zeros(10)
    q[0] = 1.05 * pull_limit
    methods = {
        "terms": lambda: model.terms(q, rest),
        "tip_pose": lambda: model.tip_pose(q),
        "backbone": lambda: model.backbone(q),
        "strain": lambda: model.strain(q),
        "tendon_lengths": lambda: model.tendon_lengths(q),
        "energy": lambda: model.energy(q, rest),
        "reset": lambda: ste.Simulation(model).reset(q),
    }
    for name, method in methods.items():
        with pytest.raises(ste.StrainLimitError) as caught:
            method()
        assert NAMES_THE_PLACE.search(str(caught.value)), (name, str(caught.value))
        reached = re.search("beyond ([0-9.]+) %", str(caught.value))
        assert abs(float(reached[1]) - 100 / 1.05) < 1.0
    measured("methods that say so", len(methods))


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("scene", ["paper", "paper moments 0-2"])
def test_pull_at_95_percent_of_the_limit(
    build, measured, one_pulled, tip_distance, pull_limit, scene, step
):
    """An abrupt pull at 95 % of the limit: what overshoots would leave the strains that exist.
    Expected: the motion settles in the equilibrium; q_a never exceeds the limit."""
    model = build(scene, {"integrator.step": step})
    u = one_pulled(model, 0, 0.95 * pull_limit)
    motion = ste.simulate(model, u, 4.0, 0.01)
    largest = np.abs(motion.q[:, :10]).max()
    measured("largest q_a / tension", largest / u[0])
    assert largest < pull_limit
    equilibrium = static_equilibrium(model, u)
    assert tip_distance(motion.tip_pose[-1], equilibrium.tip_pose) < 1e-4


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("scene", ["paper", "paper moments 0-2"])
def test_slow_ramp_through_the_limit(build, measured, one_pulled, pull_limit, scene, step):
    """The tension of tendon 0 grows by 150 N/s through its limit. Expected: SimulationDiverged just
    when q_a passes the limit; the message names tendon and arc length; the last good state is
    finite."""
    model = build(scene, {"integrator.step": step})
    with pytest.raises(ste.SimulationDiverged) as caught:
        ste.simulate(model, lambda t: one_pulled(model, 0, 150.0 * t), 2.0, 0.01)
    state = caught.value.state
    measured("q_a at the end [N]", state.q[0])
    assert NAMES_THE_PLACE.search(str(caught.value))
    assert "tendon 0" in str(caught.value)
    assert abs(state.q[0] - pull_limit) < 0.01 * pull_limit
    assert 1.7 < state.time < 1.8
    assert np.isfinite(state.q).all()
    assert np.isfinite(state.q_dot).all()
    assert np.isfinite(state.strain).all()


@pytest.mark.parametrize("step", [0.0005, 0.01])
@pytest.mark.parametrize("tension", [260.0, 400.0, 1e5])
def test_abrupt_tension_beyond_the_limit(build, measured, one_pulled, tension, step):
    """An abrupt tension beyond the limit, up to 100 kN: the step that first fails is far from a
    state to report. Expected: SimulationDiverged that names tendon and tension, with a last good
    state that is finite."""
    model = build("paper", {"integrator.step": step})
    with pytest.raises(ste.SimulationDiverged) as caught:
        ste.simulate(model, one_pulled(model, 0, tension), 2.0, 0.01)
    error = caught.value
    measured("time of failure [s]", error.state.time)
    assert error.command[0] == tension
    assert error.state.time < 0.5
    assert np.isfinite(error.state.q).all()
    assert np.isfinite(error.state.q_dot).all()
    if abs(tension) < 1000:
        assert NAMES_THE_PLACE.search(str(error))
        assert "tendon 0" in str(error)


@pytest.mark.parametrize("step", [0.0005, 0.01])
def test_abrupt_push_beyond_the_limit(build, measured, one_pulled, step):
    """A push of 400 N at once: the straight section gives way sideways, and twists into another
    equilibrium or into none. Expected: a motion that stays finite and ends with strains that
    balance, or SimulationDiverged that names tendon and arc length."""
    model = build("paper", {"integrator.step": step})
    try:
        end = ste.simulate(model, one_pulled(model, 0, -400.0), 2.0, 0.01).final
    except ste.SimulationDiverged as error:
        end = error.state
        assert NAMES_THE_PLACE.search(str(error))
        assert "tendon 0" in str(error)
    measured("end of the motion [s]", end.time)
    assert np.isfinite(end.q).all()
    assert np.isfinite(end.q_dot).all()
    assert np.isfinite(ste.Simulation(model, end).tip_pose).all()


@pytest.mark.parametrize(
    ("tension", "step"), [(260.0, 0.01), (400.0, 0.0005), (400.0, 0.01), (1e5, 0.01)]
)
def test_last_good_state_is_one(build, measured, one_pulled, tension, step):
    """A step may end where no strain exists, which only the next evaluation finds out, when no
    smaller step helps any more. Expected: such a step is rejected, so that the state in
    SimulationDiverged has a tip pose and, after a mild excess, continues under a lower tension."""
    model = build("paper", {"integrator.step": step})
    with pytest.raises(ste.SimulationDiverged) as caught:
        ste.simulate(model, one_pulled(model, 0, tension), 2.0, 0.01)
    state = caught.value.state
    measured("time of failure [s]", state.time)
    assert np.isfinite(ste.Simulation(model, state).tip_pose).all()
    if tension == 260.0:  # beyond, the arm runs across the limit by its own momentum
        assert np.isfinite(ste.simulate(model, np.zeros(10), 0.1, 0.01, initial=state).q).all()


@pytest.mark.parametrize("scene", ["paper", "three_tendon", "catheter"])
def test_tolerances_that_steps_do_not_meet(build, scene):
    """A tolerance for which the step may not be halved often enough. Expected: SimulationDiverged
    that names the tolerance and the smallest step; with more columns and halvings it is met."""
    changes = {"integrator.tolerance": 1e-10, "integrator.columns": 3, "integrator.max_halvings": 4}
    model = build(scene, changes)
    pull = np.array([0.3 * tendon.tension_limits[1] for tendon in model.scene.tendons]) * (
        np.arange(model.tendon_count) == 0
    )
    with pytest.raises(
        ste.SimulationDiverged,
        match=r"above integrator\.tolerance, 1e-10 m, even with steps of .* s, 4 halvings",
    ):
        ste.Simulation(model).step(pull, 0.02)
    patient = build(scene, {**changes, "integrator.max_halvings": 20, "integrator.columns": 6})
    report = ste.Simulation(patient).step(pull, 0.02)
    assert 0.0 < report.error <= 1e-10 * report.steps


@pytest.mark.parametrize("value", [1e12, 1e300, -1e300])
def test_absurd_but_finite_tensions(build, value):
    """Finite, but its square overflows. Expected: a clear error or `converged` false, with finite
    numbers in what comes back, and no warning of overflow."""
    model = build("paper")
    u = np.where(np.arange(10) == 0, value, 0.0)
    rest = static_equilibrium(model, u)
    assert not rest.converged
    assert rest.reason
    assert np.isfinite(rest.q).all()
    assert np.isfinite(rest.tip_pose).all()
    with pytest.raises(ste.StrainLimitError):
        model.tip_pose(u)
    simulation = ste.Simulation(model)
    with pytest.raises(ste.SimulationDiverged) as caught:
        simulation.step(u, 0.01)
    assert np.isfinite(caught.value.state.q).all()
