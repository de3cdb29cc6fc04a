"""Integration methods: the type of `method` selects the step, extrapolated linearly implicit Euler or Runge-Kutta."""

from numba.extending import overload

from soft_tendon_env.mechanics.motion.extrapolation import extrapolated_step
from soft_tendon_env.mechanics.motion.runge_kutta import RungeKutta, runge_kutta_step


def take_step(arm, method, demand, u, motion, step, scratch):
    """Attempt one step of the method from motion to scratch.q, scratch.v. The type of `method` selects the code."""
    if isinstance(method, RungeKutta):
        return runge_kutta_step(arm, method, u, motion, step, scratch)
    return extrapolated_step(arm, method, demand, u, motion, step, scratch)


@overload(take_step)
def _take_step_overload(arm, method, demand, u, motion, step, scratch):
    if method.instance_class is RungeKutta:
        return lambda arm, method, demand, u, motion, step, scratch: runge_kutta_step(arm, method, u, motion, step, scratch)
    return lambda arm, method, demand, u, motion, step, scratch: extrapolated_step(arm, method, demand, u, motion, step, scratch)
