"""Actuators, elastic tendons and tendon friction: closed forms of what lies between commands and
tensions."""

import numpy as np
import pytest
from scipy.optimize import brentq

from soft_tendon_env import (
    Scene,
    Simulation,
    SimulationDiverged,
    build_model,
    commanded_equilibrium,
    load_scene,
    simulate,
    static_equilibrium,
)
from soft_tendon_env.model.model import model_on

FINE = {"integrator.step": 0.005, "integrator.columns": 4, "quadrature.intervals": 4}
ROUND_OFF = {"rtol": 1e-12, "atol": 1e-12}
RAMP = {"effects.actuators.rate_limit": 0.02}
"""Actuators that take their time: a spring that is stretched by millimetres at once pulls as hard
as it is stiff."""
MU = 0.15


def limited_lag(u, c, time_constant, rate, times):
    """The solution of u_dot = clip((c - u) / tau, -r, r), in closed form."""
    sign = np.sign(c - u)
    away = np.abs(c - u)
    # nearer than this the rate is below its limit
    slow = rate * time_constant
    corner = max(away - slow, 0.0) / rate
    decay = np.exp(-(times - corner) / time_constant)
    change = min(away, slow)
    late = c - sign * change * decay
    early = u + sign * rate * times
    return np.where(times < corner, early, late)


def tension_response(model, command, times):
    """Tensions of the first tendon at times [s], of an arm that gets this command at 0."""
    simulation = Simulation(model)
    found = []
    now = 0.0
    for time in times:
        simulation.step(command, time - now)
        found.append(simulation.state.effects[0])
        now = time
    return np.array(found)


@pytest.mark.parametrize(
    ("command", "rate", "step"),
    [(3.0, None, 0.005), (-2.0, None, 0.005), (3.0, 20.0, 0.001), (3.0, 20.0, 0.02)],
)
def test_step_response_of_a_lag(uniform, command, rate, step):
    """With a limited rate too, also where the limit ends within a step."""
    model = uniform(
        changes={
            **FINE,
            "integrator.step": step,
            "effects.actuators": {"time_constant": 0.05, "rate_limit": rate},
        }
    )
    times = np.array([0.004, 0.013, 0.06, 0.09, 0.1, 0.11, 0.3])
    expected = (
        limited_lag(0.0, command, 0.05, rate, times) if rate else command * -np.expm1(-times / 0.05)
    )
    np.testing.assert_allclose(
        tension_response(model, [command, 0.0, 0.0], times), expected, **ROUND_OFF
    )
    assert limited_lag(0.0, 3.0, 0.05, 20.0, np.array([0.1])) == 2.0, "where the limit ends"


@pytest.mark.parametrize("delay", [0.002, 0.013, 0.02, 0.0547])
def test_a_delay_is_exact_at_any_time(uniform, delay):
    """The motion is that of an arm that gets every command so much later, to the error of fine
    steps and not of where they end."""
    rng = np.random.default_rng(0)
    table = rng.uniform(0.0, 3.0, (10, 3))
    delayed = {**FINE, "effects.actuators.delay": delay}
    late = Simulation(uniform(changes=delayed))
    prompt = Simulation(uniform(changes=FINE))
    for u in table:
        late.step(u, 0.02)
    before = delay
    end = 0.2
    prompt.step(np.zeros(3), min(before, end))
    for u in table:
        period = min(0.02, end - before)
        prompt.step(u, max(period, 0.0))
        before += 0.02
    assert abs(prompt.state.time - end) < 1e-12
    np.testing.assert_allclose(late.state.q, prompt.state.q, rtol=2e-6, atol=1e-7)
    np.testing.assert_allclose(late.tip_pose, prompt.tip_pose, atol=1e-8)


def test_more_commands_than_there_is_room_for_are_an_error(uniform):
    simulation = Simulation(
        uniform(changes={**FINE, "integrator.step": 0.02, "effects.actuators.delay": 0.05})
    )
    simulation.reset(time=-3.0)
    with pytest.raises(
        SimulationDiverged,
        match=r"at -2\.98 s .*commands change more often than the delay of their path keeps",
    ):
        for i in range(10):
            simulation.step(np.full(3, 0.1 * i), 0.004)
    assert np.isfinite(simulation.state.q).all()


