"""Adjoints of periods over rows and of the filter of commands: against differences within stated
errors, and what they leave as it is."""

import numpy as np
import pytest

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.mechanics.motion.filter_adjoint import (
    begin_filter,
    filter_adjoint,
    make_filter_memory,
)
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.terms.command_filter import lag_response, receive, rest_filter
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
ROWS = 6
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
PLANE = {"type": "plane", "position": [0.0, 0.0, -0.02], "axis": [0.0, 0.1, 1.0]}
SCENES = {
    "bare": {},
    "gravity and payload": GRAVITY,
    "loads inside": {**GRAVITY, "strain.include_loads": True},
    "fluid": {"effects.fluid.density": 1000.0},
    "lagging actuators": {"effects.actuators": {"time_constant": 0.03, "rate_limit": 500.0}},
    "tendons that rub": {"effects.tendon_friction": {"coefficient": 0.2}},
    "elastic tendons": {
        "effects.tendon_elasticity": {"stiffness": 500.0, "displacement_limits": [0.0, 0.01]}
    },
    "explicit": {
        "strain": {
            "type": "explicit",
            "modes": [{"strains": ["bend_y", "bend_z"], "order": 2, "span": "rod"}],
        }
    },
}
ERRORS = {
    ("loads inside", "q_dot"): 0.1,
    ("tendons that rub", "q"): 0.1,
    ("tendons that rub", "q_dot"): 0.1,
    ("tendons that rub", "command"): 0.2,
    ("elastic tendons", "q"): 0.2,
    ("elastic tendons", "command"): 0.4,
    ("explicit", "q"): 0.1,
    ("explicit", "q_dot"): 0.06,
    **dict.fromkeys(
        [
            (scene, "command")
            for scene in (
                "bare",
                "gravity and payload",
                "loads inside",
                "fluid",
                "lagging actuators",
                "explicit",
            )
        ],
        0.12,
    ),
}
"""Relative errors along random directions of coordinates, rates and commands, where they are above
0.03."""
STATE = ("q", "q_dot")
KEPT = ("q", "q_dot", "xi", "state", "clock", "step")
READ = ("tip_pose", "tip_twist", "tendon_length", "strain", "strain_rate", "backbone_position")
STATIONS = np.array(
    [0.0, 0.01, 0.11, 0.2, 0.3]
)  # in the first interval, beside and at borders, at the tip
FILTERS = {
    "lag": {"time_constant": 0.03},
    "lag and rate": {"time_constant": 0.01, "rate_limit": 60.0},
    "rate": {"rate_limit": 60.0},
    "delay within a part": {"delay": 0.013},
    "delay of parts": {"delay": 0.05, "time_constant": 0.03},
    "all": {"delay": 0.007, "time_constant": 0.02, "rate_limit": 80.0},
}


def moving_rows(build, changes, threads=1, rows=ROWS):
    """Rows of arms in motion, and commands (rows, 1, 3) to go on with."""
    model = build("three_tendon", {"quadrature.intervals": 4, **changes})
    markers = np.array([0.07, 0.3])
    arms = Arms(model, rows, PERIOD, STATIONS, markers, threads)
    members = np.arange(rows)
    rest = Simulation(model).reset_at_rest()
    arms.place(members, np.tile(rest.q, (rows, 1)))
    unit = 1.0 if model.command_unit == "N" else 1e-3
    rng = np.random.default_rng(0)
    for _ in range(5):
        command = unit * rng.uniform(1.0, 4.0, (rows, 1, 3))
        arms.step(command, members)
    last_command = unit * rng.uniform(1.0, 4.0, (rows, 1, 3))
    return arms, last_command


def random_cotangents(arms, names, parts=1):
    """Random cotangents of some names, in the units of the arm."""
    rng = np.random.default_rng(1)
    cotangents = arms.make_cotangents(parts)
    unit = arms.model.coordinate_scale()
    units = {"q": unit, "q_dot": 30.0 * unit}
    for name in names:
        values = getattr(cotangents, name)
        drawn = rng.normal(size=values.shape)
        values[:] = drawn / units.get(name, 1.0)
    return cotangents


