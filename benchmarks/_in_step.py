"""Evaluations of the equation of motion as a time step of the presets has them."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated, evaluate_force
from soft_tendon_env.mechanics.motion.implicit_euler import later_matrices
from soft_tendon_env.model.step_control import LOOSEST_STRAIN

METHOD = Extrapolated(
    6, 2, with_inertia=True, freeze_jacobian=True, strain_tolerance=LOOSEST_STRAIN
)


@kernel
def evaluate_force_often(arm, u, q, q_dot, scratch, count):
    """Evaluations at slightly different states, each strain found from the one before."""
    for _ in range(count):
        q[0] += 1e-9
        evaluate_force(arm, METHOD, u, q, q_dot, scratch.work.inputs.state, 0.6, scratch)
        later_matrices(arm, METHOD, scratch)
