"""Sensitivities of motions: one period by `linearize`, many by `motion_sensitivities`, against differences of motions by other numbers."""

import numpy as np
import pytest

from soft_tendon_env.model.model import build_model
from soft_tendon_env.model.motion_sensitivity import motion_sensitivities
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.parameters import scene_parameters
from soft_tendon_env.tools.configuration import ConfigurationError

FOURTH_ORDER = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
PERIOD, TOLERANCE, SHARE = 0.02, 1e-6, 1e-3
FIXED = {"integrator": {"step": 0.01, "columns": 3}}  # steps that are the same whatever the numbers: any motion is as if they were held
WEIGHT = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
MATERIAL = ["segments.*.young_modulus", "segments.0.damping", "segments.0.density"]
FULL = {"type": "explicit", "modes": [{"strains": ["torsion", "bend_y", "bend_z", "stretch"], "order": 1, "span": "rod"}]}
BRANCHES = [{"modulus": 0.3, "relaxation_time": 0.1}]
CASES = [
    ({}, [*MATERIAL, "segments.*.radius", "tendons.0.routing.offset.1"]),
    (WEIGHT, [*MATERIAL, "effects.gravity.acceleration.2", "effects.gravity.acceleration.0", "effects.tip_load.mass"]),
    ({**WEIGHT, "strain.include_loads": True}, [*MATERIAL, "effects.tip_load.mass"]),
    ({**WEIGHT, "strain": FULL}, [*MATERIAL, "segments.0.poisson_ratio"]),
    ({"effects.fluid": {"density": 500.0, "current": [0.1, 0.3, 0.2]}}, ["effects.fluid.density", "effects.fluid.normal_drag"]),
    ({"effects.viscoelastic_memory.branches": BRANCHES}, [f"effects.viscoelastic_memory.branches.0.{name}" for name in BRANCHES[0]]),
    ({"effects.actuators.time_constant": 0.05}, ["effects.actuators.time_constant", "segments.0.damping"]),
    ({"effects.tendon_elasticity": {"stiffness": 2e4, "displacement_limits": [0.0, 0.02]}}, ["effects.tendon_elasticity.stiffness"]),
    ({"effects.tip_load": {}}, ["effects.tip_load.force.1"]),
]
"""Changes of a scene and parameters."""


def made(changes):
    return build_model(load_scene("three_tendon").replace({"segments.0.poisson_ratio": 0.45, **FIXED, **changes}))


def commands(model, periods):
    """A table of random commands, all of which pull."""
    least, greatest = model.scene.effects.command_limits(np.array([own.tension_limits for own in model.scene.tendons])).T
    return least + np.random.default_rng(0).uniform(0.1, 0.4, (periods, least.size)) * (greatest - least)


def motion(model, table, initial=None):
    """States (samples, s), tip poses and tendon lengths along a motion."""
    simulation = Simulation(model)
    if initial is None:
        states = [simulation.reset_at_rest()]
    else:
        states = [simulation.reset(initial.q, initial.q_dot, time=initial.time, effects=initial.effects)]
    for command in table:
        simulation.step(command, PERIOD)
        states.append(simulation.state)
    lengths = np.array([model.tendon_lengths(state.q) for state in states])
    return np.array([np.concatenate([state.q, state.q_dot, state.effects]) for state in states]), lengths


def slopes(model, name, table, initial=None):
    """Derivatives of these by a parameter, by differences of motions of arms with other numbers."""
    parameter = scene_parameters(model.scene, [name])[0]
    step, total = SHARE * (parameter.size or 1.0), [0.0, 0.0]
    for k, weight in FOURTH_ORDER.items():
        values = motion(model.with_numbers(parameter.changes(parameter.value + k * step)), table, initial)
        total = [own + weight / step * value for own, value in zip(total, values, strict=True)]
    return total


def assert_close(actual, expected, unit):
    """Alike to a share of the largest entry, in units of the numbers."""
    np.testing.assert_allclose(actual / unit, expected / unit, atol=TOLERANCE * np.abs(expected / unit).max())