def after(arms, start, command, way=0.0, q=0.0, q_dot=0.0, durations=None):
    """State and reading after a period from where rows were, moved a way along a direction."""
    for name, values in start.items():
        getattr(arms.rows, name)[:] = values
    arms.rows.q[:] += way * q
    arms.rows.q_dot[:] += way * q_dot
    arms.step(command, np.arange(arms.size), durations)
    found = {
        **arms.rows.fields(),
        **arms.reading.fields(),
        "backbone_position": arms.reading.backbone[..., :3, 3],
    }
    return {name: found[name].copy() for name in (*STATE, *READ)}


def as_twists(change, pose):
    """Changes of poses (rows, 4, 4) as twists (rows, 6) in their frames."""
    turned = np.linalg.inv(pose) @ change
    return np.stack(
        [turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0], *turned[:, :3, 3].T], axis=1
    )


@pytest.mark.parametrize("scene", SCENES)
def test_adjoint_is_near_differences(build, scene):
    arms, command = moving_rows(build, SCENES[scene])
    start = {name: getattr(arms.rows, name).copy() for name in KEPT}
    tape = arms.make_tape()
    members = np.arange(ROWS)
    rng = np.random.default_rng(2)
    unit = arms.model.coordinate_scale()
    arms.step(command, members, None, tape)
    pose = arms.reading.tip_pose.copy()
    given = random_cotangents(arms, (*STATE, *READ))
    found = random_cotangents(arms, (*STATE, *READ))
    arms.adjoint(tape, members, found)
    for name, scale in (("q", unit), ("q_dot", 30.0 * unit), ("command", 0.3 * command)):
        direction = scale * rng.normal(size=getattr(found, name).shape)
        if name in STATE:
            moved = {name: direction}
        else:
            moved = {}
        ends = []
        for way in (1e-4, -1e-4):
            changed_command = command
            if not moved:
                changed_command = command + way * direction
            end = after(arms, start, changed_command, way, **moved)
            ends.append(end)
        ahead, behind = ends
        changes = {key: (ahead[key] - behind[key]) / 2e-4 for key in ahead}
        changes["tip_pose"] = as_twists(changes["tip_pose"], pose)
        expected = np.zeros(ROWS)
        for key, change in changes.items():
            products = getattr(given, key) * change
            expected += products.reshape(ROWS, -1).sum(axis=1)
        products = getattr(found, name) * direction
        slope = products.reshape(ROWS, -1).sum(axis=1)
        allowed = ERRORS.get((scene, name), 0.03)
        off = np.linalg.norm(slope - expected)
        assert off < allowed * np.linalg.norm(expected), name


@pytest.mark.parametrize(
    ("changes", "command"),
    [
        ({**GRAVITY, "effects.contact.obstacles": [PLANE]}, 0.0),
        (SCENES["elastic tendons"], -1e-3),
        ({}, 0.0),
    ],
    ids=["contact", "slack", "at rest"],
)
def test_adjoint_is_finite_where_motion_is_not_smooth(build, changes, command):
    arms, _ = moving_rows(build, changes)
    members = np.arange(ROWS)
    tape = arms.make_tape()
    cotangents = random_cotangents(arms, (*STATE, *READ))
    held = np.full((ROWS, 1, 3), command)
    for _ in range(20):
        arms.step(held, members, None, tape)
    arms.adjoint(tape, members, cotangents)
    assert all(np.isfinite(values).all() for values in cotangents)
    assert cotangents.q.any()


