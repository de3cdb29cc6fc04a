"""Linearly implicit substeps and their extrapolation against their formulas, and the balance at
rest against differences."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, aligned_zeros, load, store
from soft_tendon_env.mechanics.motion.advance import (
    LEAST_ERROR,
    ROUGH,
    Control,
    Limits,
    next_step,
    step_length,
    while_touching,
)
from soft_tendon_env.mechanics.motion.equilibrium import Linearisation, linearise_balance
from soft_tendon_env.mechanics.motion.extrapolation import (
    HOPELESS,
    TURNED,
    Attempt,
    Demand,
    Extrapolated,
    complete_row,
    error_estimate,
    extrapolate,
    extrapolated_step,
    growth_of_noise,
    predict_strain,
    step_error,
)
from soft_tendon_env.mechanics.motion.pose_errors import (
    move_poses,
    pose_error_cotangents,
    pose_errors,
)
from soft_tendon_env.mechanics.motion.scratch import KINKED, SMOOTH, Motion, make_scratch
from soft_tendon_env.mechanics.motion.sliding import (
    SMALL_TURN,
    decays,
    find_turned,
    keep_directions,
)
from soft_tendon_env.mechanics.motion.status import INACCURATE, NOT_FINITE, OK
from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

H = 0.004
TENSION = np.array([2.0, 0.5, 1.0])
Q = np.array([1.0, 0.8, 0.3])
RATES = np.array([20.0, -10.0, 5.0])
BENDING = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}],
    }
}
FLUID = {
    "effects.fluid": {"density": 1000.0, "current": [0.1, 0.2, 0.0]},
    "effects.gravity.acceleration": [0.0, 0.0, -9.81],
}
SPRINGS = {
    "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [-0.05, 0.05]},
    **BENDING,
}


def arm_with(changes):
    scene = load_scene("three_tendon").replace(changes)
    return model_on(scene, 2)


def motion_of(model, q=Q, rates=RATES):
    state = model.arm.effects.state.copy()
    return Motion(q.copy(), rates.copy(), model.packed_strain(q), state, np.zeros(1))


def step_with(model, columns, command=TENSION, frozen=False, inertia=True, tolerance=1e300):
    """The scratch after an extrapolated step of length H, and the attempt."""
    method = Extrapolated(columns, columns, inertia, frozen, 1e-12)
    scratch = make_scratch(model.arm, columns)
    demand = Demand(tolerance, columns, H)
    attempt = extrapolated_step(model.arm, method, demand, command, motion_of(model), H, scratch)
    return scratch, attempt


def linear_system(model, q, v, tension):
    """M, D and G with the effects' share, and the force drive - C v + F, at (q, v)."""
    terms = model.terms(q, v, tension)
    drive = terms.actuation @ tension - terms.elastic_force - terms.damping @ v
    force = drive - terms.bias + terms.external_force
    damping = terms.damping + terms.external_damping
    stiffness = terms.stiffness + terms.external_stiffness
    return terms.mass, damping, stiffness, force


def substep(matrices, force, q, v, h):
    """(M + h D + h^2 G) dv = h (f - h G v), then q += h v."""
    M, D, G = matrices
    damped = M + h * D
    system = damped + h**2 * G
    impulse = h * (force - h * G @ v)
    v = v + np.linalg.solve(system, impulse)
    return q + h * v, v


@pytest.mark.parametrize("changes", [{}, FLUID, BENDING], ids=["bare", "fluid", "explicit"])
def test_one_column_is_a_linearly_implicit_euler_step(changes):
    model = arm_with(changes)
    scratch, attempt = step_with(model, 1)
    M, D, G, force = linear_system(model, Q, RATES, TENSION)
    q, v = substep((M, D, G), force, Q, RATES, H)
    np.testing.assert_allclose(scratch.q, q, rtol=1e-9)
    np.testing.assert_allclose(scratch.v, v, rtol=1e-9, atol=1e-9)
    assert attempt[:3] == (OK, 1, 1)


