"""Workspace of one evaluation: the arrays that the kernels write; layout and letters as in
types.py."""

import inspect
import math
from functools import lru_cache
from typing import Annotated, Any, TypeVar

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LINE, aligned_zeros
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import BeforeStep, ContactFlags
from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded

Kind = TypeVar("Kind", bound=Struct)


def zeros(kind: type[Kind], sizes: dict[str, int], **fields: Any) -> Kind:
    """A struct of the fields given, and of zeros of the shapes that the annotations name: aligned
    to cache lines, in one piece of memory.

    A shape is a text for each dimension, a size or a product of sizes and numbers,
    `Annotated[np.ndarray, "n", "points x 6"]`.
    """
    size, places = _places(kind, tuple(sizes.items()), tuple(fields))  # type: ignore[arg-type]  # mypy takes no class as hashable
    memory = aligned_zeros(size)
    return kind(**{name: memory[place].reshape(shape) for name, place, shape in places}, **fields)


@lru_cache(maxsize=64)
def _places(
    kind: type[Struct], sizes: tuple[tuple[str, int], ...], given: tuple[str, ...]
) -> tuple[int, list[tuple[str, slice, list[int]]]]:
    """Numbers in all, and name, place and shape of the arrays of a struct, but for the fields that
    are given."""
    known, size, places = dict(sizes) | {str(number): number for number in range(25)}, 0, []
    line = LINE // 8  # numbers of a cache line
    for name, annotation in inspect.get_annotations(kind).items():
        if name not in given:
            shape = [
                math.prod(known[factor] for factor in text.split(" x "))
                for text in annotation.__metadata__
            ]
            places.append((name, slice(size, size + math.prod(shape)), shape))
            size += -(-math.prod(shape) // line) * line
    return size, places


def sizes_of(arm: Arm) -> dict[str, int]:
    """Sizes of an arm's arrays: coordinates n, tendons n_a, nodes, points, and internal states of
    the effects."""
    nodes = arm.rod.length.size
    return {
        "n": arm.strain.size,
        "n_a": arm.tendons.size,
        "nodes": nodes,
        "points": 2 * nodes,
        "states": arm.effects.state.size,
    }


class LoadMemory(Struct):
    """Eliminated Hessian of the strain under dead loads, see load_hessian; all but empty for other
    strains."""

    e: Annotated[np.ndarray, "points x 6"]  # the scaled strain
    step: Annotated[np.ndarray, "points x 6"]  # residual of the balance and its correction
    inverse: Annotated[
        np.ndarray, "nodes", "12", "12"
    ]  # of the blocks on the diagonal: the two points of an interval have 12 unknowns
    turn: Annotated[
        np.ndarray, "nodes", "12", "3"
    ]  # turn of what is beyond by the unknowns, over the weight
    columns: Annotated[np.ndarray, "nodes", "12", "3"]  # y of the unknowns
    answer: Annotated[np.ndarray, "nodes", "12", "3"]  # unknowns by a turn of the interval's start


class Workspace(Struct):
    """Arrays that one evaluation fills. Kernels read what the same evaluation has written, and
    besides xi, the guess of Newton's method, clock, state, before and since; and what nothing
    writes: ones, twist and acceleration of a base that stands still, Phi of explicit strains, and
    zeros."""

    tau: Annotated[
        np.ndarray, "n_a"
    ]  # tensions of the strain law [N]; of explicit strains those that pull
    tau_dot: Annotated[np.ndarray, "n_a"]
    Phi: Annotated[np.ndarray, "n x points x 6"]
    Y: Annotated[
        np.ndarray, "n x points x 6"
    ]  # wrenches of the coordinates times the weight, Phi^T Y = G
    mismatch: Annotated[
        np.ndarray, "points x 6"
    ]  # the stress that drives the coordinates, times the weight
    factor: Annotated[np.ndarray, "points x 21"]  # L below the diagonal then 1 / D
    tangent: Annotated[np.ndarray, "n_a x points x 4"]  # unit tangent t and 1 / |t_c|
    xi: Annotated[np.ndarray, "points x 6"]
    xi_dot: Annotated[np.ndarray, "points x 6"]
    xi_bias: Annotated[np.ndarray, "points x 6"]  # the part of xi_ddot without q_ddot
    base: Annotated[
        np.ndarray,
        "24",
        # pose of the base, R rows and r; its twist and the rate of that, world frame, at the
        # world's origin
    ]
    relative: Annotated[np.ndarray, "nodes x 12"]  # exp(Omega) of each interval: R rows, r
    start: Annotated[np.ndarray, "nodes x 12"]  # pose at the interval's start
    pose: Annotated[np.ndarray, "nodes x 12"]  # pose at the interval's end
    J: Annotated[np.ndarray, "n x nodes x 6"]
    carry: Annotated[np.ndarray, "columns x 6"]  # running sums of the sweep
    eta: Annotated[np.ndarray, "nodes x 6"]
    eta_bias: Annotated[np.ndarray, "nodes x 6"]  # J_dot q_dot
    wrench: Annotated[np.ndarray, "nodes x 6"]
    node_stiffness: Annotated[np.ndarray, "nodes x 21"]  # of the effects
    node_damping: Annotated[np.ndarray, "nodes x 21"]
    stress: Annotated[np.ndarray, "points x 6"]  # of the effects
    point_stiffness: Annotated[np.ndarray, "points x 6"]
    point_damping: Annotated[np.ndarray, "points x 6"]
    state: Annotated[np.ndarray, "states"]  # internal states of the effects
    before: Annotated[
        np.ndarray, "remembered x 6"
    ]  # the strain to which they belong; empty where no effect remembers it
    since: Annotated[np.ndarray, "1"]  # time since then [s]
    clock: Annotated[np.ndarray, "1"]  # time [s]
    before_step: BeforeStep
    contact: ContactFlags
    beside_pose: Annotated[np.ndarray, "nodes x 12"]  # where effects are differentiated
    beside_twist: Annotated[np.ndarray, "nodes x 6"]
    here_wrench: Annotated[np.ndarray, "nodes x 6"]  # that of one effect
    loaded: Annotated[np.ndarray, "n x nodes x 6"]  # node stiffness times J
    extra: Annotated[np.ndarray, "n", "n"]  # share of the effects in D or G
    unit: Annotated[np.ndarray, "points x 6"]  # ones
    M: Annotated[np.ndarray, "n", "n"]
    D: Annotated[np.ndarray, "n", "n"]
    G: Annotated[np.ndarray, "n", "n"]
    bias: Annotated[np.ndarray, "n"]  # C q_dot
    drive: Annotated[np.ndarray, "n"]  # B u - K - D q_dot
    u_is_command: Annotated[np.ndarray, "1"]  # 1 where u is a command, 0 where it is the tensions
    tension: Annotated[np.ndarray, "n_a"]  # [N] that come of a command, where effects are between
    shortening: Annotated[np.ndarray, "n_a"]  # [m] of elastic tendons beside the stress-free rod
    pull_rate: Annotated[np.ndarray, "n_a"]  # [m/s] at which tendons that rub are pulled in
    grip: Annotated[
        np.ndarray, "n_a"
    ]  # [N] the derivative of friction by the direction of sliding, for a tendon as a whole
    columns: Annotated[np.ndarray, "n_a", "n"]  # B_i of tendons that are elastic or rub
    rubbed: Annotated[np.ndarray, "n_a", "n"]  # the same, with what friction leaves of the tension
    rubbing: Annotated[np.ndarray, "n_a", "n"]  # -d force / d direction of sliding
    share: Annotated[np.ndarray, "n_a x points"]  # of the tension
    whole: Annotated[np.ndarray, "n_a x points"]  # ones
    slip: Annotated[np.ndarray, "n_a x points"]  # -d share / d direction of sliding
    load: Annotated[np.ndarray, "n"]  # F
    under_loads: LoadMemory  # of a strain with loads inside


def make_workspace(arm: Arm) -> Workspace:
    """Zeroed Workspace for one arm."""
    strain, sizes = arm.strain, sizes_of(arm)
    loaded = sizes["nodes"] if isinstance(strain, Loaded) else 0
    work = zeros(
        Workspace,
        {
            **sizes,
            "columns": strain.size + 2,
            "remembered": sizes["points"] if arm.effects.remembers else 0,
        },
        **({"Phi": strain.field} if isinstance(strain, Explicit) else {}),
        before_step=BeforeStep(np.zeros(1), np.zeros(12 * sizes["nodes"]), np.zeros(24)),
        contact=ContactFlags(np.zeros(1), np.zeros(1), np.zeros(1)),
        under_loads=zeros(LoadMemory, {"nodes": loaded, "points": 2 * loaded}),
    )
    work.state[:] = arm.effects.state
    work.base[:9:4], work.unit[:], work.share[:], work.whole[:] = 1.0, 1.0, 1.0, 1.0
    return work
