"""Integration method and control of step size, as a scene says them and the kernels take them."""

import numpy as np

from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.mechanics.motion.advance import Control
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.runge_kutta import RungeKutta
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import extrapolation_columns
from soft_tendon_env.tools.configuration import ConfigurationError, Problem

UNSTABLE = 0.05
"""Estimated error of one step, as displacement over the rod's length, that a step of fixed size may have."""
STRAIN_SHARE, LOOSEST_STRAIN = 2.0, 3e-6
"""Tolerance of the strain's Newton within a step, as a share of the step's over the rod's length, and the most: columns are as far off as
that, the strain by the square. With more, two ways of computing one motion, as a latency of an environment and a delay of its scene, come
apart by more than a millionth of the position error."""
EXPLICIT = 2.5
"""Steps times angular frequency up to which the explicit method is stable, with a margin: 2.83 without damping."""


def cause_of(code: int, model: Model, control: Control) -> str:
    """The message of a status. With error control, that of an estimate says which tolerance could not be met."""
    if code != status.INACCURATE or not control.adaptive:
        return status.MESSAGES[code]
    settings = f"steps of {control.smallest:.2g} s, {model.scene.integrator.max_halvings} halvings"
    return f"the estimated error is above integrator.tolerance, {control.tolerance:g} m, even with {settings}: allow more of either"


def step_method(model: Model) -> Extrapolated | RungeKutta:
    """Integration method of the scene, as the kernels take it. Raises ConfigurationError where it cannot follow stiff tendons."""
    integrator = model.scene.integrator
    if integrator.method == "runge_kutta_4":
        _check_explicit(model)
        return RungeKutta()
    columns = extrapolation_columns(model.scene)
    least = columns if integrator.tolerance is None else 2
    keeps = least < columns and not integrator.quasi_static  # without inertia D is in the place of M
    return Extrapolated(columns, least, not integrator.quasi_static, keeps, _strain_tolerance(model))


def _check_explicit(model: Model) -> None:
    """Raises ConfigurationError where an explicit step is unstable with the springs of the tendons, which are too bounded to diverge."""
    n, step = model.coordinate_count, model.scene.integrator.step
    springs = model.scene.effects.springs(np.zeros(model.tendon_count), model.length)
    if not springs.any():
        return
    terms = model.terms(np.zeros(n), np.zeros(n))
    stiffness = (terms.actuation * springs) @ terms.actuation.T
    fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(terms.mass, stiffness)).real.max())
    if step * fastest > EXPLICIT:
        text = f"is {step:g}: with tendons of {springs.max():g} N/m steps of runge_kutta_4 are stable if at most {EXPLICIT / fastest:.2g} s"
        raise ConfigurationError([Problem(("integrator", "step"), f"{text}; those of 'extrapolated' are whatever their length")])


def _strain_tolerance(model: Model) -> float:
    """Tolerance of the strain's Newton within a step."""
    allowed = model.scene.integrator.tolerance
    return STEP_TOLERANCE if allowed is None else min(max(STRAIN_SHARE * allowed / model.length, STEP_TOLERANCE), LOOSEST_STRAIN)


def step_control(model: Model, duration: float) -> Control:
    """Step control of the scene over `duration` [s]: equal steps of at most the scene's, tolerance, smallest step."""
    integrator = model.scene.integrator
    step = duration / np.ceil(duration / integrator.step * (1.0 - 1e-9))
    return Control(
        step=step,
        tolerance=UNSTABLE * model.length if integrator.tolerance is None else integrator.tolerance,
        adaptive=integrator.tolerance is not None,
        smallest=step * 0.5**integrator.max_halvings,
        horizon=0.0 if integrator.quasi_static else integrator.step,
    )