def test_an_arm_that_is_held_at_rest_stays(build):
    """`reset` and rows start with tensions that have arrived."""
    u = np.array([2.0, 0.0, 1.0])
    actuators = {"effects.actuators": {"time_constant": 0.1, "delay": 0.03}}
    changes = {**actuators, "effects.gravity.acceleration": [9.81, 0.0, 0.0]}
    model = build("three_tendon", changes)
    rest = static_equilibrium(model, u)
    simulation = Simulation(model)
    simulation.reset(rest.q, tension=u)
    simulation.step(u, 0.5)
    np.testing.assert_allclose(simulation.state.q, rest.q, rtol=1e-7, atol=1e-7)
    simulation.reset(rest.q)
    simulation.step(u, 0.02)
    difference = simulation.state.q - rest.q
    assert np.abs(difference).max() > 1e-2, "which they are not by default"


def springs(stiffness=5e3, **more):
    return {
        "effects.tendon_elasticity": {"stiffness": stiffness, "displacement_limits": [0.0, 0.05]},
        **more,
    }


@pytest.mark.parametrize("stiffness", [200.0, 5e3, 3e5])
@pytest.mark.parametrize("scene", ["three_tendon", "four_tendon", "helical"])
def test_displacements_and_tensions_meet_at_rest(build, scene, stiffness):
    """The displacements that belong to an equilibrium under tensions lead there, in statics and in
    motion."""
    model = build(scene, springs(stiffness, **RAMP))
    u = np.linspace(2.0, 1.0, model.tendon_count)
    rest = static_equilibrium(model, u)
    command = model.command(u, rest.q)
    found, tension = commanded_equilibrium(model, command)
    assert found.converged
    np.testing.assert_allclose(tension, u, rtol=1e-5)
    np.testing.assert_allclose(found.tip_pose, rest.tip_pose, atol=1e-7)
    motion = simulate(model, command, 40.0, 0.02)
    np.testing.assert_allclose(motion.tip_pose[-1], rest.tip_pose, atol=1e-6)


def test_a_slack_tendon_does_not_pull(build):
    model = build("three_tendon", springs())
    found, tension = commanded_equilibrium(model, [0.004, -0.001, -0.02])
    assert tension[0] > 0.5
    assert tension[2] == 0.0
    np.testing.assert_allclose(
        found.tip_pose, static_equilibrium(model, tension).tip_pose, atol=1e-9
    )
    motion = simulate(model, [0.004, -0.001, -0.02], 40.0, 0.02)
    np.testing.assert_allclose(motion.tip_pose[-1], found.tip_pose, atol=1e-6)
    straight = simulate(model, [-0.01, -0.01, -0.01], 0.2, 0.02)
    np.testing.assert_array_equal(straight.q, 0.0)


@pytest.mark.parametrize(
    ("fidelity", "damping"),
    [
        ("fast", 1e8),
        pytest.param("fast", 1e7, marks=pytest.mark.slow),
        *(
            pytest.param(fidelity, damping, marks=pytest.mark.slow)
            for fidelity in ("standard", "fine")
            for damping in (1e7, 1e8)
        ),
    ],
)
@pytest.mark.filterwarnings(
    "ignore:'wire' has no coordinates",  # for "fine": 0.066 % in place of 0.05
    "ignore:.*only in a trial",  # of which jumps of stiff cables are certain in part
)
def test_a_wire_that_cables_drive_by_displacement_never_diverges(fidelity, damping):
    """Steel cables 6 mm off a Nitinol wire of 1 mm: jumps and ramps of 8 mm, and rest where the
    statics has it."""
    offsets = [
        [6e-3 * np.cos(angle), 6e-3 * np.sin(angle)] for angle in np.deg2rad([0.0, 120.0, 240.0])
    ]
    wire = {
        "length": 0.25,
        "young_modulus": 5.2e10,
        "poisson_ratio": 0.33,
        "density": 6450.0,
        "radius": 5e-4,
        "damping": damping,
    }
    tendons = [
        {"routing": {"type": "straight", "offset": offset}, "tension_limits": [0.0, 80.0]}
        for offset in offsets
    ]
    end = np.array([0.008, -0.02, -0.02])
    shares = np.linspace(0.0, 1.0, 50)
    for stiffness in (1e3, 1e5, 1e7):
        effects = {
            "tendon_elasticity": {"stiffness": stiffness, "displacement_limits": [-0.02, 0.02]}
        }
        table = {"name": "wire", "segments": [wire], "tendons": tendons, "effects": effects}
        model = build_model(Scene.parse(table, "wire"), fidelity)
        for command in (end, shares[:, None] * end):
            assert np.isfinite(simulate(model, command, 1.0, 0.02).tip_pose).all()
        rest, _ = commanded_equilibrium(model, 0.5 * end)
        motion = simulate(model, 0.5 * end, 30.0, 1.0)  # soft cables: 1e-8 of the length after 20 s
        held = motion.tip_pose[-1]
        assert rest.converged
        way = held[:3, 3] - rest.tip_pose[:3, 3]
        assert np.linalg.norm(way) < 1e-9 * model.length


