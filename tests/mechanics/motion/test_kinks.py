"""Steps beside what is not smooth: kinks of elastic tendons, limits of effects to the length of a
step, and predictions that bend too much."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.linear import AT_GREATEST, AT_LEAST, BETWEEN
from soft_tendon_env.mechanics.effects import NO
from soft_tendon_env.mechanics.motion.advance import (
    LEAST_WHEN_LIMITED,
    Control,
    Limits,
    Scheme,
    find_longest,
    first_limits,
    try_step,
)
from soft_tendon_env.mechanics.motion.extrapolation import (
    Extrapolated,
    Substep,
    predict_strain,
)
from soft_tendon_env.mechanics.motion.implicit_euler import find_kink
from soft_tendon_env.mechanics.motion.scratch import KINKED, SMOOTH, Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

H = 0.004  # [s]
NEAR = 1e-5  # [m]
STIFFNESS = 5e3  # [N/m]
STRENGTH = 6.0  # [N]
MODES = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}]
BENDING = {"strain": {"type": "explicit", "modes": MODES}}
SPRINGS = {
    "effects.tendon_elasticity": {
        "stiffness": STIFFNESS,
        "displacement_limits": [-0.05, 0.05],
        "strength": STRENGTH,
    },
}


@pytest.fixture(scope="module")
def elastic():
    scene = load_scene("three_tendon").replace({**BENDING, **SPRINGS})
    return model_on(scene, 2).arm


def kink_of(arm, scratch, parts, tensions, number=0):
    """Whether a substep that ends with these parts of tensions has a kink, of tendons that would
    have begun with `tensions` [N] without bounds."""
    scratch.ends.part[:] = parts
    shortening = np.array([0.01, -0.02, 0.03])
    command = shortening + np.array(tensions) / STIFFNESS
    substep = Substep(H, number, number == 0, NEAR)
    find_kink(arm.effects.transmission, command, shortening, substep, scratch)
    return scratch.kink[0]


WAY = STIFFNESS * NEAR
"""[N] by which a tension may be off the part of its range that it comes to."""


@pytest.mark.parametrize(
    ("part", "tension", "off"),
    [
        (AT_LEAST, 0.0, 1.0),
        (AT_GREATEST, STRENGTH, -1.0),
        (BETWEEN, 0.0, -1.0),
        (BETWEEN, STRENGTH, 1.0),
    ],
    ids=["becomes slack", "becomes strong", "was slack", "was strong"],
)
def test_tensions_that_come_far_to_another_part_of_their_range_are_kinked(
    elastic, part, tension, off
):
    scratch = make_scratch(elastic, 2)
    others = [1.0, 2.0]
    for share, kink in ((-5.0, SMOOTH), (0.9, SMOOTH), (1.1, KINKED)):
        begun = tension + share * off * WAY
        tensions = [others[0], begun, others[1]]
        assert kink_of(elastic, scratch, [BETWEEN, part, BETWEEN], tensions) == kink


def test_later_substeps_are_kinked_where_their_parts_are_others(elastic):
    """Than those of the substep that is the step alone; a kink stays until the next step."""
    scratch = make_scratch(elastic, 2)
    tensions = [1.0, 2.0, -1.0]
    parts = [BETWEEN, BETWEEN, AT_LEAST]
    assert kink_of(elastic, scratch, parts, tensions) == SMOOTH
    assert kink_of(elastic, scratch, parts, [-9.0, 9.0, 9.0], number=1) == SMOOTH
    assert kink_of(elastic, scratch, [BETWEEN, AT_LEAST, AT_LEAST], tensions, number=1) == KINKED
    assert kink_of(elastic, scratch, parts, tensions, number=2) == KINKED
    assert kink_of(elastic, scratch, parts, tensions) == SMOOTH


def motion_of(model, q, rates):
    state = model.arm.effects.state.copy()
    return Motion(q, rates, model.packed_strain(q), state, np.zeros(1))


@pytest.mark.parametrize(
    ("limits", "rows"),
    [
        (Limits(np.inf, False), 2),
        (Limits(1.01 * H, False), 2),
        (Limits(0.5 * H, False), LEAST_WHEN_LIMITED),
        (Limits(np.inf, True), 2),
    ],
    ids=["none", "longer", "shorter", "touching"],
)
def test_steps_that_effects_limit_have_three_columns(limits, rows):
    """Whatever the tolerance; the motion goes on where one is accepted."""
    scene = load_scene("three_tendon").replace(BENDING)
    model = model_on(scene, 2)
    q = np.array([1.0, 0.8, 0.3])
    motion = motion_of(model, q.copy(), np.array([2.0, -1.0, 0.5]))
    scratch = make_scratch(model.arm, 4)
    scratch.arrival.command[:] = [2.0, 0.5, 1.0]
    scheme = Scheme(Extrapolated(4, 2, True, False, 1e-9), Control(H, 1.0, True, 1e-6, H))
    attempt, status, aim = try_step(model.arm, scheme, motion, 0.5 * H, limits, scratch)
    assert status == OK
    assert attempt.rows == rows
    assert (aim.tolerance < 1.0) == limits.touching
    assert (motion.q != q).all()
    np.testing.assert_array_equal(motion.q, scratch.q)


def test_effects_that_limit_nothing_allow_the_longest_step():
    """And the first step of a motion any."""
    scene = load_scene("three_tendon").replace(BENDING)
    model = model_on(scene, 2)
    motion = motion_of(model, np.zeros(3), np.zeros(3))
    scratch = make_scratch(model.arm, 2)
    control = Control(H, 1.0, True, 1e-6)
    scratch.longest[0] = 0.0
    scratch.work.strain.xi[:] = motion.xi
    find_longest(model.arm, motion, motion.q_dot, 0.0, False, control, scratch)
    assert scratch.longest[0] == H
    assert scratch.work.collision.flags.active[0] == NO
    np.testing.assert_array_equal(
        scratch.work.collision.before_step.pose, scratch.work.kinematics.pose
    )
    assert first_limits(model.arm, motion, control, scratch) == (np.inf, False)
    # poses are kept for the next step, unless something was met that nobody had foreseen
    before_step = scratch.work.collision.before_step
    for unforeseen, q in ((False, [1.0, 0.5, 0.0]), (True, [-1.0, 0.0, 2.0])):
        kept = before_step.pose.copy()
        scratch.work.strain.xi[:] = model.packed_strain(q)
        find_longest(model.arm, motion, motion.q_dot, H, unforeseen, control, scratch)
        if not unforeseen:
            kept = scratch.work.kinematics.pose
        np.testing.assert_array_equal(before_step.pose, kept)


@pytest.mark.parametrize(("share", "is_bent"), [(0.9, True), (1.1, False)])
def test_predictions_bend_no_further_than_they_go_straight(share, is_bent):
    """t^2 / 2 of the bias, of a motion for a time t, where that is not more than its columns
    make."""
    scene = load_scene("three_tendon")
    model = model_on(scene, 2)
    q = np.array([1.0, 0.5, 0.2])
    q_dot = np.array([3.0, -1.0, 2.0])
    time = 0.5
    work = make_workspace(model.arm)
    strain = work.strain
    strain.xi[:] = start = model.packed_strain(q)
    assert evaluate(model.arm, np.zeros(3), q, q_dot, 1e-12, work) == -1
    straight = time * strain.xi_dot
    bias = np.cos(np.arange(straight.size))
    half = 0.5 * time**2
    size = share * np.linalg.norm(straight) / np.linalg.norm(half * bias)
    strain.xi_bias[:] = size * bias
    strain.xi[:] = start
    predict_strain(model.arm.strain, q + time * q_dot, q, strain, work.spare.stress)
    expected = start + straight
    if is_bent:
        expected += half * size * bias
    np.testing.assert_allclose(strain.xi, expected, rtol=1e-9, atol=1e-12)
