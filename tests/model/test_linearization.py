"""Exact linearisation of a period against central differences of the motion, with its steps and columns held."""

import numpy as np
import pytest

from soft_tendon_env import Simulation, build_model, load_scene
from soft_tendon_env.mechanics.motion.replay import replay
from soft_tendon_env.mechanics.motion.scratch import Motion

PERIOD = 0.02
EXACT = 1e-6  # relative, of every block
WEIGHT = {"effects.gravity.acceleration": (0.0, 0.0, -9.81)}

SCENES = {
    "nominal": ("three_tendon", "fast", {}),
    "many columns": ("catheter", "fast", {}),
    "fine": ("three_tendon", "fine", {}),
    "fluid": ("underwater", "fast", {}),
    "explicit": ("paper_48dof", "scene", {"quadrature.intervals": 4}),
    "gravity": ("three_tendon", "fast", WEIGHT),
    "loads inside": ("three_tendon", "fast", {**WEIGHT, "strain.include_loads": True}),
    "dead moment inside": (
        "three_tendon",
        "fast",
        {**WEIGHT, "strain.include_loads": True, "effects.tip_load.moment": (0.0, 0.01, 0.0)},
    ),
    "payload": ("three_tendon", "fast", {**WEIGHT, "effects.tip_load.mass": 0.02}),
    "lag": ("three_tendon", "fast", {"effects.actuators": {"time_constant": 0.05}}),
    "elastic tendons": ("three_tendon", "fast", {"effects.tendon_elasticity": {"stiffness": 2e4, "displacement_limits": (0.0, 0.02)}}),
    "memory": ("three_tendon", "fast", {"effects.viscoelastic_memory": {"branches": [{"modulus": 0.3, "relaxation_time": 0.1}]}}),
    "moving base": ("three_tendon", "fast", {"effects.moving_base": {"amplitude": (0.0, 0.01, 0.0), "frequency": 2.0}}),
    "quasi-static": ("three_tendon", "fast", {"integrator.quasi_static": True}),
}


def in_motion(model, random, periods=4):
    """A simulation after some periods under random commands, and one more command."""
    least, greatest = model.scene.effects.command_limits(np.array([own.tension_limits for own in model.scene.tendons])).T
    greatest = np.minimum(greatest, 20.0)

    def command():
        return least + (greatest - least) * random.uniform(0.05, 0.6, least.size)

    simulation = Simulation(model)
    for _ in range(periods):
        simulation.step(command(), PERIOD)
    return simulation, command()


def differences(simulation, command, part=1e-4):
    """Central differences of the next state (s) by state and command, from a motion with held steps; the units of both."""
    linearizer, begin = simulation._linearizer, simulation._motion
    linearizer.scratch.taken[:] = 0.0
    simulation.linearize(command, PERIOD)
    taken = linearizer.scratch.taken[: simulation_steps(linearizer)].copy()
    start = np.concatenate([begin.q, begin.q_dot, begin.state, command])
    n, s = begin.q.size, start.size - command.size
    unit = linearizer._unit.copy()
    unit[n : 2 * n] *= 10.0  # the integrator's extrapolation magnifies what rounding leaves of moved rates
    unit[2 * n : s] = np.maximum(np.abs(begin.state), 1e-3)

    def end(x):
        motion = Motion(x[:n].copy(), x[n : 2 * n].copy(), begin.xi.copy(), x[2 * n : s].copy(), begin.clock.copy())
        held = np.tile(x[s:], (int(taken[:, 0].max()) + 1, 1))
        assert replay(simulation.model.arm, linearizer._method, taken, held, motion, linearizer.scratch) == 0
        return np.concatenate([motion.q, motion.q_dot, motion.state])

    moved = np.diag(part * unit)
    return np.stack([(end(start + own) - end(start - own)) / (2.0 * own.max()) for own in moved], axis=1), unit


def simulation_steps(linearizer):
    """Steps in the log of the last linearisation."""
    return int(np.count_nonzero(linearizer.scratch.taken[:, 1]))


def blocks(n, s, inputs):
    """Slices of coordinates, rates and internal states, and of the commands besides."""
    rows = [slice(0, n), slice(n, 2 * n), slice(2 * n, s)]
    return [(row, column) for row in rows for column in (*rows, slice(s, inputs)) if row.start < row.stop and column.start < column.stop]


def check_every_block(model):
    """Checks derivatives of the end of a period by its state and command against central differences, each block by itself."""
    for seed in range(2):
        simulation, command = in_motion(model, np.random.default_rng(seed))
        found = simulation.linearize(command, PERIOD)
        expected, unit = differences(simulation, command)
        jacobian = np.hstack([found.state, found.command])
        n, s = model.coordinate_count, len(jacobian)
        for row, column in blocks(n, s, unit.size):
            scaled = (jacobian[row, column] - expected[row, column]) * unit[column] / unit[row, None]
            size = np.abs(expected[row, column] * unit[column] / unit[row, None]).max()
            assert np.abs(scaled).max() <= EXACT * size, (seed, row, column)


