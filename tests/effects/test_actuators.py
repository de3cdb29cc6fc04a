"""Actuators: step response of lag and rate limit, exact delays, states at rest, and what the path of commands costs nothing."""

import numpy as np
import pytest

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.statics import static_equilibrium

FINE = {"integrator.step": 0.005, "integrator.columns": 4, "quadrature.intervals": 4}
ROUND_OFF = {"rtol": 1e-12, "atol": 1e-12}


def limited_lag(u, c, time_constant, rate, times):
    """The solution of u_dot = clip((c - u) / tau, -r, r), in closed form."""
    sign, away = np.sign(c - u), np.abs(c - u)
    corner = max(away - rate * time_constant, 0.0) / rate
    late = c - sign * min(away, rate * time_constant) * np.exp(-(times - corner) / time_constant)
    return np.where(times < corner, u + sign * rate * times, late)


def moved(model, command, times):
    """Tensions of the first tendon at times [s], of an arm that gets this command at 0."""
    simulation, found, now = Simulation(model), [], 0.0
    for time in times:
        simulation.step(command, time - now)
        found.append(simulation.state.effects[0])
        now = time
    return np.array(found)


@pytest.mark.parametrize(("command", "rate", "step"), [(3.0, None, 0.005), (-2.0, None, 0.005), (3.0, 20.0, 0.001), (3.0, 20.0, 0.02)])
def test_step_response_of_a_lag(uniform, command, rate, step):
    """With a limited rate too, also where the limit ends within a step."""
    model = uniform(changes={**FINE, "integrator.step": step, "effects.actuators": {"time_constant": 0.05, "rate_limit": rate}})
    times = np.array([0.004, 0.013, 0.06, 0.09, 0.1, 0.11, 0.3])
    expected = limited_lag(0.0, command, 0.05, rate, times) if rate else command * -np.expm1(-times / 0.05)
    np.testing.assert_allclose(moved(model, [command, 0.0, 0.0], times), expected, **ROUND_OFF)
    assert limited_lag(0.0, 3.0, 0.05, 20.0, np.array([0.1])) == 2.0, "where the limit ends"


@pytest.mark.parametrize("delay", [0.002, 0.013, 0.02, 0.0547])
def test_a_delay_is_exact_at_any_time(uniform, delay):
    """The motion is that of an arm that gets every command so much later, to the error of fine steps and not of where they end."""
    rng = np.random.default_rng(0)
    table = rng.uniform(0.0, 3.0, (10, 3))
    late, prompt = (Simulation(uniform(changes={**FINE, **more})) for more in ({"effects.actuators.delay": delay}, {}))
    for u in table:
        late.step(u, 0.02)
    before, end = delay, 0.2
    prompt.step(np.zeros(3), min(before, end))
    for u in table:
        prompt.step(u, max(min(0.02, end - before), 0.0))
        before += 0.02
    assert abs(prompt.state.time - end) < 1e-12
    np.testing.assert_allclose(late.state.q, prompt.state.q, rtol=2e-6, atol=1e-7)
    np.testing.assert_allclose(late.tip_pose, prompt.tip_pose, atol=1e-8)


def test_commands_that_do_not_change_cut_no_step(uniform):
    model = uniform(changes={**FINE, "integrator.step": 0.02, "effects.actuators.delay": 0.013})
    motion = simulate(model, np.ones(3), 1.0, 0.02)
    assert motion.steps == 51, "50, and one where the first command arrives"


def test_more_commands_than_there_is_room_for_are_an_error(uniform):
    simulation = Simulation(uniform(changes={**FINE, "integrator.step": 0.02, "effects.actuators.delay": 0.05}))
    simulation.reset(time=-3.0)
    with pytest.raises(SimulationDiverged, match=r"at -2\.98 s .*commands change more often than the delay of their path keeps"):
        for i in range(10):
            simulation.step(np.full(3, 0.1 * i), 0.004)
    assert np.isfinite(simulation.state.q).all()


def test_an_arm_that_is_held_at_rest_stays(build):
    """`reset` and rows start with tensions that have arrived."""
    u = np.array([2.0, 0.0, 1.0])
    actuators = {"effects.actuators": {"time_constant": 0.1, "delay": 0.03}}
    model = build("three_tendon", {**actuators, "effects.gravity.acceleration": [9.81, 0.0, 0.0]})
    rest = static_equilibrium(model, u)
    simulation = Simulation(model)
    start = simulation.reset(rest.q, tension=u)
    simulation.step(u, 0.5)
    np.testing.assert_allclose(simulation.state.q, rest.q, rtol=1e-7, atol=1e-7)
    arms = Arms(model, 2, 0.02, np.empty(0), np.empty(0), 1)
    arms.place(np.arange(2), np.tile(rest.q, (2, 1)), u)
    np.testing.assert_array_equal(arms.rows.state[0], start.effects)
    arms.step(np.tile(u, (2, arms.substeps, 1)), np.arange(2))
    np.testing.assert_array_equal(arms.reading.tension, np.tile(u, (2, 1)))
    simulation.reset(rest.q)
    simulation.step(u, 0.02)
    assert np.abs(simulation.state.q - rest.q).max() > 1e-2, "which they are not by default"
