"""Residual r of the equation that a substep solves for a known change a of the rates, contracted before it is projected.

r = (M + h D + h^2 G) a - w (f + h (drift - G v)), w = h. No matrix is formed and no Jacobian:
M a / w + C v is the inertial wrench of the motion whose acceleration is a / w, as in the recursive Newton-Euler algorithm (R. Featherstone,
Rigid Body Dynamics Algorithms, 2008, chapter 5), D a and G c, c = h a + w v, are stresses; the wrenches become stresses in one sweep from
tip to base, and all stresses a force in one projection.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.lie import twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import apply21, load6, store6
from soft_tendon_env.mechanics.late_kernels import call_late
from soft_tendon_env.mechanics.terms.dynamics import inertial_wrench
from soft_tendon_env.mechanics.terms.external_forces import advance_states, effect_loads, filled_packs
from soft_tendon_env.mechanics.terms.kinematics import node_displacements, node_twists, sweep
from soft_tendon_env.mechanics.terms.parametrisation import (
    strain_force,
    strain_has_potential,
    strain_matrices,
    strain_rate,
    strain_stiffen,
)
from soft_tendon_env.mechanics.terms.tendons import tendon_forces
from soft_tendon_env.mechanics.terms.transmission import held_tension
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_tendon_stress, add_wrench_stress


@kernel
def add_scaled(share, field, out):
    """Adds a field times a number to out, pack by pack."""
    for m in range(0, out.size, LANES):
        store(out, m, load(out, m) + share * load(field, m))


@kernel
def add_weighed(diagonal, field, out):
    """Adds a field times a diagonal, component by component, to out."""
    for m in range(0, out.size, LANES):
        store(out, m, load(out, m) + load(diagonal, m) * load(field, m))


@kernel
def write_residuals(arm, stiffens, own, v, scratch, difference, response):
    """Writes r of the substeps `own` that begin at an evaluation which has left strain, its rate and bias, mismatch and poses in work; the
    rod's D and G with it where it `stiffens`, v (n) then the rates in G v."""
    work, fields, course = scratch.work, difference.residual, difference.course
    copy(work.xi_dot, fields.rate)
    copy(work.xi_bias, fields.bias)
    for k in own:
        equation, out = course.equation[k], response[k, : v.size]
        rate_along(arm, course.change[k], work, fields)
        copy(fields.bias, work.xi_bias)
        add_scaled(equation[1] / equation[2], fields.along, work.xi_bias)
        sweep(arm.rod, arm.strain, 0, work)
        if k == own[0]:
            hold_loads(arm, work, fields)
        copy(fields.load, fields.stress)
        if equation[1] != 0.0:
            inertial_wrench(arm.rod, work)
        else:
            work.wrench[:] = 0.0
        add_scaled(-1.0, fields.wrench, work.wrench)
        if stiffens and equation[0] > 0.0:
            add_rod_share(arm, equation, course.change[k], v, work, fields)
        if arm.effects.count > 0 and equation[0] > 0.0:
            add_effects_share(arm, equation, work, fields)
            add_tendon_share(arm, equation, course.part[k], work, fields)
        add_wrench_stress(arm.rod, work.wrench, work, fields.stress)
        write_force(arm, equation[2], fields.stress, work, out)
        if stiffens:
            add_mirrored(arm, equation[0], course.change[k], work, out)
    copy(fields.bias, work.xi_bias)


@kernel
def write_kept_residual(arm, equation, a, v, scratch, fields, out):
    """Writes the share of the rod's D and G in r into out (n)."""
    work = scratch.work
    copy(work.xi_dot, fields.rate)
    rate_along(arm, a, work, fields)
    fields.stress[:] = 0.0
    add_rod_share(arm, equation, a, v, work, fields)
    write_force(arm, equation[2], fields.stress, work, out)
    add_mirrored(arm, equation[0], a, work, out)


@kernel
def add_mirrored(arm, h, a, work, out):
    """Adds what the upper triangle of G in place of the lower one, which is all that the linear system reads, makes of h^2 G a."""
    if strain_has_potential(arm):
        return
    strain_matrices(arm, work)
    for i in range(a.size):
        for j in range(i):
            out[i] += h * h * (work.G[j, i] - work.G[i, j]) * a[j]


@kernel
def write_force(arm, share, stress, work, out):
    """Writes the generalised force of a stress field with the weights in it, times a number, into out (n)."""
    strain_force(arm, stress, work, out)
    for i in range(out.size):
        out[i] *= share


