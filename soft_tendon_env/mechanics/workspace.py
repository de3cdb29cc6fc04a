"""Workspace of one evaluation: the arrays that the kernels write.

There is a struct for every stage; layout and letters as in types.py.

A stage gets the structs, or the arrays, that it reads and then those that it writes, and nothing
else. Every field has one writer:

| struct | is written by |
|---|---|
| `inputs` | whoever asks for an evaluation |
| `strain` | the functions of the arm's parametrisation, see terms/parametrisation.py |
| `kinematics` | place_base() its base, poses() the poses, sweep() the rest |
| `loads` | effect_loads(), to whose derivatives differ_wrenches() adds |
| `forces` | driving_force(), bias_force() and external_force(), a field each |
| `matrices` | mass_matrix() and the parametrisation; add_implicit() adds the effects' share |
| `tendons` | transmit(), find_columns() the columns |
| `friction` | find_shares() |
| `collision` | effects that limit steps; advance.py resets it |
| `spare` | any kernel, in which nothing lasts |
| `ones` | nobody |

What is differentiated by differences of poses and twists moves those, and puts them back. An arm at
rest has a base without twist, see balance_at_rest().
"""

import inspect
import math
from functools import lru_cache
from typing import Annotated, Any, TypeVar

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LINE, aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import Collision, IntArray
from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded

Kind = TypeVar("Kind", bound=Struct)


def zeros(kind: type[Kind], sizes: dict[str, int], **fields: Any) -> Kind:
    """Struct of the fields passed, and of zeros of the shapes that the annotations name.

    They are aligned to cache lines, in one piece of memory. Structs in it are made likewise.

    A shape is a text for each dimension, a size or a product of sizes and numbers,
    `Annotated[np.ndarray, "n", "points x 6"]`.
    """
    for name, annotation in inspect.get_annotations(kind).items():
        if name not in fields and _is_struct(annotation):
            fields[name] = zeros(annotation, sizes)
    # mypy takes no class as hashable
    size, places = _places(kind, tuple(sizes.items()), tuple(fields))  # type: ignore[arg-type]
    memory = aligned_zeros(size)
    arrays = {}
    for name, place, shape, is_int in places:
        numbers = memory[place].reshape(shape)
        arrays[name] = numbers.view(np.int64) if is_int else numbers
    return kind(**arrays, **fields)


def _is_struct(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Struct)


@lru_cache(maxsize=256)
def _places(
    kind: type[Struct], sizes: tuple[tuple[str, int], ...], made: tuple[str, ...]
) -> tuple[int, list[tuple[str, slice, list[int], bool]]]:
    """Numbers in all, and places of the arrays of a struct in one piece of memory.

    A place has name, place, shape and whether they are integers, but for the fields that are made
    already.
    """
    known = dict(sizes)
    known |= {str(number): number for number in range(25)}
    line = LINE // 8  # numbers of a cache line
    places = []
    size = 0
    for name, annotation in inspect.get_annotations(kind).items():
        if name in made:
            continue
        shape = [
            math.prod(known[factor] for factor in text.split(" x "))
            for text in annotation.__metadata__
        ]
        count = math.prod(shape)
        is_int = annotation.__origin__ == IntArray
        places.append((name, slice(size, size + count), shape, is_int))
        size += math.ceil(count / line) * line
    return size, places


def sizes_of(arm: Arm) -> dict[str, int]:
    """Sizes of an arm's arrays.

    They are coordinates n, tendons n_a, nodes, points, internal states of the effects, and a row of
    n + 1 numbers in whole packs.
    """
    nodes = arm.rod.length.size
    return {
        "n": arm.strain.size,
        "n_a": arm.tendons.size,
        "nodes": nodes,
        "points": 2 * nodes,
        "states": arm.effects.state.size,
        "row": row_stride(arm.strain.size + 1),
    }


class Inputs(Struct):
    """Time of an evaluation and internal states of the effects.

    They stand beside coordinates, rates and tensions.
    """

    clock: Annotated[np.ndarray, "1"]  # time [s]
    state: Annotated[np.ndarray, "states"]  # internal states of the effects
    # the strain to which they belong; empty where no effect remembers it
    before: Annotated[np.ndarray, "remembered x 6"]
    since: Annotated[np.ndarray, "1"]  # time since then [s]; infinity: the arm has rested


class LoadMemory(Struct):
    """Eliminated Hessian of the strain under dead loads, see load_hessian.

    It is all but empty for other strains.
    """

    e: Annotated[np.ndarray, "loaded x 2 x 6"]  # the scaled strain
    step: Annotated[np.ndarray, "loaded x 2 x 6"]  # residual of the balance and its correction
    # inverse of the blocks on the diagonal: the two points of an interval have 12 unknowns
    inverse: Annotated[np.ndarray, "loaded", "12", "12"]
    # turn of what is beyond by the unknowns, over the weight
    turn: Annotated[np.ndarray, "loaded", "12", "3"]
    columns: Annotated[np.ndarray, "loaded", "12", "3"]  # y of the unknowns
    # unknowns by a turn of the interval's start
    answer: Annotated[np.ndarray, "loaded", "12", "3"]


