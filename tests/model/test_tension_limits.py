"""Commands beyond the limits of tensions: computed as asked, with the same word everywhere."""

import warnings

import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.tension_limits import TensionLimitWarning, erring_actuators

LATE = {"effects.tendon_elasticity": {"stiffness": 2000.0, "displacement_limits": [0.0, 0.02]}}
WAYS = {
    "simulate": lambda model, u: ste.simulate(model, u, 0.04, 0.02, ste.Simulation(model).state),
    "step": lambda model, u: ste.Simulation(model).step(u, 0.02),
    "rollout": lambda model, u: ste.Simulation(model).rollout([u], 0.02),
    "linearize": lambda model, u: ste.Simulation(model).linearize(u, 0.02),
    "commanded_equilibrium": ste.commanded_equilibrium,
}


def said(way, model, command):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        way(model, command)
    return [str(own.message) for own in caught if own.category is TensionLimitWarning]


@pytest.mark.parametrize("name", WAYS)
def test_what_goes_beyond_is_said_once(build, name):
    way, model = WAYS[name], build("three_tendon")
    assert said(way, model, [5.0 * (1.0 + 1e-12), 0.0, 2.0]) == []
    for command in ([0.0, 5.2, 0.0], [0.0, -0.1, 6.0]):
        (text,) = said(way, model, command)
        assert text.startswith("tendons[1] goes beyond its tension_limits, 0 to 5 N: computed as asked")
    with erring_actuators():
        assert said(way, model, [0.0, 5.2, 0.0]) == []
    assert len(said(way, model, [0.0, 5.2, 0.0])) == 1


@pytest.mark.parametrize("name", WAYS)
def test_commands_that_are_displacements_have_limits_of_their_own(build, name):
    model = build("three_tendon", LATE)
    assert said(WAYS[name], model, [0.001, 0.0, 0.0]) == []
    (text,) = said(WAYS[name], model, [0.0, 0.0, 0.025])
    assert text.startswith("tendons[2] goes beyond its tension_limits, 0 to 0.02 m")
