"""Workspace of one evaluation: the arrays that the kernels write; layout and letters as in types.py."""

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import aligned, aligned_zeros
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm, FloatVector


class Bounded(Struct):
    """Tensions that grow with the length of stiff tendons between bounds, as those of cables that hang slack at one."""

    any: FloatVector  # (1) 1 where there are such tendons, else 0
    free: FloatVector  # (n_a) [N] what the tensions would be without bounds
    stiffness: FloatVector  # (n_a) [N/m] between the bounds; 0 where a tension has none
    least: FloatVector  # (n_a) [N]
    greatest: FloatVector  # (n_a) [N]
    part: FloatVector  # (n_a) -1 at the least, 0 between, 1 at the greatest: what forces and matrices are made for


def make_bounded(tendons: int) -> Bounded:
    """Zeroed, for so many tendons."""
    return Bounded(any=aligned_zeros(1), **{name: aligned_zeros(tendons) for name in ("free", "stiffness", "least", "greatest", "part")})


class Workspace(Struct):
    """Arrays that one evaluation fills. The kernels read what the same evaluation has written, and besides:

    xi, the guess from which the Newton of the statics-based strain starts; `clock` and `state`, where and when effects are evaluated;
    xi_dot of the sample before, from which read_path() makes one; what make_workspace() fills and nothing writes: `unit`, `base` of an
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
    driven: FloatVector  # (1) 1 where u is a command, of which effects make tensions; 0 where it is the tensions
    command: FloatVector  # (n_a) that which has arrived
    tension: FloatVector  # (n_a) [N] that effects make of it
    tendon_stiffness: FloatVector  # (n_a) [N/m]
    tendon_creep: FloatVector  # (n_a) [N/s]
    bounded: Bounded  # stiff tensions within bounds
    drift: FloatVector  # (n) sum of B_i times that
    tendon_columns: np.ndarray  # (n_a, n) B_i of the stiff tendons
    share: FloatVector  # tendon x points, of the tension
    load: FloatVector  # (n) F
    memory: FloatVector  # of the strain parametrisation


def make_workspace(arm: Arm) -> Workspace:
    """Zeroed scratch for one arm."""
    rod, tendons, strain, effects = arm.rod, arm.tendons, arm.strain, arm.effects
    n, nodes = strain.size, rod.length.size
    points = 2 * nodes
    zeros = aligned_zeros
    return Workspace(
        tau=zeros(tendons.size),
        tau_dot=zeros(tendons.size),
        Phi=strain.columns(points),
        Y=zeros(n * points * 6),
        mismatch=zeros(points * 6),
        factor=zeros(points * 21),
        tangent=zeros(tendons.size * points * 4),
        xi=zeros(points * 6),
        xi_dot=zeros(points * 6),
        xi_bias=zeros(points * 6),
        base=np.concatenate([np.eye(3).ravel(), zeros(15)]),
        relative=zeros(nodes * 12),
        start=zeros(nodes * 12),
        pose=zeros(nodes * 12),
        J=zeros(n * nodes * 6),
        carry=zeros((n + 2) * 6),
        eta=zeros(nodes * 6),
        eta_bias=zeros(nodes * 6),
        wrench=zeros(nodes * 6),
        node_stiffness=zeros(nodes * 21),
        node_damping=zeros(nodes * 21),
        stress=zeros(points * 6),
        point_stiffness=zeros(points * 6),
        point_damping=zeros(points * 6),
        state=effects.state.copy(),
        clock=zeros(1),
        touched=zeros(1),
        loaded=zeros(n * nodes * 6),
        extra=zeros(n, n),
        unit=aligned(np.ones(points * 6)),
        M=zeros(n, n),
        D=zeros(n, n),
        G=zeros(n, n),
        bias=zeros(n),
        drive=zeros(n),
        driven=zeros(1),
        command=zeros(tendons.size),
        tension=zeros(tendons.size),
        tendon_stiffness=zeros(tendons.size),
        tendon_creep=zeros(tendons.size),
        bounded=make_bounded(tendons.size),
        drift=zeros(n),
        tendon_columns=zeros(tendons.size, n),
        share=aligned(np.ones(tendons.size * points)),
        load=zeros(n),
        memory=strain.scratch(nodes),
    )