class StrainFields(Struct):
    """Strain at the coordinates, its rate, and its derivatives by the coordinates."""

    # solve: from a guess in xi, which it overwrites by the strain
    xi: Annotated[np.ndarray, "points x 6"]
    under_loads: LoadMemory  # of a strain with loads inside
    factor: Annotated[np.ndarray, "points x 21"]  # L below the diagonal then 1 / D
    # solve; of explicit strains, which no tension changes, columns
    tau: Annotated[np.ndarray, "n_a"]  # tensions of the strain law [N]; explicit: those that pull
    tangent: Annotated[np.ndarray, "n_a x points x 4"]  # unit tangent t and 1 / |t_c|
    # rate, or columns
    tau_dot: Annotated[np.ndarray, "n_a"]
    xi_dot: Annotated[np.ndarray, "points x 6"]
    # columns
    Phi: Annotated[np.ndarray, "n x points x 6"]  # of explicit strains the arm's own
    Y: Annotated[np.ndarray, "n x points x 6"]  # their wrenches times the weight, Phi^T Y = G
    mismatch: Annotated[np.ndarray, "points x 6"]  # stress that drives them, times the weight
    xi_bias: Annotated[np.ndarray, "points x 6"]  # the part of xi_ddot without q_ddot


class Kinematics(Struct):
    """Poses in the world frame, R rows and r, and body twists, of base and nodes."""

    # pose of the base; its twist and the rate of that, world frame, at the world's origin
    base: Annotated[np.ndarray, "24"]
    relative: Annotated[np.ndarray, "nodes x 12"]  # exp(Omega) of each interval
    start: Annotated[np.ndarray, "nodes x 12"]  # pose at the interval's start
    pose: Annotated[np.ndarray, "nodes x 12"]  # pose at the interval's end
    eta: Annotated[np.ndarray, "nodes x 6"]
    eta_bias: Annotated[np.ndarray, "nodes x 6"]  # J_dot q_dot
    J: Annotated[np.ndarray, "n x nodes x 6"]
    carry: Annotated[np.ndarray, "columns x 6"]  # running sums of the sweep


class Forces(Struct):
    """Generalised forces of (23)."""

    drive: Annotated[np.ndarray, "n"]  # B u - K - D q_dot
    bias: Annotated[np.ndarray, "n"]  # C q_dot
    load: Annotated[np.ndarray, "n"]  # F


class Loads(Struct):
    """Wrenches and stresses of the effects, at the nodes and at the points.

    They have the derivatives that they give themselves, times the weight of the point.
    """

    wrench: Annotated[np.ndarray, "nodes x 6"]  # body frame
    node_stiffness: Annotated[np.ndarray, "nodes x 21"]
    node_damping: Annotated[np.ndarray, "nodes x 21"]
    stress: Annotated[np.ndarray, "points x 6"]
    point_stiffness: Annotated[np.ndarray, "points x 6"]
    point_damping: Annotated[np.ndarray, "points x 6"]


class Matrices(Struct):
    """Mass, damping and stiffness matrix of (23)."""

    M: Annotated[np.ndarray, "n", "n"]
    D: Annotated[np.ndarray, "n", "n"]
    G: Annotated[np.ndarray, "n", "n"]


class TendonForces(Struct):
    """Tensions that come of a command, and forces on the coordinates by them.

    They are of tendons that are elastic or rub.
    """

    tension: Annotated[np.ndarray, "n_a"]  # [N] at the actuators
    shortening: Annotated[np.ndarray, "n_a"]  # [m] of elastic tendons beside the stress-free rod
    columns: Annotated[np.ndarray, "n_a", "n"]  # B_i of elastic tendons
    rubbed: Annotated[np.ndarray, "n_a", "n"]  # the same, with what friction leaves of the tension


class Borders(Struct):
    """Borders before the points of tendons that rub, in their order along the rod."""

    # w_k, of which the product with q_dot slides past a border [m/s], filled up to whole packs
    row: Annotated[np.ndarray, "n_a x points x row"]
    turn: Annotated[np.ndarray, "n_a x points"]  # mu times the angle by which the path turns there


class Friction(Struct):
    """Friction along the tendons at the rates of an evaluation, for derivatives."""

    share: Annotated[np.ndarray, "n_a x points"]  # of the tension that is left, at the points
    turn: Annotated[np.ndarray, "n_a x points"]  # as in Borders
    rate: Annotated[np.ndarray, "n_a x points"]  # [m/s] that slides past the borders


class Ones(Struct):
    """Fields of ones: weights that change nothing."""

    point: Annotated[np.ndarray, "points x 6"]
    tendon: Annotated[np.ndarray, "n_a x points"]


class Spare(Struct):
    """Scratch of one kernel at a time: nothing in it lasts."""

    stress: Annotated[np.ndarray, "points x 6"]
    wrench: Annotated[np.ndarray, "nodes x 6"]
    loaded: Annotated[np.ndarray, "n x nodes x 6"]  # node stiffness times J
    matrix: Annotated[np.ndarray, "n", "n"]
    # where effects are differentiated
    pose: Annotated[np.ndarray, "nodes x 12"]
    twist: Annotated[np.ndarray, "nodes x 6"]


class Workspace(Struct):
    """Structs that the stages of one evaluation fill, see the head of this file."""

    inputs: Inputs
    strain: StrainFields
    kinematics: Kinematics
    loads: Loads
    forces: Forces
    matrices: Matrices
    tendons: TendonForces
    friction: Friction
    collision: Collision
    spare: Spare
    ones: Ones


def make_workspace(arm: Arm) -> Workspace:
    """Zeroed Workspace for one arm."""
    sizes = sizes_of(arm)
    sizes["columns"] = arm.strain.size + 2  # running sums: those of J, eta, and its bias
    sizes["loaded"] = sizes["nodes"] if isinstance(arm.strain, Loaded) else 0
    sizes["remembered"] = sizes["points"] if arm.effects.remembers else 0
    fields = {"Phi": arm.strain.field} if isinstance(arm.strain, Explicit) else {}
    work = zeros(Workspace, sizes, strain=zeros(StrainFields, sizes, **fields))
    work.inputs.state[:] = arm.effects.state
    work.kinematics.base[:9:4] = 1.0  # the diagonal of R
    work.ones.point[:] = 1.0
    work.ones.tendon[:] = 1.0
    return work
