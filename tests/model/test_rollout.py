"""Rollouts of plans: the motion is the simulation's, and the Jacobians are its derivatives, as far
as implicit steps give them."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.model import simulation as simulation_module
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged
from soft_tendon_env.model.step_control import linear_rate

PERIOD = 0.02
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
EXPLICIT = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["bend_y", "bend_z"], "order": 1, "span": "rod"}],
    }
}
ARMS = {
    "statics": ("three_tendon", {}),
    "under gravity": ("three_tendon", GRAVITY),
    "loads inside": ("three_tendon", {**GRAVITY, "strain.include_loads": True}),
    "explicit": ("three_tendon", EXPLICIT),
    "damped by a fluid": ("three_tendon", {"effects.fluid.density": 1000.0}),
}


@pytest.fixture(params=ARMS)
def moving(build, request):
    """A simulation in motion."""
    name, changes = ARMS[request.param]
    model = build(name, changes)
    simulation = Simulation(model)
    simulation.step([1.0, 0.2, 0.0], 0.1)
    return simulation


def after(simulation, q, q_dot, tension):
    """Coordinates and rates after a period."""
    simulation.reset(q, q_dot)
    simulation.step(tension, PERIOD)
    return np.concatenate([simulation.state.q, simulation.state.q_dot])


def differences(model, q, q_dot, tension):
    """Jacobians (2 n, 2 n), (2 n, n_a) of `after` by central differences."""
    simulation = Simulation(model)
    n = q.size
    x = np.concatenate([q, q_dot, tension])
    of_tensions = np.ones(tension.size)
    scale = np.concatenate([model.coordinate_scale()] * 2 + [of_tensions])
    steps = 1e-4 * np.diag(scale)
    borders = [n, 2 * n]
    columns = []
    for step in steps:
        ahead = after(simulation, *np.split(x + step, borders))
        behind = after(simulation, *np.split(x - step, borders))
        columns.append(ahead - behind)
    changes = np.stack(columns, axis=1)
    slopes = changes / (2.0 * np.diag(steps))
    return np.split(slopes, [2 * n], axis=1)


def off(model, found, wanted, inputs=None):
    """Relative error of a Jacobian of coordinates and rates in `coordinate_scale`s, by these or by
    inputs in units of their own."""
    scale = np.tile(model.coordinate_scale(), 2)
    unit = scale
    if inputs is not None:
        unit = inputs
    # both in units of outputs and inputs
    ratio = unit / scale[:, None]
    difference = (found - wanted) * ratio
    return np.linalg.norm(difference) / np.linalg.norm(wanted * ratio)


def test_the_motion_is_the_simulation_s_which_stays_where_it_is(moving):
    before = moving.state
    rng = np.random.default_rng(0)
    commands = rng.uniform(0.0, 1.0, (3, 2, 3))
    parts = np.array([0.005, 0.015])
    found = moving.rollout(commands, parts)
    np.testing.assert_array_equal(moving.state.q, before.q)
    for k in range(4):
        np.testing.assert_allclose(found.q[k], moving.state.q, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.q_dot[k], moving.state.q_dot, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(found.tip_pose[k], moving.tip_pose, atol=1e-8)
        np.testing.assert_allclose(
            found.tip_jacobian[k],
            moving.model.terms(found.q[k], found.q_dot[k]).tip_jacobian,
            atol=1e-6,
        )
        for command, seconds in zip(commands[min(k, 2)], parts, strict=True):
            moving.step(command, seconds)


def test_the_jacobians_are_near_those_of_the_simulation(moving):
    state = moving.state
    tension = np.array([0.5, 0.3, 0.8])
    found = moving.rollout(tension[None], PERIOD, steps=2)
    by_state, by_tension = differences(moving.model, state.q, state.q_dot, tension)
    assert off(moving.model, found.by_state[0], by_state) < 0.1
    assert off(moving.model, found.by_tension[0], by_tension, np.ones(3)) < 0.03


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"commands": [[0.0] * 2]}, r"commands should have shape \(any, 3\)"),
        ({"duration": 0.0}, "duration should be a positive number of seconds"),
        (
            {"duration": [0.03, -0.01], "commands": np.zeros((2, 2, 3))},
            "duration should be a number of seconds, at least 0",
        ),
        ({"forces": np.zeros((2, 1))}, r"forces should have shape \(3, any\)"),
    ],
)
def test_bad_arguments_are_refused_by_name(build, changes, message):
    model = build("three_tendon")
    simulation = Simulation(model)
    with pytest.raises((TypeError, ValueError), match=message):
        simulation.rollout(**{"commands": np.zeros((2, 3)), "duration": PERIOD, **changes})


def test_a_plan_that_no_motion_follows_is_an_error_with_the_last_good_state(build):
    model = build("three_tendon")
    simulation = Simulation(model)
    with pytest.raises(SimulationDiverged) as raised:
        simulation.rollout([[0.0] * 3, [1e6] * 3], PERIOD)
    assert raised.value.state.time >= PERIOD
    assert simulation.state.time == 0.0


def test_internal_states_of_effects_go_on_as_the_simulation_s(build):
    """A memory of strains, read where every period begins and the last one ends."""
    branches = [{"modulus": 0.4, "relaxation_time": 0.05}]
    model = build("three_tendon", {"effects.viscoelastic_memory.branches": branches})
    simulation = Simulation(model)
    simulation.step([1.0, 0.2, 0.0], 0.1)
    commands = np.array([[0.5, 0.3, 0.8], [1.0, 0.0, 0.2], [0.0, 0.4, 0.4]])
    found = simulation.rollout(commands, PERIOD)
    assert found.effects.shape[0] == 4
    assert np.ptp(found.effects, axis=0).max() > 0.0
    for k in range(4):
        size = np.abs(found.effects[k]).max()
        expected = simulation.state.effects
        np.testing.assert_allclose(found.effects[k], expected, rtol=1e-5, atol=1e-6 * size)
        simulation.step(commands[min(k, 2)], PERIOD)


def test_forces_of_tendons_are_tensions(build):
    """The derivatives by forces along the columns of actuation are those by tensions, of whatever
    forces were played before; their default steps resolve the slowest vibration."""
    model = build("three_tendon", GRAVITY)
    simulation = Simulation(model)
    simulation.step([1.0, 0.2, 0.0], 0.1)
    state = simulation.state
    B = model.terms(state.q, state.q_dot).actuation
    commands = np.array([[0.5, 0.3, 0.8]])
    first = simulation.rollout(commands, PERIOD, forces=np.eye(3))
    found = simulation.rollout(commands, PERIOD, forces=B)
    np.testing.assert_allclose(found.by_force, found.by_tension, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.by_force @ B, found.by_force, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(first.by_tension, found.by_tension)
    np.testing.assert_array_equal(first.by_state, found.by_state)
    assert found.by_force.shape == (1, 6, 3)
    assert simulation.rollout(commands, PERIOD).by_force.shape == (1, 6, 0)
    for duration in (PERIOD, 10.0 * PERIOD):
        steps = int(np.ceil(duration * linear_rate(model)))
        given = simulation.rollout(commands, duration, steps=steps)
        default = simulation.rollout(commands, duration)
        np.testing.assert_array_equal(default.by_state, given.by_state)
    assert steps > 1


def test_parts_of_a_period_are_one_under_the_same_command(build):
    """A period of two halves, as of one."""
    model = build("three_tendon")
    simulation = Simulation(model)
    simulation.step([1.0, 0.2, 0.0], 0.1)
    command = np.array([0.5, 0.3, 0.8])
    whole = simulation.rollout(command[None], PERIOD, steps=2)
    halves = simulation.rollout(np.tile(command, (1, 2, 1)), [0.5 * PERIOD] * 2, steps=2)
    np.testing.assert_allclose(halves.q[-1], whole.q[-1], rtol=1e-3, atol=1e-4)
    error = off(simulation.model, halves.by_state[0], whole.by_state[0])
    assert error < 0.05
    error = off(simulation.model, halves.by_tension[0], whole.by_tension[0], np.ones(3))
    assert error < 0.05


def test_the_command_that_no_motion_follows_is_named(build):
    model = build("three_tendon")
    simulation = Simulation(model)
    commands = [[1.0, 0.0, 0.0], [0.0, 1e6, 0.0], [0.0, 0.0, 2.0]]
    with pytest.raises(SimulationDiverged) as raised:
        simulation.rollout(commands, PERIOD)
    np.testing.assert_array_equal(raised.value.command, commands[1])


def test_a_motion_that_ends_where_nothing_is_evaluated_has_the_last_command(build, monkeypatch):
    """Which still acts there."""
    ended = (status.NOT_FINITE, 2)
    monkeypatch.setattr(simulation_module, "linearised_rollout", lambda *plan: ended)
    simulation = Simulation(build("three_tendon"))
    commands = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
    with pytest.raises(SimulationDiverged) as raised:
        simulation.rollout(commands, PERIOD)
    np.testing.assert_array_equal(raised.value.command, commands[1])
