"""Equation of motion (23) at one state, phase by phase: strains, poses, mass matrix, bias, external force."""

import numpy as np

from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms import explicit, learned, loaded, statics_based  # noqa: F401  (they register themselves)
from soft_tendon_env.mechanics.terms.dynamics import bias_force, mass_matrix
from soft_tendon_env.mechanics.terms.kinematics import poses, sweep
from soft_tendon_env.mechanics.terms.loads import external_force, place_base, rest_states
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_from_rest, strain_loads, strain_stage
from soft_tendon_env.tools.compilation import kernel


@kernel
def configure(arm, q, tolerance, work):
    """Configuration of the rod at q: poses, and the strain that Newton finds from the stress-free rod or else strain_from_rest().

    A motion may come to coordinates whose parts have no strain, where tendons push.
    """
    place_base(arm, work)
    copy(arm.rod.reference_strain, work.xi)
    failed, reached = strain_from_guess(arm, q, tolerance, work), 1.0
    if failed >= 0:
        failed, reached = strain_from_rest(arm, q, tolerance, work)
    poses(arm.rod, work)
    return failed, reached


@kernel
def configure_from_rest(arm, q, tolerance, work):
    """Strain and poses at q on the branch that begins at the stress-free rod; as strain_from_rest()."""
    place_base(arm, work)
    found = strain_from_rest(arm, q, tolerance, work)
    poses(arm.rod, work)
    return found


@kernel
def evaluate_rod(arm, u, q, q_dot, tolerance, work):
    """All terms of (23) at (q, q_dot, u) but the effects', left in `work`; -1, or the block at which the strain could not be found."""
    failed = strain_stage(arm, u, q, q_dot, tolerance, work)
    if failed >= 0:
        return failed
    strain = arm.strain
    poses(arm.rod, work)
    sweep(arm.rod, strain, work)
    mass_matrix(arm.rod, strain, work)
    bias_force(arm.rod, strain, work)
    strain_loads(arm, work)
    return -1


@kernel
def evaluate(arm, u, q, q_dot, tolerance, work):
    """All terms of (23) at (q, q_dot, u), with the effects at work.state and work.clock; as evaluate_rod(). See work.driven for u."""
    place_base(arm, work)
    failed = evaluate_rod(arm, u, q, q_dot, tolerance, work)
    if failed < 0 and arm.effects.count > 0:  # without any, work.load stays the zero that it is
        external_force(arm, work)
    return failed


@kernel
def evaluate_at_rest(arm, u, q, tolerance, work):
    """All terms of (23) at (q, 0, u), u the tensions; the base and the states of the effects at rest there too; as evaluate_rod()."""
    work.driven[0] = 0.0
    place_base(arm, work)
    work.base[12:] = 0.0
    failed = evaluate_rod(arm, u, q, np.zeros(q.size), tolerance, work)
    if failed < 0 and arm.effects.count > 0:
        rest_states(arm, u, work)
        external_force(arm, work)
    return failed