@pytest.mark.parametrize("name", SCENES)
def test_is_exact_in_every_block(name):
    """Derivatives of the end of a period agree with central differences of it."""
    scene, fidelity, changes = SCENES[name]
    check_every_block(build_model(load_scene(scene).replace(changes), fidelity=fidelity))


def test_leaves_the_simulation_where_it_was_and_knows_its_next_state():
    """A step after a linearisation leads, bit for bit, where that said; states that were saved go on alike."""
    simulation, command = in_motion(build_model(load_scene("three_tendon"), fidelity="fast"), np.random.default_rng(3))
    before = simulation.state
    following = simulation.linearize(command, 3 * PERIOD).next
    assert np.array_equal(simulation.state.q, before.q) and simulation.state.time == before.time
    simulation.step(command, 3 * PERIOD)
    for name in ("time", "q", "q_dot", "strain", "step"):
        assert np.array_equal(getattr(simulation.state, name), getattr(following, name))


def test_tip_moves_as_the_next_tip_pose_does():
    """The body twist of the tip is that by which moved commands move the next tip pose."""
    simulation, command = in_motion(build_model(load_scene("three_tendon"), fidelity="fast"), np.random.default_rng(4))
    found, start, s = simulation.linearize(command, PERIOD), simulation.state, 12
    for i in range(command.size):
        poses = []
        for way in (-1e-4, 1e-4):
            simulation.state = start
            simulation.step(command + way * np.eye(command.size)[i], PERIOD)
            poses.append(simulation.tip_pose)
        rate = np.linalg.inv(0.5 * (poses[0] + poses[1])) @ (poses[1] - poses[0]) / 2e-4
        twist = np.array([rate[2, 1], rate[0, 2], rate[1, 0], *rate[:3, 3]])
        assert twist == pytest.approx(found.tip[:, s + i], rel=1e-4, abs=1e-4 * np.abs(found.tip[:, s:]).max())


def test_a_delayed_command_moves_what_waits_for_its_time():
    """With a delay of two periods a command changes the queue alone, and the command that arrives changes the motion."""
    scene = load_scene("three_tendon").replace({"effects.actuators.delay": 0.04})
    simulation, command = in_motion(build_model(scene, fidelity="fast"), np.random.default_rng(5))
    found, tendons = simulation.linearize(command, PERIOD), command.size
    assert not found.command[:12].any() and np.isfinite(found.state).all()
    waiting = found.next.effects[2 * tendons :].reshape(-1, 1 + tendons)
    newest = int(np.flatnonzero(np.abs(waiting[:, 1:] - command).max(axis=1) == 0.0)[-1])
    first = 12 + 2 * tendons + newest * (1 + tendons) + 1
    assert found.command[first : first + tendons] == pytest.approx(np.eye(tendons))
    assert np.abs(found.state[:12, 12:]).max() > 0.0


def test_is_finite_in_contact_and_where_friction_sticks():
    """Kinks and jumps give one side's derivatives, never what is not finite."""
    for scene, changes in (("paper_among_obstacles", {}), ("three_tendon", {"effects.tendon_friction": {"coefficient": 0.3}})):
        simulation, command = in_motion(build_model(load_scene(scene).replace(changes), fidelity="fast"), np.random.default_rng(6))
        found = simulation.linearize(command, PERIOD)
        assert all(np.isfinite(part).all() and np.abs(part).max() < 1e6 for part in found[1:4])


def test_readings_are_differentiated_where_sensors_are_given():
    """Derivatives of tip twist, tendon lengths and strains by the state are those of the model's own functions after the period."""
    model = build_model(load_scene("three_tendon").replace(WEIGHT), fidelity="fast")
    simulation, command = in_motion(model, np.random.default_rng(7))
    sensors, n = np.array([0.1, 0.25]), model.coordinate_count
    found = simulation.linearize(command, PERIOD, sensors=sensors)
    assert simulation.linearize(command, PERIOD).strain is None

    def readings(state):
        twist = model.terms(state[:n], state[n:]).tip_jacobian @ state[n:]
        return np.concatenate([twist, model.tendon_lengths(state[:n]), model.strain_at(state[:n], sensors)[0].ravel()])

    end, along = np.concatenate([found.next.q, found.next.q_dot]), found.state @ simulation._linearizer._unit[: 2 * n]
    expected = (readings(end + 1e-4 * along) - readings(end - 1e-4 * along)) / 2e-4
    slopes = np.vstack([found.tip_twist, found.tendon_length, found.strain.reshape(12, -1)])
    for part in (slice(0, 6), slice(6, 9), slice(9, None)):
        size = np.abs(expected[part]).max()
        assert slopes[part, : 2 * n] @ simulation._linearizer._unit[: 2 * n] == pytest.approx(expected[part], abs=EXACT * size)
