"""Derivatives of periods against differences of plain steps, of fourth order and with other
steps."""

import warnings

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, Simulation, build_model, load_scene
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.simulation import _slopes

PERIOD = 0.02
FOURTH_ORDER = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
TENSION = np.array([1.0, 3.0, 0.5])
WEIGHT = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
LOADED = {**WEIGHT, "effects.tip_load.mass": 0.005}
EXPLICIT = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}],
    }
}
PUSH = {"force": [0.0, 0.2, 0.0], "at": 0.3, "signal": {"type": "sine", "frequency": 2.0}}
LAGGING = {"integrator.step": 0.01, "effects.actuators": {"time_constant": 0.03}}
MEMORY = {"effects.viscoelastic_memory.branches": [{"modulus": 0.3, "relaxation_time": 0.1}]}


def build_quietly(changes, name="three_tendon"):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # passive fields that were made for other loads
        return build_model(
            load_scene(name).replace(changes), "scene" if "strain" in changes else "fast"
        )


def in_motion(model):
    """A simulation after four periods of random commands, and one more command."""
    tension_limits = [tendon.tension_limits for tendon in model.scene.tendons]
    least, greatest = np.array(tension_limits).T
    table = least + np.random.default_rng(0).uniform(0.05, 0.4, (5, least.size)) * (
        greatest - least
    )
    simulation = Simulation(model)
    for command in table[:4]:
        simulation.step(command, PERIOD)
    return put(
        simulation,
        simulation.state,
        simulation.state.q,
        simulation.state.q_dot,
        simulation.state.effects,
    ), table[4]


def put(simulation, start, q, q_dot, effects):
    simulation.reset(q, q_dot, time=start.time, effects=effects)
    return simulation


def end(model, start, *inputs):
    """State, tip pose and body twist of the tip over the base after a plain step from inputs (q,
    q_dot, effects, command)."""
    simulation = put(Simulation(model), start, *inputs[:3])
    simulation.step(inputs[3], PERIOD)
    state = simulation.state
    parts = [state.q, state.q_dot, state.effects]
    numbers = np.concatenate(parts)
    return (
        numbers,
        simulation.tip_pose,
        model.terms(state.q, state.q_dot).tip_jacobian @ state.q_dot,
    )


def differences(evaluate, step):
    """Derivatives of all that is evaluated so many steps off, that of the tip pose as a body
    twist."""
    values = []
    for k, weight in FOURTH_ORDER.items():
        reached = evaluate(k * step)
        values.append((weight / step, reached))
    middle = evaluate(0.0)
    slopes = []
    for i in range(len(middle)):
        terms = [weight * reached[i] for weight, reached in values]
        slopes.append(sum(terms))
    _, pose, *_ = middle
    by_state, by_pose, *others = slopes
    # R^T dR is antisymmetric
    moved = np.linalg.inv(pose) @ by_pose
    about_x = moved[2, 1]
    about_y = moved[0, 2]
    about_z = moved[1, 0]
    angular = [about_x, about_y, about_z]
    way = moved[:3, 3]
    twist = np.array([*angular, *way])
    return [by_state, twist, *others]


def assert_close(found, expected, tolerance=1e-5):
    np.testing.assert_allclose(
        found, expected, atol=tolerance * np.abs(expected).max() + 1e-11, rtol=0.0
    )


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("three_tendon", {}),
        ("three_tendon", {**LOADED, "effects.disturbance.loads": [PUSH]}),
        ("three_tendon", {"effects.fluid": {"density": 1000.0, "current": [0.1, 0.3, 0.2]}}),
        (
            "three_tendon",
            {"effects.moving_base": {"amplitude": [0.0, 0.01, 0.0], "frequency": 2.0}},
        ),
        pytest.param("three_tendon", MEMORY, marks=pytest.mark.slow),
        ("three_tendon", LAGGING),
        ("three_tendon", EXPLICIT),
    ],
)
def test_linearization_is_as_differences_of_plain_steps(name, changes):
    model = build_quietly(changes, name)
    simulation, command = in_motion(model)
    start = simulation.state
    found = simulation.linearize(command, PERIOD)
    here = [start.q, start.q_dot, start.effects, command]
    scale = model.coordinate_scale()
    unit = np.concatenate(
        [scale, 10.0 * scale, np.maximum(np.abs(start.effects), 1e-3), np.full(command.size, 10.0)]
    )
    inputs = np.concatenate(here)
    borders = np.cumsum([part.size for part in here])
    slopes = []
    for i, size in enumerate(unit):

        def evaluate(change, i=i):
            return end(
                model, start, *np.split(inputs + change * np.eye(inputs.size)[i], borders[:-1])
            )

        scaled = [size * slope for slope in differences(evaluate, 3e-4 * size)]
        slopes.append(scaled)
    states, tips, twists = (np.stack(parts, axis=-1) for parts in zip(*slopes, strict=True))
    derivatives = np.hstack([found.state, found.command])
    by = derivatives * unit
    row_parts = np.split(np.arange(borders[2]), borders[:2])
    for rows in row_parts:
        column_parts = np.split(np.arange(borders[3]), borders[:3])
        for columns in column_parts:
            if rows.size and columns.size:
                block = np.ix_(rows, columns)
                assert_close(by[block], states[block])
    assert_close(found.tip * unit, tips)
    if "effects.moving_base" not in changes:
        assert_close(found.tip_twist * unit, twists)


