"""Workspace of one evaluation: the arrays that the kernels write; layout and letters as in types.py."""

import math

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LANES, LINE, aligned, aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.packed_ldl import SIX
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm, FloatVector, Loaded

PER_LINE = LINE // 8  # numbers of a cache line
ROW = 8  # numbers of a row of 6, padded to whole packs
MATRIX = 6 * ROW


def zeros_of(*shapes: tuple[tuple[int, ...], str]) -> dict[str, np.ndarray]:
    """Zeros by name, each aligned to cache lines, for pairs of a shape and the names of all arrays that have it; in one piece of memory."""
    places, end = [], 0
    for shape, names in shapes:
        size = math.prod(shape)
        for name in names.split():
            places.append((name, end, size, shape))
            end += -(-size // PER_LINE) * PER_LINE
    memory = aligned_zeros(end)
    return {name: memory[begin : begin + size].reshape(shape) for name, begin, size, shape in places}


class LoadMemory(Struct):
    """Factors and solutions of the strain under dead loads, see strain_under_loads; all but empty for other strains.

    The two points of an interval, and their free strains one after the other, make its up to 12 unknowns. A 6 x 6 matrix of a node has rows
    that are padded to 8. Fields of columns are node x 6 x columns, padded to whole packs.
    """

    e: FloatVector  # points x 6, the scaled strain
    rhs: np.ndarray  # (packs, 12 x LANES) right-hand sides of the intervals, and their solutions
    W: np.ndarray  # (packs, 12 x 6 x LANES) of the interval, see kinematics, times C^1/2 over the weight
    R: np.ndarray  # (packs, 78 x LANES) lower triangle of the interval's Hessian over the weight, then its factor
    A: np.ndarray  # (packs, 6, 12 x LANES) R^-1 W^T
    Lambda: np.ndarray  # (nodes, 48) the intervals' compliance
    total: FloatVector  # nodes x 6, wrench in the base frame of all loads from this node to the tip, and its derivatives along a motion
    total_dot: FloatVector
    total_ddot: FloatVector
    eta: FloatVector  # nodes x 6, twist in the base frame, and its derivative at xi_ddot = 0
    eta_dot: FloatVector
    start: FloatVector  # nodes x 6, the same at the starts of the intervals
    start_dot: FloatVector
    S: FloatVector  # (48) the loads' stiffness seen from a node
    K: FloatVector  # (48) the root of Lambda
    SK: FloatVector  # (48)
    B: FloatVector  # (48) the derivative of the wrench by the turn of the base
    rows: FloatVector  # 6 x 16, one matrix and another
    E: np.ndarray  # (nodes, 48) as the next: see factorise_riccati()
    ES: np.ndarray
    Pi: np.ndarray
    N: np.ndarray
    growth: FloatVector  # columns, the displacement over an interval without the loads' answer
    answer: FloatVector  # columns, the wrench that answers
    sums: FloatVector  # 6 x LANES, running sums
    six: np.ndarray  # (6, 12 x LANES) six right-hand sides and their solutions
    softest: FloatVector  # (1) the least pivot of the Hessian: 1 without loads and tensions


def make_load_memory(coordinates: int, nodes: int) -> LoadMemory:
    """Zeroed LoadMemory for so many coordinates and nodes."""
    packs = nodes // LANES
    arrays = zeros_of(
        ((12 * nodes,), "e"),
        ((packs, 12 * LANES), "rhs"),
        ((packs, 72 * LANES), "W"),
        ((packs, 78 * LANES), "R"),
        ((packs, SIX, 12 * LANES), "A"),
        ((nodes, MATRIX), "Lambda E ES Pi N"),
        ((6 * nodes,), "total total_dot total_ddot eta eta_dot start start_dot"),
        ((MATRIX,), "S K SK B"),
        ((2 * MATRIX,), "rows"),
        ((6 * nodes * row_stride(max(coordinates, 1)),), "growth answer"),
        ((6 * LANES,), "sums"),
        ((SIX, 12 * LANES), "six"),
        ((1,), "softest"),
    )
    return LoadMemory(**arrays)


class Workspace(Struct):
    """Arrays that one evaluation fills. The kernels read what the same evaluation has written, and besides:

    xi, the guess from which the Newton of the statics-based strain starts; `clock`, `state`, `before` and `since`, when effects are
    evaluated and what was before; what make_workspace() fills and nothing writes: `unit`, `base` of an
    arm that stands still, Phi of explicit strains, which are their fields, and zeros: the columns Phi, Y and J in packs where their
    coordinate moves nothing, xi_bias of explicit strains, load without effects.
    """

    tau: FloatVector  # (n_a) tensions of the strain law [N]; of explicit strains those that pull
    tau_dot: FloatVector  # (n_a)
    Phi: FloatVector  # coordinate x points x 6
    Y: FloatVector  # coordinate x points x 6, wrenches of the coordinates times the weight; explicit: Y^T Y = G
    mismatch: FloatVector  # points x 6, the stress that drives the coordinates, times the weight
    factor: FloatVector  # points x 21, L below the diagonal then 1 / D
    tangent: FloatVector  # tendon x points x 4, unit tangent t and 1 / |t_c|
    xi: FloatVector  # points x 6
    xi_dot: FloatVector  # points x 6
    xi_bias: FloatVector  # points x 6, the part of xi_ddot without q_ddot
    base: FloatVector  # 24: pose of the base, R rows and r; its twist and the rate of that, world frame, at the world's origin
    relative: FloatVector  # nodes x 12, exp(Omega) of each interval: R rows, r
    start: FloatVector  # nodes x 12, pose at the interval's start
    pose: FloatVector  # nodes x 12, pose at the interval's end
    J: FloatVector  # coordinate x nodes x 6
    carry: FloatVector  # (coordinate + 2) x 6, running sums of the sweep
    eta: FloatVector  # nodes x 6
    eta_bias: FloatVector  # nodes x 6, J_dot q_dot
    wrench: FloatVector  # nodes x 6
    node_stiffness: FloatVector  # nodes x 21, of the effects
    node_damping: FloatVector  # nodes x 21
    stress: FloatVector  # points x 6, of the effects
    point_stiffness: FloatVector  # points x 6
    point_damping: FloatVector  # points x 6
    state: FloatVector  # internal states of the effects
    before: FloatVector  # points x 6, the strain to which they belong; empty where no effect remembers it
    since: FloatVector  # (1) time since then [s]
    clock: FloatVector  # (1) time [s]
    touched: FloatVector  # (1) set to 1 where the arm touches what it came upon, see effects.Nodes
    loaded: FloatVector  # coordinate x nodes x 6, node stiffness times J
    extra: np.ndarray  # (n, n) share of the effects in D or G
    unit: FloatVector  # points x 6, ones
    M: np.ndarray  # (n, n)
    D: np.ndarray  # (n, n)
    G: np.ndarray  # (n, n)
    bias: FloatVector  # (n) C q_dot
    drive: FloatVector  # (n) B u - K - D q_dot
    u_is_command: FloatVector  # (1) 1 where u is a command, 0 where it is the tensions
    tension: FloatVector  # (n_a) [N] that come of a command, where effects are between
    shortening: FloatVector  # (n_a) [m] of elastic tendons beside the stress-free rod
    pull_rate: FloatVector  # (n_a) [m/s] at which tendons that rub are pulled in
    grip: FloatVector  # (n_a) [N] the derivative of friction by the direction of sliding, for a tendon as a whole
    columns: np.ndarray  # (n_a, n) B_i of tendons that are elastic or rub
    rubbed: np.ndarray  # (n_a, n) the same, with what friction leaves of the tension
    rubbing: np.ndarray  # (n_a, n) -d force / d direction of sliding
    share: FloatVector  # tendon x points, of the tension
    slip: FloatVector  # tendon x points, -d share / d direction of sliding
    load: FloatVector  # (n) F
    under_loads: LoadMemory  # of a strain with loads inside


def make_workspace(arm: Arm) -> Workspace:
    """Zeroed Workspace for one arm."""
    strain, n, n_a, nodes = arm.strain, arm.strain.size, arm.tendons.size, arm.rod.length.size
    points = 2 * nodes
    arrays = zeros_of(
        ((1,), "clock since touched u_is_command"),
        ((n_a,), "tau tau_dot tension shortening pull_rate grip"),
        ((n,), "bias drive load"),
        ((n, n), "M D G extra"),
        ((n_a, n), "columns rubbed rubbing"),
        ((points * 6,), "mismatch xi xi_dot xi_bias stress point_stiffness point_damping"),
        ((points * 21,), "factor"),
        ((n_a * points * 4,), "tangent"),
        ((n * points * 6,), "Y"),
        ((nodes * 6,), "eta eta_bias wrench"),
        ((nodes * 12,), "relative start pose"),
        ((nodes * 21,), "node_stiffness node_damping"),
        ((n * nodes * 6,), "J loaded"),
        (((n + 2) * 6,), "carry"),
    )
    return Workspace(
        **arrays,
        Phi=strain.columns(points),
        base=np.concatenate([np.eye(3).ravel(), np.zeros(15)]),
        state=arm.effects.state.copy(),
        unit=aligned(np.ones(points * 6)),
        share=aligned(np.ones(n_a * points)),
        slip=aligned_zeros(n_a * points),
        before=aligned_zeros(6 * points if arm.effects.remembers else 0),
        under_loads=make_load_memory(*((n, nodes) if isinstance(strain, Loaded) else (0, 0))),
    )