@pytest.mark.cases("changes, names", CASES)
def test_as_motions_from_rest_by_other_numbers(changes, names):
    model = made(changes)
    table = commands(model, 8)
    found = motion_sensitivities(model, table, PERIOD, names)
    states, lengths = motion(model, table)
    scale, size = model.coordinate_scale(), 2 * model.coordinate_count
    unit = np.concatenate([scale, 10.0 * scale, np.maximum(np.abs(states[:, size:]).max(axis=0), 1e-3)])
    np.testing.assert_allclose(found.state / unit, states / unit, atol=1e-8)
    np.testing.assert_allclose(found.reading.tendon_length, lengths, rtol=1e-8)
    for i, name in enumerate(names):
        by_state, by_length = slopes(model, name, table)
        assert_close(found.parameters.state[..., i], by_state, unit)
        assert_close(found.parameters.tendon_length[..., i], by_length, 1.0)


@pytest.mark.cases("changes, names", CASES)
def test_one_period_is_linearised_by_parameters_too(changes, names):
    model = made(changes)
    table, simulation = commands(model, 4), Simulation(model)
    for command in table[:3]:
        simulation.step(command, PERIOD)
    initial = simulation.state
    plain, found = simulation.linearize(table[3], PERIOD, sensors=[0.2]), simulation.linearize(table[3], PERIOD, names, sensors=[0.2])
    along = motion_sensitivities(model, table[3:], PERIOD, names, initial=initial, sensors=[0.2])
    assert plain.parameters is None
    for field in ("state", "command"):
        np.testing.assert_array_equal(getattr(found, field), getattr(plain, field))
    np.testing.assert_array_equal(found.tip[:, : plain.tip.shape[1]], plain.tip)
    for field in ("tip_twist", "tendon_length", "strain"):
        last = getattr(along.parameters, field)[-1]
        np.testing.assert_allclose(getattr(found, field)[..., plain.tip.shape[1] :], last, rtol=1e-9, atol=1e-9 * np.abs(last).max())
    scale = model.coordinate_scale()
    unit = np.concatenate([scale, 10.0 * scale, np.maximum(np.abs(initial.effects), 1e-3)])
    for i, name in enumerate(names):
        assert_close(found.parameters[:, i], slopes(model, name, table[3:], initial)[0][-1], unit)


def test_periods_chain_to_the_whole_motion():
    """D' = A D + P, period after period, with steps and columns that follow the error."""
    model = made({**WEIGHT, "integrator": {"tolerance": 1e-5}})
    table, simulation = commands(model, 12), Simulation(model)
    names = [*MATERIAL, "effects.tip_load.mass"]
    size = 2 * model.coordinate_count
    slope = np.random.default_rng(1).normal(size=(size, 4)) / [[1e6, 1e4, 1e3, 1e-3]] * np.tile(model.coordinate_scale(), 2)[:, None]
    found = motion_sensitivities(model, table, PERIOD, names, initial=simulation.state, initial_derivative=slope)
    for command, sample in zip(table, found.parameters.state[1:], strict=True):
        period = simulation.linearize(command, PERIOD, names)
        slope = period.state @ slope + period.parameters
        tip = period.tip
        simulation.step(command, PERIOD)
        assert_close(slope, sample, np.abs(sample).max(axis=0) * 0.1)
    assert tip.shape == (6, size + 3 + 4)


@pytest.mark.cases(
    "names, message",
    [
        (["segments.0.lenght"], "segments.0.lenght is no number of the scene"),
        (["integrator.step"], "integrator.step is no number of the scene"),
    ],
)
def test_what_is_no_parameter_is_refused(names, message):
    model = made({})
    with pytest.raises(ConfigurationError, match=message):
        Simulation(model).linearize(np.zeros(3), PERIOD, names)
    with pytest.raises(ConfigurationError, match=message):
        motion_sensitivities(model, np.zeros((1, 3)), PERIOD, names)


def test_an_initial_derivative_belongs_to_a_state_and_has_a_column_per_parameter():
    model, wrong = made({}), {"initial_derivative": np.zeros((3, 1))}
    with pytest.raises(ValueError, match=r"initial_derivative should have shape \(\d+, 1\), not \(3, 1\)"):
        motion_sensitivities(model, np.zeros((1, 3)), PERIOD, MATERIAL[:1], initial=Simulation(model).state, **wrong)
    with pytest.raises(ValueError, match="initial_derivative should be left out without an initial state"):
        motion_sensitivities(model, np.zeros((1, 3)), PERIOD, MATERIAL[:1], **wrong)