def test_what_has_no_adjoint_is_named(build):
    arms, command = moving_rows(build, {})
    tape = arms.make_tape()
    members = np.arange(ROWS)
    cotangents = random_cotangents(arms, STATE)
    arms.step(command, members, None, tape)
    arms.set_model(2, arms.model.with_numbers({"segments.*.young_modulus": 1.1e6}))
    with pytest.raises(ValueError, match="row 2 has got another arm"):
        arms.adjoint(tape, members, cotangents)
    arms.rows.q_dot[1] = 1e9
    arms.step(command, members, None, tape)
    arms.adjoint(tape, members, cotangents)
    assert arms.outcome.status[1] != 0
    assert not cotangents.q[1].any()
    assert not cotangents.command[1].any()
    assert cotangents.q[0].any()
    with pytest.raises(ValueError, match="viscoelastic_memory has internal states"):
        memory = {
            "effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}]
        }
        arms, _ = moving_rows(build, memory)
        arms.adjoint(arms.make_tape(), members, arms.make_cotangents())


def numbers_of(state):
    """Which of the internal state are numbers of tendons, of commands that there are."""
    commands = state[3:].reshape(-1, 4)
    is_there = commands[:, :1] < 1e20
    waiting = np.repeat(is_there, 4, axis=1)
    waiting[:, 0] = False
    tensions = np.ones(3, dtype=bool)
    return np.append(tensions, waiting.ravel())


@pytest.mark.parametrize("name", FILTERS)
def test_filter_adjoint_is_that_of_differences(name, build):
    changes = {"quadrature.intervals": 4, "effects.actuators": FILTERS[name]}
    arm = build("three_tendon", changes).arm
    effects = arm.effects
    memory = make_filter_memory(arm)
    scratch = make_scratch(arm, 2)
    rng = np.random.default_rng(0)
    start = effects.state.copy()
    times = np.array([0.0, PERIOD])
    rest_filter(effects, rng.uniform(1.0, 4.0, 3), start)
    for _ in range(4):  # commands are on their way, and tensions lag
        begin_filter(effects, start, rng.uniform(1.0, 4.0, 3), times, True, scratch, memory)
        start = memory.state.copy()
        times = times + PERIOD
    command = rng.uniform(1.0, 4.0, 3)
    # another memory, which is not where the last part has ended
    memory = make_filter_memory(arm)
    begin_filter(effects, start, command, times, True, scratch, memory)
    of_means = rng.normal(size=(2, 3))
    of_state = np.where(numbers_of(memory.state), rng.normal(size=start.size), 0.0)

    def run(start, command, count=200):
        """What the cotangents belong to, mean commands in the halves and the internal state at the
        end, in many steps."""
        state = start.copy()
        mean = np.zeros((2, 3))
        step = PERIOD / count
        arrival = scratch.arrival
        for k in range(count):
            time = times[0] + k * step
            receive(effects, command, k == 0, time, state, arrival)
            now = arrival.command.copy()
            for i in range(3 if effects.transmission.lags else 0):
                arrived = arrival.command[i]
                now[i] = lag_response(effects.transmission, state[i], arrived, 0.5 * step)
                state[i] = lag_response(effects.transmission, state[i], arrived, step)
            mean[2 * k // count] += now / (count / 2)
        receive(effects, command, False, times[1], state, arrival)
        return (of_means * mean).sum() + (of_state * state).sum()

    memory.force[:] = of_means
    found = of_state.copy()
    by_command = np.zeros(3)
    move = 1e-5
    filter_adjoint(effects, start, times, True, found, by_command, memory)
    expected = []
    for way in move * np.eye(3):
        ahead = run(start, command + way)
        behind = run(start, command - way)
        expected.append((ahead - behind) / (2.0 * move))
    np.testing.assert_allclose(by_command, expected, atol=5e-3)
    for i in np.flatnonzero(numbers_of(start)):
        way = move * np.eye(start.size)[i]
        ahead = run(start + way, command)
        behind = run(start - way, command)
        slope = (ahead - behind) / (2.0 * move)
        assert found[i] == pytest.approx(slope, abs=5e-3)
