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
def _write_growth(weight, free, memory, x, pack, column, stride):
    """Displacement weight W x over the intervals of a pack by a solution x, into a column of the growth."""
    w, W = load(weight, 2 * pack * LANES), memory.W[pack]
    for k in range(6):
        total = spread(0.0)
        for i in range(2 * len(free)):
            total = total + load(W, (i * 6 + k) * LANES) * load(x, i * LANES)
        total = w * total
        for own in range(LANES):
            memory.growth[((pack * LANES + own) * 6 + k) * stride + column] = lane(total, own)


@kernel(inline=True)
def _gather(field, at, step):
    """Pack of the numbers of its nodes, which lie `step` apart."""
    found = spread(field[at])
    for own in range(1, LANES):
        found = with_lane(found, own, field[at + own * step])
    return found


@kernel(inline=True)
def _answer_of(free, memory, pack, column, stride):
    """Strains A p by the wrenches p that answer, of a column, at the two points of the intervals of a pack."""
    at, step, p, A, x = (pack * LANES * 6) * stride + column, 6 * stride, memory.answer, memory.A[pack], memory.six[0]
    p_0, p_1, p_2 = _gather(p, at, step), _gather(p, at + stride, step), _gather(p, at + 2 * stride, step)
    at += 3 * stride
    p_3, p_4, p_5 = _gather(p, at, step), _gather(p, at + stride, step), _gather(p, at + 2 * stride, step)
    for i in range(2 * len(free)):
        own = i * LANES
        total = load(A[0], own) * p_0 + load(A[1], own) * p_1 + load(A[2], own) * p_2
        total = total + load(A[3], own) * p_3 + load(A[4], own) * p_4
        store(x, own, total + load(A[5], own) * p_5)
    return read_rows(x, 0, free), read_rows(x, 1, free)


@kernel
def solve_hessian(weight, free, memory):
    """Solves H x = rhs in place, for one field."""
    packs, m = weight.size // (2 * LANES), 2 * len(free)
    memory.growth[: packs * LANES * 6 * LANES] = 0.0
    for pack in range(packs):
        x = memory.rhs[pack]
        ldl_solve(memory.R[pack], m, x)
        _write_growth(weight, free, memory, x, pack, 0, LANES)
    solve_riccati(packs, memory, LANES, LANES)
    for pack in range(packs):
        x = memory.rhs[pack]
        first, second = _answer_of(free, memory, pack, 0, LANES)
        write_rows(twist_sum(read_rows(x, 0, free), first), 0, free, x)
        write_rows(twist_sum(read_rows(x, 1, free), second), 1, free, x)


@kernel
def factorise_hessian(rod, tendons, strain, q, part, work):
    """Residual and Hessian at work.xi, factorised; -1, the block of an interval that gives way, or 2 packs where the arm buckles."""
    loads, memory = strain.loads, work.under_loads
    poses(rod, work)
    total_loads(rod.node_mass, loads, part, work.pose, memory)
    assemble_hessian(rod, tendons, strain.law, q, work)
    least, pack = factorise_intervals(rod.weight, rod.free, memory)
    if not least > 0.0:
        return 2 * pack
    response = factorise_riccati(rod.node_mass, loads, part, work.pose, memory)
    if not response > 0.0:
        return 2 * rod.packs
    memory.softest[0] = min(least, response)
    return -1


@kernel(inline=True)
def press(root_compliance, free, field, at, pack, out):
    """Right-hand side of a wrench field of one pack: C^1/2 times it."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        write_rows(scaled(c, load6(field, at + z * 6 * LANES)), z, free, out)


@kernel(inline=True)
def release(root_compliance, free, x, pack, field, at):
    """Strain field of a solution of one pack: C^1/2 times it."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        store6(field, at + z * 6 * LANES, scaled(c, read_rows(x, z, free)))


@kernel(inline=True)
def _solve_six_columns(rod, law, Phi, memory, pack, begin, end):
    """From wrenches in Phi to strains, in place, and the growth, of up to SIX columns of begin..end-1, those that load a pack."""
    count, of, six, stride = 0, rod.root_compliance, memory.six, row_stride(law.size)
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            press(of, rod.free, Phi, (j * rod.packs + pack) * 12 * LANES, pack, six[count])
            count += 1
    ldl_solve_six(memory.R[pack], 2 * len(rod.free), six)
    count = 0
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            _write_growth(rod.weight, rod.free, memory, six[count], pack, j, stride)
            release(of, rod.free, six[count], pack, Phi, (j * rod.packs + pack) * 12 * LANES)
            count += 1


@kernel
def columns_under_loads(rod, law, Phi, memory):
    """Columns H^-1 Phi_w from the wrenches Phi_w in Phi, in place, with all that follows from the loads."""
    n, packs, stride = law.size, rod.packs, row_stride(law.size)
    memory.growth[:] = 0.0
    for pack in range(packs):
        begin, count = 0, 0
        for j in range(n):
            if law.first[j] <= pack < law.last[j]:
                count += 1
            if count == SIX or (j == n - 1 and count > 0):
                _solve_six_columns(rod, law, Phi, memory, pack, begin, j + 1)
                begin, count = j + 1, 0
    solve_riccati(packs, memory, stride, stride)
    for pack in range(packs):
        c_1, c_2 = load6(rod.root_compliance, 2 * pack * 6 * LANES), load6(rod.root_compliance, (2 * pack + 1) * 6 * LANES)
        for j in range(n):
            at = (j * packs + pack) * 12 * LANES
            phi_1, phi_2 = _answer_of(rod.free, memory, pack, j, stride)
            store6(Phi, at, twist_sum(load6(Phi, at), scaled(c_1, phi_1)))
            store6(Phi, at + 6 * LANES, twist_sum(load6(Phi, at + 6 * LANES), scaled(c_2, phi_2)))