@pytest.mark.parametrize("delay", [0.008, 0.03])
def test_commands_act_in_a_period_from_when_they_arrive_on(delay):
    """However many steps it has; one that arrives after its end moves nothing in it."""
    model = build_quietly({"integrator.step": 0.005, "effects.actuators": {"delay": delay}})
    simulation, command = in_motion(model)
    start = simulation.state
    found = simulation.linearize(command, PERIOD)
    moving = 2 * model.coordinate_count
    slopes = []
    for unit in np.eye(3):

        def evaluate(change, unit=unit):
            changed = command + change * unit
            return end(model, start, start.q, start.q_dot, start.effects, changed)

        by_state, *_ = differences(evaluate, 3e-3)
        slopes.append(by_state[:moving])
    by_command = np.transpose(slopes)
    moves = np.abs(by_command).max() > 1e-9
    assert moves == (delay < PERIOD)
    assert_close(found.command[:moving], by_command)


def test_leaves_the_simulation_where_it_was_and_knows_its_next_state():
    """A step after a linearisation leads, bit for bit, where that said, over more steps than a log
    has room for at first too."""
    simulation, command = in_motion(
        build_model(load_scene("three_tendon").replace({"integrator.step": 0.001}))
    )
    following = simulation.linearize(command, 5 * PERIOD).next
    assert simulation.step(command, 5 * PERIOD).steps > 64
    for name in ("time", "q", "q_dot", "strain", "step"):
        reached = getattr(simulation.state, name)
        expected = getattr(following, name)
        assert np.array_equal(reached, expected)
    assert_close(
        simulation.linearize(command, 0.0).state, np.eye(2 * simulation.model.coordinate_count)
    )


@pytest.mark.parametrize(
    ("changes", "key", "message"),
    [
        ({}, "quadrature.intervals", "quadrature.intervals is no number of the scene"),
        (
            {"effects.actuators.delay": 0.013},
            "effects.actuators.delay",
            "effects.actuators.delay changes the number of internal states",
        ),
        ({}, "segments.0.poisson_ratio", r"segments\[0\].poisson_ratio is 0.9"),
    ],
)
def test_numbers_that_cannot_be_are_refused(changes, key, message):
    with pytest.raises(ConfigurationError, match=message):
        build_quietly(changes).with_numbers({key: 0.9})


JUMP = 1e5
"""Size of a jump beside the changes of what is smooth."""


def test_slopes_are_central_but_beside_jumps():
    """Where a value jumps on one side, or has none there, the slope is that of the other; a change
    beside none is a kink, and central."""
    step = np.array([0.1, 0.2])
    middle = np.zeros(5)
    to_right = np.array(
        [
            [0.3, JUMP, 0.3, np.inf, 0.4],
            [0.6, JUMP, 0.6, np.inf, 0.8],
        ]
    )
    to_left = np.array(
        [
            [-0.1, -0.1, -JUMP, -0.1, 0.0],
            [-0.2, -0.2, -JUMP, -0.2, 0.0],
        ]
    )
    slopes = _slopes(np.vstack([middle, to_right, to_left]), step)
    expected = [2.0, 1.0, 3.0, 1.0, 2.0]
    expected_slopes = np.stack([expected, expected], axis=1)
    np.testing.assert_allclose(slopes, expected_slopes)


def test_memories_of_strain_have_derivatives_too():
    """Along random changes of coordinates, rates, what is remembered, and commands."""
    modes = [{"strains": ["bend_y", "bend_z"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    changes = {"strain": strain, **MEMORY}
    scene = load_scene("three_tendon").replace(changes)
    model = model_on(scene, 2)
    simulation, command = in_motion(model)
    start = simulation.state
    found = simulation.linearize(command, PERIOD)
    derivatives = np.hstack([found.state, found.command])
    here = [start.q, start.q_dot, start.effects, command]
    inputs = np.concatenate(here)
    borders = np.cumsum([part.size for part in here])
    scale = model.coordinate_scale()
    memory = np.full(start.effects.size, np.abs(start.effects).max())
    unit = np.concatenate([scale, 10.0 * scale, memory, np.ones(3)])
    rng = np.random.default_rng(0)
    sides = rng.normal(size=(3, inputs.size))
    is_memory = np.arange(inputs.size) >= borders[1]
    is_memory &= np.arange(inputs.size) < borders[2]
    # the memory alone besides
    sides[-1, ~is_memory] = 0.0
    for way in unit * sides:

        def evaluate(change, way=way):
            return end(model, start, *np.split(inputs + change * way, borders[:-1]))

        by_state, by_pose, _ = differences(evaluate, 1e-3)
        for rows in np.split(np.arange(borders[2]), borders[:2]):
            assert_close(derivatives[rows] @ way, by_state[rows])
        assert_close(found.tip @ way, by_pose)


def test_periods_of_too_many_steps_have_no_linearisation():
    scene = load_scene("three_tendon").replace({"integrator.step": 1e-6})
    simulation = Simulation(model_on(scene, 2))
    with pytest.raises(ValueError, match="at most 4096 integrator steps, not 4100"):
        simulation.linearize(np.zeros(3), 4.1e-3)
    assert simulation.state.time == 0.0