def test_one_column_without_inertia_balances_damping():
    """(h D + h^2 G) dv = h (f - h G v), without M and C v."""
    model = arm_with({})
    scratch, _ = step_with(model, 1, inertia=False)
    M, D, G, force = linear_system(model, Q, RATES, TENSION)
    bias = model.terms(Q, RATES, TENSION).bias
    weightless = (0.0 * M, D, G)
    q, v = substep(weightless, force + bias, Q, RATES, H)
    np.testing.assert_allclose(scratch.q, q, rtol=1e-9)
    np.testing.assert_allclose(scratch.v, v, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("changes", [{}, FLUID], ids=["bare", "fluid"])
def test_two_columns_extrapolate_one_step_and_two_halves(changes, frozen):
    """T = 2 T(h/2) - T(h); M, the forces and the effects' share are those of every substep, the
    rod's own D and G those of the first, where they are frozen."""
    model = arm_with(changes)
    scratch, attempt = step_with(model, 2, frozen=frozen)
    M, D, G, force = linear_system(model, Q, RATES, TENSION)
    whole = substep((M, D, G), force, Q, RATES, H)
    q, v = substep((M, D, G), force, Q, RATES, 0.5 * H)
    M_half, D_half, G_half, force_half = linear_system(model, q, v, TENSION)
    if frozen:
        first = model.terms(Q, RATES, TENSION)
        second = model.terms(q, v, TENSION)
        D_half = D_half - second.damping + first.damping
        G_half = G_half - second.stiffness + first.stiffness
    halves = substep((M_half, D_half, G_half), force_half, q, v, 0.5 * H)
    for found, one, two in zip((scratch.q, scratch.v), whole, halves, strict=True):
        extrapolated = 2.0 * two - one
        np.testing.assert_allclose(found, extrapolated, rtol=1e-7, atol=1e-7)
    difference = halves[0] - whole[0]
    largest = np.abs(Q).max()
    np.testing.assert_allclose(scratch.error_q, difference, rtol=1e-6, atol=1e-6 * largest)
    assert attempt.evaluations == 2
    assert attempt.rows == 2


def rest_of(model, force, B, v, h=H):
    """What is left of the linear system at the rates v of a step's end, under forces by tendons."""
    M, D, G, _ = linear_system(model, Q, RATES, np.zeros(3))
    damped = M + h * D
    system = damped + h**2 * G
    stiffening = h * G @ RATES
    impulse = h * (force + B - stiffening)
    return system @ (v - RATES) - impulse


@pytest.mark.parametrize("stretch", [[4e-4, 1e-3, -2e-3], [4e-4, 2e-2, 3e-4]])
def test_elastic_tendons_have_the_tensions_of_a_step_s_end(stretch):
    """x = clip(k (u - s - h y), 0, strength) with the rates y = B^T v' at the end."""
    model = arm_with(SPRINGS)
    path = model.arm.effects.transmission
    shortening = path.length - model.tendon_lengths(Q)
    scratch, _ = step_with(model, 1, command=shortening + stretch)
    B = model.terms(Q, RATES).actuation
    y = B.T @ scratch.v
    shortened = np.array(stretch) - H * y
    tension = np.clip(path.stiffness * shortened, 0.0, path.strength)
    np.testing.assert_allclose(scratch.ends.tension, tension, rtol=1e-9, atol=1e-9)
    # the explicit rod's stiffness has that of the tensions at the beginning in it
    pull = path.stiffness * np.array(stretch)
    begun = np.clip(pull, 0.0, path.strength)
    terms = model.terms(Q, RATES, begun)
    M = terms.mass
    D = terms.damping
    G = terms.stiffness
    damping = terms.damping @ RATES
    force = B @ tension - terms.elastic_force - damping - terms.bias
    system = M + H * D + H**2 * G
    rest_of_force = force - H * G @ RATES
    v = RATES + np.linalg.solve(system, H * rest_of_force)
    np.testing.assert_allclose(scratch.v, v, rtol=1e-8)


STICTION = 1e-3  # [m/s]
RUBBING = {"effects.tendon_friction": {"coefficient": 0.4, "stiction_speed": STICTION}}


def border_rows(scratch, model):
    """Rows w_k of the tendons' borders (n_a, points, n) at the beginning of a step."""
    count = model.tendon_count
    rows = scratch.first.borders.row
    points = scratch.first.borders.turn.size // count
    by_border = rows.reshape(count, points, -1)
    return by_border[..., : model.coordinate_count]


def friction_of(scratch, model, tension):
    """Generalised force (n,) of what tensions fall by, by the rates at a step's end."""
    rows = border_rows(scratch, model)
    sliding = rows @ scratch.v
    speeds = np.hypot(sliding, STICTION)
    directions = sliding / speeds
    # pushes grow where pulls fall
    turns = scratch.first.borders.turn.reshape(sliding.shape)
    signs = np.sign(tension)[:, None]
    turned = np.cumsum(signs * turns * directions, axis=1)
    at_actuators = tension[:, None]
    left = at_actuators * np.exp(-turned)
    falls = np.diff(left, axis=1, prepend=at_actuators)
    return np.einsum("ik,ikn->n", falls, rows)


def rates_after(matrices, force):
    """Rates (n,) at the end of an implicit step of length H from Q and RATES."""
    _, v = substep(matrices, force, Q, RATES, H)
    return v


@pytest.mark.parametrize("changes", [{}, BENDING], ids=["statics", "explicit"])
@pytest.mark.parametrize("push", [1.0, -1.0], ids=["pulled", "pushed"])
def test_tendons_that_rub_fall_by_the_rates_of_a_step_s_end(changes, push):
    """A dv = h (f + sum_k (T_k - T_k-1) w_k - h G v), T_k = T exp(-sign T sum mu dphi z) with z =
    v_k / sqrt(v_k^2 + v_s^2), the rates v_k = w_k v' of the end."""
    model = arm_with({**changes, **RUBBING})
    tension = push * TENSION
    scratch, attempt = step_with(model, 1, command=tension)
    assert attempt.status == OK
    smooth = arm_with(changes)
    *matrices, force = linear_system(smooth, Q, RATES, tension)
    friction = friction_of(scratch, model, tension)
    least = 0.01 * np.abs(force).max()
    assert np.abs(friction).max() > least
    v = rates_after(matrices, force + friction)
    atol = 1e-5 * np.abs(v).max()
    np.testing.assert_allclose(scratch.v, v, rtol=1e-5, atol=atol)
    expected_q = Q + H * scratch.v
    np.testing.assert_allclose(scratch.q, expected_q, rtol=1e-12)


def test_elastic_tendons_that_rub_have_their_tensions_at_a_step_s_end():
    """x = clip(k (u - s - h y), 0, strength) with the rates y = w_0 v' at their actuators, and what
    is left of it beyond."""
    stretch = np.array([4e-4, 2e-2, -2e-3])
    model = arm_with({**SPRINGS, **RUBBING})
    path = model.arm.effects.transmission
    shortening = path.length - model.tendon_lengths(Q)
    scratch, attempt = step_with(model, 1, command=shortening + stretch)
    assert attempt.status == OK
    pulled_in = border_rows(scratch, model)[:, 0] @ scratch.v
    stretched = stretch - H * pulled_in
    taut = path.stiffness * stretched
    tension = np.clip(taut, 0.0, path.strength)
    np.testing.assert_allclose(scratch.ends.tension, tension, rtol=1e-6, atol=1e-6)
    # the explicit rod's stiffness has that of the tensions at the beginning in it
    begun = np.clip(path.stiffness * stretch, 0.0, path.strength)
    smooth = arm_with(BENDING)
    *matrices, force = linear_system(smooth, Q, RATES, begun)
    B = smooth.terms(Q, RATES).actuation
    changed = B @ (tension - begun)
    friction = friction_of(scratch, model, tension)
    v = rates_after(matrices, force + changed + friction)
    atol = 1e-5 * np.abs(v).max()
    np.testing.assert_allclose(scratch.v, v, rtol=1e-5, atol=atol)


@kernel
def decays_of(x, most, out):
    store(out, 0, decays(load(x, 0), most))


@pytest.mark.parametrize("most", [0.999 * SMALL_TURN, 1.001 * SMALL_TURN, 2.0])
def test_a_decay_is_the_exponential(most):
    """By its series and beyond, of tensions that fall and rise."""
    exponents = aligned_zeros(LANES)
    exponents[:] = most, 1e-9, -0.3 * most, -most
    found = aligned_zeros(LANES)
    decays_of(exponents, most, found)
    expected = np.exp(-exponents)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
def test_extrapolation_is_exact_for_polynomials_of_the_step(rows):
    """Values a + b h + c h^2 .. at h = 1, 1/2, 1/3 ..: as many powers as there are columns."""
    rng = np.random.default_rng(0)
    coefficients = rng.normal(size=(rows, 2))
    table = np.zeros((rows, rows, 2))
    error = np.zeros(2)
    for row in range(rows):
        h = 1.0 / (row + 1)
        powers = h ** np.arange(rows)[:, None]
        value = (coefficients * powers).sum(axis=0)
        other = max(row - 1, 0)
        extrapolate(row, row, other, table, value, error)
        entry = table[row, other]
        np.testing.assert_allclose(error, value - entry)
    np.testing.assert_allclose(value, coefficients[0], atol=1e-12)


@pytest.mark.parametrize("rows", [1, 2, 3, 6])
def test_noise_of_substeps_grows_in_the_last_entry_beside_its_estimate(rows):
    """Independent errors of one substep, 1/j of the step, in every first entry."""
    noise = np.diag(1.0 / np.arange(1, rows + 1))
    table = np.zeros((rows, rows, rows))
    error = np.zeros(rows)
    for row in range(rows):
        value = noise[row].copy()
        extrapolate(row, row, max(row - 1, 0), table, value, error)
    expected = 1.0
    if rows > 1:
        expected = np.linalg.norm(value) / np.linalg.norm(error)
    assert growth_of_noise(rows) == pytest.approx(expected)


def test_directions_that_turn_within_a_step_count_in_its_error():
    """By the logarithm of a tension, sum mu dphi |z - z_before|; not where an elastic tendon has a
    kink, of which the first entry is kept."""
    model = arm_with({**BENDING, **RUBBING})
    arm = model.arm
    scratch, attempt = step_with(model, 2)
    sliding = scratch.sliding
    sliding.direction[:] = 1.0
    keep_directions(arm, sliding)
    assert step_error(arm, attempt, scratch) == attempt.error
    sliding.direction[:] = -0.5
    find_turned(arm, scratch.first.borders, sliding)
    turns = scratch.first.borders.turn.reshape(model.tendon_count, -1)
    most = turns.sum(axis=1).max()
    assert sliding.turned[0] == pytest.approx(1.5 * most)
    assert sliding.turned[0] > TURNED
    larger = growth_of_noise(2) * attempt.error
    assert step_error(arm, attempt, scratch) == pytest.approx(larger)
    assert step_error(arm_with(BENDING).arm, attempt, scratch) == attempt.error
    scratch.kink[0] = KINKED
    assert step_error(arm, attempt, scratch) == attempt.error


@pytest.mark.parametrize("kink", [SMOOTH, KINKED])
def test_kinks_are_not_extrapolated(kink):
    scratch = make_scratch(arm_with(BENDING).arm, 2)
    scratch.kink[0] = kink
    first = np.array([1.0, 2.0, 3.0])
    second = np.array([1.5, 2.0, 2.5])
    for row, value in enumerate((first, second)):
        scratch.q[:] = value
        scratch.v[:] = -value
        complete_row(row, scratch)
    extrapolated = 2.0 * second - first
    kept = second
    other = extrapolated
    if kink == SMOOTH:
        kept = extrapolated
        other = second
    np.testing.assert_allclose(scratch.q, kept)
    np.testing.assert_allclose(scratch.v, -kept)
    np.testing.assert_allclose(scratch.error_q, kept - other)


def test_the_error_is_the_root_mean_square_displacement_of_the_rod():
    """sqrt(e^T M e / m), at once or by the rates within the horizon; none of what is not finite."""
    model = arm_with(BENDING)
    scratch, _ = step_with(model, 1)
    mass = model.arm.rod.mass[0]
    M = scratch.work.matrices.M
    of_q = np.array([0.1, -0.2, 0.3])
    of_v = np.array([30.0, 5.0, -2.0])
    for error_q, error_v, horizon in ((of_q, 0.0 * of_v, H), (0.0 * of_q, of_v, 0.7)):
        scratch.error_q[:] = error_q
        scratch.error_v[:] = error_v
        status, error = error_estimate(model.arm.rod, horizon, scratch)
        mean_square = error_q @ M @ error_q / mass
        moved = np.sqrt(mean_square)
        mean_square_rate = error_v @ M @ error_v / mass
        moving = horizon * np.sqrt(mean_square_rate)
        assert status == OK
        expected_error = max(moved, moving)
        assert error == pytest.approx(expected_error)
    scratch.v[1] = np.nan
    assert error_estimate(model.arm.rod, H, scratch) == (NOT_FINITE, np.inf)


def test_columns_end_where_the_tolerance_is_met_or_out_of_reach():
    model = arm_with({})
    motion = motion_of(model)
    method = Extrapolated(5, 2, True, False, 1e-12)
    errors = []
    rows = []
    for tolerance in (1.0, 1e-8, 1e-30):
        scratch = make_scratch(model.arm, 5)
        attempt = extrapolated_step(
            model.arm, method, Demand(tolerance, 2, H), TENSION, motion, H, scratch
        )
        errors.append(attempt.error)
        rows.append(attempt.rows)
        assert (attempt.status == OK) == (attempt.error <= tolerance)
        substeps = attempt.rows * (attempt.rows - 1) // 2
        assert attempt.evaluations == 1 + substeps
    assert rows[0] == 2
    assert rows[0] < rows[1]
    assert attempt.status == INACCURATE
    assert attempt.rows < 5, "what is hopeless is given up"
    assert attempt.error > HOPELESS * 1e-30
    assert errors[1] < errors[0]


def test_strains_ahead_are_predicted_to_second_order_along_the_motion():
    """And to first order beside it, of tendons that wind."""
    scene = load_scene("paper")
    model = model_on(scene, 1)
    q = np.linspace(1.0, 10.0, 10)
    q_dot = np.linspace(-3.0, 2.0, 10)
    beside = np.cos(np.arange(10.0))
    work = make_workspace(model.arm)
    work.strain.xi[:] = start = model.packed_strain(q)
    row = evaluate(model.arm, np.zeros(10), q, q_dot, 1e-12, work)
    assert row == -1
    for direction, order in ((q_dot, 3), (beside, 2)):
        errors = []
        for time in (2.0, 1.0):
            ahead = q + time * direction
            work.strain.xi[:] = start
            predict_strain(model.arm.strain, ahead, q, work.strain, work.spare.stress)
            difference = work.strain.xi - model.packed_strain(ahead)
            errors.append(np.abs(difference).max())
        assert np.log2(errors[0] / errors[1]) > order - 0.3
    assert errors[0] > 1e-3


def test_steps_follow_the_error_and_the_limits():
    control = Control(0.02, 1e-4, True, 1e-6, 0.03)
    assert next_step(control._replace(adaptive=False), 3, 1e-3, Attempt(OK, 2, 2, 1.0, 2)) == 2e-3
    grown = next_step(control, 3, 1e-3, Attempt(OK, 3, 4, LEAST_ERROR, 3))
    assert grown == pytest.approx(4e-3)
    shrunk = next_step(control, 3, 1e-3, Attempt(INACCURATE, 3, 4, 1e9, 3))
    assert shrunk == pytest.approx(0.2e-3)
    none = Limits(np.inf, False)
    assert step_length(0.02, 0.05, none) == 0.02
    assert step_length(0.02, 0.02 * (1 + 1e-12), none) == 0.02 * (1 + 1e-12)
    assert step_length(0.02, 0.01, none) == 0.01
    assert step_length(0.02, 0.05, Limits(0.003, True)) == 0.003
    equal = step_length(0.02, 0.05, Limits(0.015, False))
    assert equal == pytest.approx(0.05 / 4)
    model = arm_with(BENDING)
    rough = ROUGH * model.length
    touching = while_touching(model.arm, control)
    assert touching.tolerance == pytest.approx(min(1e-4, rough))
    expected = 0.03 * touching.tolerance / rough
    assert touching.horizon == pytest.approx(expected)
    assert touching.adaptive
    assert touching.step == 0.02
    assert touching.smallest == 1e-6


@pytest.mark.parametrize("part", [0.0, 0.6])
def test_the_balance_at_rest_has_its_rate_and_its_slopes(part):
    """f = part (B u + F) - K, by differences of the terms."""
    model = arm_with(FLUID)
    n = 3
    rows = [[1.0, 0.0, 0.0], [0.3, -0.7, 0.2]]
    directions = np.array(rows)
    no_matrix = np.empty((n, n))
    no_columns = np.empty((n, 2))
    out = Linearisation(np.empty(n), no_matrix, np.empty(n), no_columns)
    work = make_workspace(model.arm)
    done = linearise_balance(model.arm, TENSION, Q, part, True, directions, work, out)
    assert done == (-1, 1.0)

    def balance(q, part):
        terms = model.terms(q, np.zeros(n))
        load = terms.actuation @ TENSION + terms.external_force
        return part * load - terms.elastic_force

    expected_force = balance(Q, part)
    np.testing.assert_allclose(out.force, expected_force, rtol=1e-9, atol=1e-12)
    rate = balance(Q, 1.0) - balance(Q, 0.0)
    np.testing.assert_allclose(out.rate, rate, rtol=1e-9, atol=1e-12)
    stiffness = model.terms(Q, np.zeros(n)).stiffness
    np.testing.assert_allclose(out.G, stiffness, rtol=1e-9)
    h = 1e-5
    for direction, slope in zip(directions, out.slopes.T, strict=True):
        before = balance(Q - h * direction, part)
        after = balance(Q + h * direction, part)
        expected = (before - after) / (2 * h)
        atol = 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=atol)


