"""Internal states of effects within a step: what a stress remembers goes on from substep to substep
in every row of the table, and from the motion's beginning to its end."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import EffectTable, adds_stress
from soft_tendon_env.mechanics.motion.advance import Control, Record, Scheme, advance, settle
from soft_tendon_env.mechanics.motion.extrapolation import (
    Demand,
    Extrapolated,
    extrapolated_step,
)
from soft_tendon_env.mechanics.motion.scratch import Motion, copy_motion, make_scratch
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

H = 0.004  # [s]
MODULUS = 0.5  # [N m^2 / s]
GROWTH = 0.3  # [N m / s]
TIME = 0.2  # [s] of the motion
TENSION = np.array([2.0, 0.5, 1.0])
Q = np.array([1.0, 0.8, 0.3])
RATES = np.array([20.0, -10.0, 5.0])
BEFORE = 0.03  # [s / m] that is remembered to begin with
MODES = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}]
BENDING = {"strain": {"type": "explicit", "modes": MODES}}


class Integral(Struct):
    """A stress that is the integral of the strain over time, and another that grows with time."""

    modulus: float
    growth: float


@adds_stress(Integral)
@kernel
def _integral(effect, points):
    for m in range(points.strain.size):
        mean = 0.5 * (points.before[m] + points.strain[m])
        points.state[m] += points.since * (mean - points.reference[m])
        points.stress[m] += effect.modulus * points.state[m]
        points.stress[m] += effect.growth * points.time


@pytest.fixture(scope="module")
def bare():
    scene = load_scene("three_tendon").replace(BENDING)
    return model_on(scene, 2)


@pytest.fixture(scope="module")
def arm(bare):
    """The arm that remembers."""
    size = bare.arm.rod.reference_strain.size
    state = np.full(size, BEFORE)
    integral = Integral(MODULUS, GROWTH)
    effects = EffectTable((integral,), (state,))
    return bare.arm.replaced(effects=effects)


def first_entry(model, count):
    """Coordinates and rates after so many linearly implicit substeps, which remember the mean
    strain from where one begins to where the next one does."""
    h = H / count
    q = Q
    v = RATES
    q_before = Q
    remembered = np.full(3, BEFORE)
    for number in range(count):
        if number > 0:
            mean = 0.5 * (q_before + q)
            remembered = remembered + h * mean
        q_before = q
        time = TIME + number * h
        stress = MODULUS * remembered + GROWTH * time
        terms = model.terms(q, v, TENSION)
        D = terms.damping
        G = terms.stiffness
        pulled = terms.actuation @ TENSION
        resisted = terms.elastic_force + D @ v + terms.bias
        force = pulled - resisted - model.length * stress
        damped = terms.mass + h * D
        system = damped + h**2 * G
        impulse = h * (force - h * G @ v)
        v = v + np.linalg.solve(system, impulse)
        q = q + h * v
    return np.concatenate([q, v])


def step_with(arm, bare, columns):
    """The scratch after an extrapolated step, and the motion before it."""
    method = Extrapolated(columns, columns, True, False, 1e-12)
    scratch = make_scratch(arm, columns)
    clock = np.array([TIME])
    strain = bare.packed_strain(Q)
    state = arm.effects.state.copy()
    motion = Motion(Q.copy(), RATES.copy(), strain, state, clock)
    demand = Demand(1e300, columns, H)
    attempt = extrapolated_step(arm, method, demand, TENSION, motion, H, scratch)
    assert attempt.status == OK
    assert scratch.work.inputs.since[0] == 0.0
    return scratch, motion


@pytest.mark.parametrize(("columns", "shares"), [(1, [1.0]), (2, [-1.0, 2.0]), (3, [0.5, -4, 4.5])])
def test_substeps_remember_what_was_before_them(arm, bare, columns, shares):
    """Extrapolated from 1, 2 and 3 substeps, each of which begins with the motion's memory."""
    scratch, _ = step_with(arm, bare, columns)
    entries = [first_entry(bare, count) for count in range(1, columns + 1)]
    expected = shares @ np.array(entries)
    np.testing.assert_allclose(scratch.q, expected[:3], rtol=1e-7)
    np.testing.assert_allclose(scratch.v, expected[3:], rtol=1e-7, atol=1e-6)


def test_a_step_that_is_accepted_is_remembered_once(arm, bare):
    """From the motion to its end, at the strain there."""
    scratch, motion = step_with(arm, bare, 3)
    begun = motion.xi.copy()
    control = Control(H, 1e300, False, 0.5 * H)
    status = settle(arm, TENSION, motion, H, False, control, scratch)
    assert status == OK
    np.testing.assert_array_equal(motion.q, scratch.q)
    np.testing.assert_array_equal(motion.q_dot, scratch.v)
    strain = bare.packed_strain(motion.q)
    np.testing.assert_allclose(motion.xi, strain, rtol=1e-9, atol=1e-12)
    mean = 0.5 * (begun + strain)
    strained = mean - arm.rod.reference_strain
    remembered = BEFORE + H * strained
    np.testing.assert_allclose(motion.state, remembered, rtol=1e-9, atol=1e-15)
    assert scratch.work.inputs.since[0] == 0.0


def end_after(arm, bare, durations):
    """The motion after a command that is held for these durations, in steps of length H."""
    clock = np.array([TIME])
    strain = bare.packed_strain(Q)
    state = arm.effects.state.copy()
    motion = Motion(Q.copy(), RATES.copy(), strain, state, clock)
    scheme = Scheme(Extrapolated(2, 2, True, False, 1e-12), Control(H, 1e300, False, 0.5 * H))
    rows = len(durations)
    commands = np.tile(TENSION, (rows, 1))
    nothing = Record(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4, 4)))
    scratch = make_scratch(arm, 2)
    progress = advance(arm, scheme, commands, np.array(durations), motion, H, scratch, nothing)
    assert progress.status == OK
    assert progress.steps == 3
    return motion


def test_time_and_memory_go_on_from_step_to_step(arm, bare):
    """Within a command as from one to the next."""
    duration = 3.0 * H
    together = end_after(arm, bare, [duration])
    one_by_one = end_after(arm, bare, [H, H, H])
    end = TIME + duration
    assert together.clock[0] == pytest.approx(end)
    np.testing.assert_allclose(together.q, one_by_one.q, rtol=1e-9)
    np.testing.assert_allclose(together.q_dot, one_by_one.q_dot, rtol=1e-8)
    np.testing.assert_allclose(together.state, one_by_one.state, rtol=1e-9, atol=1e-15)


def test_a_copied_motion_has_every_part_of_its_source():
    """And none of its own."""
    sizes = (3, 3, 12, 5, 1)
    rng = np.random.default_rng(0)
    source = Motion(*(rng.normal(size=size) for size in sizes))
    copied = Motion(*(rng.normal(size=size) for size in sizes))
    copy_motion(source, copied)
    for name in Motion._fields:
        part = getattr(copied, name)
        of_source = getattr(source, name)
        np.testing.assert_array_equal(part, of_source)
        assert not np.shares_memory(part, of_source)
