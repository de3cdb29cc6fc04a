"""Solution of H x = b for the Hessian of the energy under dead loads: interval blocks (interval_hessian) and Riccati recursion.

The intervals are solved on their own; the loads answer to the displacements that this makes (load_riccati), and the answer strains the
intervals by A = R^-1 W^T once more.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, load, spread, store, with_lane
from soft_tendon_env.mechanics.algebra.lie import twist_sum
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.packed_ldl import SIX, ldl_solve, ldl_solve_six
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, scaled, store6
from soft_tendon_env.mechanics.terms.interval_hessian import assemble_hessian, factorise_intervals, read_rows, write_rows
from soft_tendon_env.mechanics.terms.kinematics import poses
from soft_tendon_env.mechanics.terms.load_riccati import factorise_riccati, solve_riccati, total_loads


@kernel(inline=True)
def _write_growth(weight, free, places, memory, x_at, pack, column, stride):
    """weight W x of a solution of the intervals that begins at x_at, into a column of the growth."""
    w, W_at = load(weight, 2 * pack * LANES), places.W + pack * 72 * LANES
    for k in range(6):
        total = spread(0.0)
        for i in range(2 * len(free)):
            total = total + load(memory, W_at + (i * 6 + k) * LANES) * load(memory, x_at + i * LANES)
        total = w * total
        for own in range(LANES):
            memory[places.growth + ((pack * LANES + own) * 6 + k) * stride + column] = lane(total, own)


@kernel(inline=True)
def _gather(memory, at, step):
    """The numbers of a pack's nodes, `step` apart."""
    found = spread(memory[at])
    for own in range(1, LANES):
        found = with_lane(found, own, memory[at + own * step])
    return found


@kernel(inline=True)
def _answer_of(free, places, memory, pack, column, stride):
    """A p of a column at the two points of the intervals of a pack."""
    at, step, A_at = places.answer + (pack * LANES * 6) * stride + column, 6 * stride, places.A + pack * 72 * LANES
    p_0, p_1, p_2 = _gather(memory, at, step), _gather(memory, at + stride, step), _gather(memory, at + 2 * stride, step)
    at += 3 * stride
    p_3, p_4, p_5 = _gather(memory, at, step), _gather(memory, at + stride, step), _gather(memory, at + 2 * stride, step)
    for i in range(2 * len(free)):
        own = A_at + i * LANES
        total = load(memory, own) * p_0 + load(memory, own + 12 * LANES) * p_1 + load(memory, own + 24 * LANES) * p_2
        total = total + load(memory, own + 36 * LANES) * p_3 + load(memory, own + 48 * LANES) * p_4
        store(memory, places.six + i * LANES, total + load(memory, own + 60 * LANES) * p_5)
    return read_rows(memory, places.six, 0, free), read_rows(memory, places.six, 1, free)


@kernel
def solve_hessian(weight, free, places, memory):
    """Solve H x = pressed in place, for one field."""
    packs, m = weight.size // (2 * LANES), 2 * len(free)
    memory[places.growth : places.growth + packs * LANES * 6 * LANES] = 0.0
    for pack in range(packs):
        x_at = places.pressed + pack * 12 * LANES
        ldl_solve(memory, places.R + pack * 78 * LANES, m, memory, x_at)
        _write_growth(weight, free, places, memory, x_at, pack, 0, LANES)
    solve_riccati(packs, places, memory, LANES, LANES)
    for pack in range(packs):
        x_at = places.pressed + pack * 12 * LANES
        first, second = _answer_of(free, places, memory, pack, 0, LANES)
        write_rows(twist_sum(read_rows(memory, x_at, 0, free), first), 0, free, memory, x_at)
        write_rows(twist_sum(read_rows(memory, x_at, 1, free), second), 1, free, memory, x_at)


@kernel
def factorise_hessian(rod, tendons, strain, q, part, work):
    """Residual and Hessian at work.xi, factorised; -1, the block of an interval that gives way, or 2 packs where the arm buckles."""
    places, loads, memory = strain.places, strain.loads, work.memory
    poses(rod, work)
    total_loads(rod.node_mass, loads, part, work.pose, places, memory)
    assemble_hessian(rod, tendons, strain.law, places, q, work)
    least, pack = factorise_intervals(rod.weight, rod.free, places, memory)
    if not least > 0.0:
        return 2 * pack
    response = factorise_riccati(rod.node_mass, loads, part, work.pose, places, memory)
    if not response > 0.0:
        return 2 * rod.packs
    memory[places.softest] = min(least, response)
    return -1


@kernel(inline=True)
def press(root_compliance, free, field, at, pack, out, out_at):
    """C^1/2 times a wrench field of one pack as a right-hand side."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        write_rows(scaled(c, load6(field, at + z * 6 * LANES)), z, free, out, out_at)


@kernel(inline=True)
def release(root_compliance, free, x, x_at, pack, field, at):
    """C^1/2 times a solution as a strain field of one pack."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        store6(field, at + z * 6 * LANES, scaled(c, read_rows(x, x_at, z, free)))


@kernel(inline=True)
def _solve_six_columns(rod, law, places, Phi, memory, pack, begin, end):
    """From wrenches in Phi to strains, in place, and the growth, of up to SIX columns of begin..end-1, those that load a pack."""
    at, of, stride = places.six, rod.root_compliance, row_stride(law.size)
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            press(of, rod.free, Phi, (j * rod.packs + pack) * 12 * LANES, pack, memory, at)
            at += 12 * LANES
    ldl_solve_six(memory, places.R + pack * 78 * LANES, 2 * len(rod.free), memory, places.six, 12 * LANES)
    at = places.six
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            _write_growth(rod.weight, rod.free, places, memory, at, pack, j, stride)
            release(of, rod.free, memory, at, pack, Phi, (j * rod.packs + pack) * 12 * LANES)
            at += 12 * LANES


@kernel
def columns_under_loads(rod, law, places, Phi, memory):
    """Columns H^-1 Phi_w from the wrenches Phi_w in Phi, in place, with all that follows from the loads."""
    n, packs, stride = law.size, rod.packs, row_stride(law.size)
    memory[places.growth : places.growth + packs * LANES * 6 * stride] = 0.0
    for pack in range(packs):
        begin, count = 0, 0
        for j in range(n):
            if law.first[j] <= pack < law.last[j]:
                count += 1
            if count == SIX or (j == n - 1 and count > 0):
                _solve_six_columns(rod, law, places, Phi, memory, pack, begin, j + 1)
                begin, count = j + 1, 0
    solve_riccati(packs, places, memory, stride, stride)
    for pack in range(packs):
        c_1, c_2 = load6(rod.root_compliance, 2 * pack * 6 * LANES), load6(rod.root_compliance, (2 * pack + 1) * 6 * LANES)
        for j in range(n):
            at = (j * packs + pack) * 12 * LANES
            phi_1, phi_2 = _answer_of(rod.free, places, memory, pack, j, stride)
            store6(Phi, at, twist_sum(load6(Phi, at), scaled(c_1, phi_1)))
            store6(Phi, at + 6 * LANES, twist_sum(load6(Phi, at + 6 * LANES), scaled(c_2, phi_2)))