def random_poses(rng, shape):
    poses = np.tile(np.eye(4), (*shape, 1, 1))
    count = np.prod(shape)
    twists = rng.normal(size=(int(count), 1, 6))
    flat = poses.reshape(-1, 4, 4)
    repeats = (len(flat), 1, 1, 1)
    moved = np.tile(np.eye(4), repeats)
    move_poses(flat, twists, moved)
    return moved.reshape(*shape, 4, 4)


def test_moved_poses_undo_errors_and_cotangents_are_differences():
    rng = np.random.default_rng(0)
    pose = random_poses(rng, (2,))
    goal = random_poses(rng, (2, 3))
    error = np.empty((2, 3, 6))
    back = np.tile(np.eye(4), (2, 3, 1, 1))
    pose_errors(pose, goal, error)
    move_poses(pose, error, back)
    np.testing.assert_allclose(back, goal, atol=1e-12)
    cotangent = rng.normal(size=error.shape)
    by_pose = np.empty_like(error)
    by_goal = np.empty_like(error)
    pose_error_cotangents(error, cotangent, by_pose, by_goal)
    h = 1e-6
    for row in range(2):
        for j in range(3):
            one_pose = pose[row : row + 1]
            one_goal = goal[row : row + 1, j : j + 1]
            for k, unit in enumerate(h * np.eye(6)):
                moves = np.array([[unit, -unit]])
                poses, goals = np.tile(np.eye(4), (2, 1, 2, 1, 1))
                move_poses(one_pose, moves, poses)
                move_poses(one_goal[0], moves, goals)
                ends = np.empty((2, 2, 1, 6))
                for side in range(2):
                    alone = slice(side, side + 1)
                    pose_errors(poses[:, side], one_goal, ends[0, alone])
                    pose_errors(one_pose, goals[:, alone], ends[1, alone])
                change = ends[:, 0, 0] - ends[:, 1, 0]
                slopes = change / (2 * h)
                expected = slopes @ cotangent[row, j]
                assert by_pose[row, j, k] == pytest.approx(expected[0], abs=1e-8)
                assert by_goal[row, j, k] == pytest.approx(expected[1], abs=1e-8)