@kernel
def rate_along(arm, x, work, fields):
    """Strain rates Phi x into fields.along; work.xi_dot stays."""
    strain_rate(arm, x, work)
    copy(work.xi_dot, fields.along)
    copy(fields.rate, work.xi_dot)


@kernel
def hold_loads(arm, work, fields):
    """Stress that drives the coordinates, damping included, and the effects' stresses into fields.load, with the sign of r; wrenches of
    effects into fields.wrench."""
    fields.load[:] = 0.0
    fields.wrench[:] = 0.0
    add_weighed(arm.rod.viscosity, work.xi_dot, fields.load)
    add_scaled(-1.0, work.mismatch, fields.load)
    if arm.effects.count > 0:
        wrenches, stresses = effect_loads(arm, work)
        if wrenches:
            add_scaled(1.0, work.wrench, fields.wrench)
        if stresses:
            add_scaled(-1.0, work.stress, fields.load)


@kernel
def add_rod_share(arm, equation, a, v, work, fields):
    """Adds the stress of D a + G c of the rod, Phi a in fields.along."""
    for i in range(v.size):
        fields.combined[i] = equation[0] * a[i] + equation[2] * v[i]
    add_weighed(arm.rod.viscosity, fields.along, fields.stress)
    strain_stiffen(arm, fields.combined, work, fields.end)
    add_scaled(1.0, fields.end, fields.stress)


@kernel
def add_effects_share(arm, equation, work, fields):
    """Adds the stress and the wrenches of D a + G c of the effects; leaves Phi c in fields.end."""
    effects, wrenches, stresses = arm.effects, False, False
    for i in range(effects.count):
        wrenches, stresses = wrenches or effects.wrench[i] != 0, stresses or effects.stress[i] != 0
    fields.end[:] = 0.0
    add_scaled(equation[0], fields.along, fields.end)
    add_scaled(equation[2], fields.rate, fields.end)
    if stresses:
        add_weighed(work.point_damping, fields.along, fields.stress)
        add_weighed(work.point_stiffness, fields.end, fields.stress)
    if wrenches:
        add_displaced(arm.rod, work.node_damping, fields.along, work)
        add_displaced(arm.rod, work.node_stiffness, fields.end, work)
        copy(fields.rate, work.xi_dot)


@kernel
def add_displaced(rod, blocks, field, work):
    """Adds to work.wrench symmetric matrices (nodes x 21) times what a strain field displaces the nodes; overwrites work.xi_dot."""
    begin, end = filled_packs(blocks, 21 * LANES)
    if end == 0:
        return
    copy(field, work.xi_dot)
    node_displacements(rod, work)
    for pack in range(begin, end):
        at = pack * 6 * LANES
        store6(work.wrench, at, twist_sum(load6(work.wrench, at), apply21(blocks, pack * 21 * LANES, load6(work.eta, at))))


@kernel
def add_tendon_share(arm, equation, part, work, fields):
    """Adds the stress of stiff tendons: sum k B_i B_i^T c less h times their creep, and, on given parts (n_a) of the laws of those with
    bounds, of the tensions there in place of those that they have; Phi c in fields.end."""
    bounded, any_stiff = work.bounded, False
    for k in work.tendon_stiffness:
        any_stiff = any_stiff or k != 0.0
    if not any_stiff:
        return
    pull = work.tau_dot
    tendon_forces(arm.rod, arm.tendons, fields.whole, work.tangent, fields.end, pull)
    for i in range(part.size):
        k, more, own = work.tendon_stiffness[i], 0.0, bounded.part[i]
        if bounded.stiffness[i] != 0.0:
            bounded.part[i] = part[i]
            more = held_tension(bounded, i) - work.tension[i]
        if bounded.part[i] != 0.0:
            k -= bounded.stiffness[i]
        bounded.part[i] = own
        pull[i] = more + equation[0] * work.tendon_creep[i] - k * pull[i]
    add_tendon_stress(arm.rod, arm.tendons, pull, work.tangent, fields.stress)


@kernel
def write_states_after(arm, own, v, state, scratch, difference, response):
    """Writes the internal states after the substeps `own` that begin at an evaluation, where v and state may be moved."""
    work, course, n = scratch.work, difference.course, v.size
    for k in own:
        if state.size > 0 and course.equation[k, 3] > 0.0:
            for j in range(n):
                scratch.ahead[j] = course.ahead[k, j] + (v[j] - course.v[own[0], j])
            strain_rate(arm, scratch.ahead, work)
            node_twists(arm.rod, work)
            copy(state, work.state)
            call_late(advance_states, arm.effects.late, (arm, course.equation[k, 3], work))
            copy(work.state, response[k, 2 * n :])