@pytest.mark.no_jit
def test_actuators_of_elastic_tendons_are_as_strong_as_the_tension_limits_unless_told():
    """With a slack for each tendon, or none; what pushes at most has no strength."""
    changes = {"tendons.0.tension_limits": [-4.0, -1.0]}
    scene = load_scene("three_tendon").replace(changes)
    for more, strength, slack in (
        ({}, [0.0, 5.0, 5.0], 0.0),
        ({"strength": 7.0, "slack": [0.0, 0.001, -0.002]}, 7.0, np.array([0.0, 0.001, -0.002])),
    ):
        table = {"stiffness": 200.0, "displacement_limits": [-0.01, 0.03], **more}
        elastic = scene.replace({"effects.tendon_elasticity": table})
        path = model_on(elastic, 2).arm.effects.transmission
        np.testing.assert_array_equal(path.stiffness, 200.0)
        expected_strength = np.broadcast_to(strength, 3)
        np.testing.assert_array_equal(path.strength, expected_strength)
        np.testing.assert_allclose(path.length, 0.3 + slack)
        limits = elastic.effects.command_limits(np.zeros((3, 2)))
        expected_limits = [[-0.01, 0.03]] * 3
        np.testing.assert_array_equal(limits, expected_limits)
        assert elastic.effects.command_unit == "m"
    tensions = np.array([[0.0, 5.0]] * 3)
    np.testing.assert_array_equal(scene.effects.command_limits(tensions), tensions)
    assert scene.effects.command_unit == "N"


def friction(coefficient=MU, **more):
    return {"effects.tendon_friction": {"coefficient": coefficient}, **more}


def bending(model, tension, direction):
    """The bending (q,) of an arm with one constant strain at rest under the first tendon: E I theta
    / l = T r (1 - exp(-a)) / a, with a = mu z theta."""
    field = model.strain_at(np.ones(1), [0.1])[1]
    unit = field[0, 2, 0]
    terms = model.terms([0.0], [0.0])
    force = terms.actuation[0, 0]
    height = unit * model.length
    lever = force / height

    def unbalanced(q):
        force = MU * direction * unit * q
        a = force * model.length * np.sign(q * unit)
        return (
            tension * lever * unit * model.length * (-np.expm1(-a) / a if a else 1.0)
            - terms.stiffness[0, 0] * q
        )

    pull = 3.0 * tension * terms.actuation[0, 0]
    stiffness = terms.stiffness[0, 0]
    far = pull / stiffness
    if unbalanced(far) < 0.0:
        return brentq(unbalanced, 0.0, far)
    return far


def test_hysteresis_of_a_slow_cycle(uniform):
    """Loading and unloading lie where the capstan equation has them, the loop closes, and its area
    is that of the theory."""
    steps = {"integrator.quasi_static": True, "integrator.columns": 1, "integrator.step": 1e-3}
    changes = friction(**{**steps, "quadrature.intervals": 5, "segments.0.damping": 200.0})
    changes["effects.tendon_friction"]["stiction_speed"] = 5e-7
    model = uniform(("bend_z",), 0, changes)
    period = 20.0

    def tension(time):
        angle = 2.0 * np.pi * time / period
        return np.array([2.0 - 1.5 * np.cos(angle), 0.0, 0.0])

    motion = simulate(model, tension, 3.0 * period, 0.05)
    pulls = [tension(time)[0] for time in motion.time]
    pull = np.array(pulls)
    q = motion.q[:, 0]
    per = round(period / 0.05)
    cycle_before = q[per : 2 * per + 1]
    bound = 1e-3 * np.abs(q).max()
    difference = q[2 * per :] - cycle_before
    assert np.abs(difference).max() < bound, "closed"
    least = bending(model, 0.5, -1.0)
    most = bending(model, 3.5, 1.0)

    def theory(direction, tensions):
        """Where the tendon slides, and before that where it sticks."""
        angles = [bending(model, tension, direction) for tension in tensions]
        return np.clip(angles, least, most)

    for direction, part in (
        (1.0, slice(per, per + per // 2)),
        (-1.0, slice(per + per // 2, 2 * per)),
    ):
        expected = theory(direction, pull[part])
        np.testing.assert_allclose(q[part], expected, rtol=1e-2)
