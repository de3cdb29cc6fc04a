"""Course of an integrator step, substep by substep, and room for the derivatives of each, see differentiation."""

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import aligned
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm, Implicit, IntVector
from soft_tendon_env.mechanics.workspace import zeros_of


class Course(Struct):
    """Substeps of a step as it ran, one after the other, and what each solved."""

    q: np.ndarray  # (substeps, n) where it began
    v: np.ndarray
    state: np.ndarray  # (substeps, m)
    xi: np.ndarray  # (substeps, points x 6) guess of the strain there
    rate: np.ndarray  # (substeps, points x 6) xi_dot of the evaluation before, which effects that make tensions read
    time: np.ndarray  # (substeps) [s]
    change: np.ndarray  # (substeps, n) a
    ahead: np.ndarray  # (substeps, n) the rates at which internal states go on
    part: np.ndarray  # (substeps, n_a) parts of their laws on which tensions with bounds ended
    system: np.ndarray  # (substeps, n, n) matrix of the linear system, of which the upper triangle counts
    equation: np.ndarray  # (substeps, 4) h, the share of M and the weight of f in r, and how long internal states go on [s]


class Slopes(Struct):
    """Derivatives of substeps by their inputs: coordinates (n), rates (n), internal states (m) and commands (n_a), side by side."""

    force: np.ndarray  # (substeps, n, inputs) of r
    kept: np.ndarray  # (substeps, n, inputs) of r by the inputs at the start of the step, whose D and G are kept
    state: np.ndarray  # (substeps, m, inputs) of the internal states after it; by the rates after it in place of those before


class ResidualFields(Struct):
    """Fields of which a residual is made, see residual."""

    rate: np.ndarray  # points x 6, xi_dot
    bias: np.ndarray  # points x 6, xi_bias
    along: np.ndarray  # points x 6, Phi a
    end: np.ndarray  # points x 6, Phi c, or the stress of G c
    load: np.ndarray  # points x 6, stress that all substeps of an evaluation share
    stress: np.ndarray  # points x 6, of the substep
    wrench: np.ndarray  # nodes x 6, of loads and effects
    combined: np.ndarray  # (n) c
    whole: np.ndarray  # tendons x points, ones: the share of a tension that is everywhere


class Differences(Struct):
    """Room for the derivatives of the substeps of a step."""

    unit: np.ndarray  # (inputs) how far each input is moved to either side
    direct: int  # n_a where commands are tensions that enter through the actuation matrix alone, else 0
    course: Course
    slopes: Slopes
    response: np.ndarray  # (3, substeps, 2 n + m) r, the share of kept matrices in it, and states after: to one side, here, to the other
    place: np.ndarray  # (inputs) where a substep begins, one input moved
    own: IntVector  # (substeps) the substeps that begin at an evaluation
    later: IntVector  # (substeps) those whose D and G are kept from it
    stiffness: np.ndarray  # (n, n) the rod's G for the evaluation, or that which is kept
    Phi: np.ndarray  # coordinate x points x 6, columns there
    xi: np.ndarray  # points x 6, strain there
    J: np.ndarray  # coordinate x nodes x 6, body Jacobian there, and its derivative along the motion
    J_dot: np.ndarray
    residual: ResidualFields


def make_differences(arm: Arm, unit: np.ndarray, substeps: int) -> Differences:
    """Zeroed Differences for one arm and steps of at most so many substeps; unit (inputs,), see Differences."""
    n, n_a, m, points = arm.strain.size, arm.tendons.size, arm.effects.state.size, arm.rod.weight.size
    course = zeros_of(
        ((substeps, n), "q v change ahead"),
        ((substeps, m), "state"),
        ((substeps, points * 6), "xi rate"),
        ((substeps,), "time"),
        ((substeps, n_a), "part"),
        ((substeps, n, n), "system"),
        ((substeps, 4), "equation"),
    )
    slopes = zeros_of(((substeps, n, unit.size), "force kept"), ((substeps, m, unit.size), "state"))
    room = zeros_of(
        ((3, substeps, 2 * n + m), "response"),
        ((unit.size,), "place"),
        ((n, n), "stiffness"),
        ((n * points * 6,), "Phi"),
        ((n * points * 3,), "J J_dot"),
        ((points * 6,), "xi"),
    )
    residual = ResidualFields(
        **zeros_of(((points * 6,), "rate bias along end load stress"), ((points * 3,), "wrench"), ((n,), "combined")),
        whole=aligned(np.ones(n_a * points)),
    )
    own, later = np.zeros(substeps, dtype=np.int64), np.zeros(substeps, dtype=np.int64)
    direct = n_a if isinstance(arm.strain, Implicit) and not arm.effects.transmit else 0
    return Differences(
        unit=unit, direct=direct, course=Course(**course), slopes=Slopes(**slopes), residual=residual, own=own, later=later, **room
    )
