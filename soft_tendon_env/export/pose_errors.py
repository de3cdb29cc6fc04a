"""Pose errors as nodes of a graph: SE(3) logarithms from a pose to others, by way of unit quaternions (Shepperd 1978)."""

import numpy as np

from soft_tendon_env.export.graph import Graph
from soft_tendon_env.tools.types import Array

SMALL = 1e-6
"""Sine of half an angle below which the limits at zero are exact to double precision."""
ROTATION = np.array([[0, 1, 2], [4, 5, 6], [8, 9, 10]])  # entries of a pose, row by row
NEXT, LAST = [1, 2, 0], [2, 0, 1]  # of the indices of a cross product


def pose_errors(graph: Graph, pose: str, wanted: str, count: int) -> str:
    """Twists (count, 6), log(g^-1 g_bar), angular then linear, from a pose g (4, 4) to wanted ones g_bar (count, 4, 4)."""
    first = np.arange(3)
    entries = graph.reshape(pose, 16)
    R, back = (graph.reshape(graph.take(entries, of), 3, 3) for of in (ROTATION.ravel(), ROTATION.T.ravel()))
    r = graph.take(entries, [3, 7, 11])
    wanted = graph.take(wanted, first, axis=1)
    turn = graph.add("MatMul", back, graph.take(wanted, first, axis=2))
    p = graph.add("MatMul", graph.add("Sub", graph.take(wanted, 3, axis=2), r), R)
    k, e = _rotation_log(graph, graph.reshape(turn, count, 9))
    u = _cross(graph, k, p)
    linear = graph.sum(p, graph.add("Mul", -0.5, u), graph.add("Mul", e, _cross(graph, k, u)))
    return graph.add("Concat", k, linear, axis=1)


def _rotation_log(graph: Graph, R: str) -> tuple[str, str]:
    """Rotation vectors k (m, 3) of matrices R (m, 9), and the coefficient e (m, 1) of k~^2 in the inverse tangent on SO(3)."""
    quaternion = _quaternion(graph, R)
    w, v = graph.take(quaternion, [0], axis=1), graph.take(quaternion, [1, 2, 3], axis=1)
    s = _norm(graph, v)
    tangent = graph.cast(graph.add("Div", s, graph.add("Max", w, 1e-30)), np.float32)
    half = graph.cast(graph.add("Atan", tangent), np.float64)  # runtimes have no Atan of doubles: a step of Newton's adds the digits
    sine, cosine = graph.add("Sin", half), graph.add("Sin", graph.sum(half, 0.5 * np.pi))  # nor has each a Cos
    half = graph.sum(half, graph.add("Sub", graph.add("Mul", s, cosine), graph.add("Mul", w, sine)))
    small, safe = graph.add("Less", s, SMALL), graph.add("Max", s, SMALL)
    k = graph.add("Mul", v, graph.add("Where", small, 2.0, graph.add("Div", graph.add("Mul", 2.0, half), safe)))
    cotangent = graph.add("Div", graph.add("Mul", half, w), safe)
    square = graph.add("Max", graph.add("Mul", 4.0, graph.add("Mul", half, half)), SMALL**2)
    e = graph.add("Div", graph.add("Sub", 1.0, cotangent), square)
    return k, graph.add("Where", small, 1.0 / 12.0, e)


def _quaternion(graph: Graph, R: str) -> str:
    """Unit quaternions (m, 4), w >= 0 first, of rotation matrices (m, 9): the longest column of 4 q q^T, which is linear in R."""
    products = graph.sum(graph.add("MatMul", R, _products().reshape(9, 16)), np.eye(4).ravel())
    longest = graph.add("ArgMax", graph.take(products, [0, 5, 10, 15], axis=1), axis=1, keepdims=0)
    chosen = graph.reshape(graph.add("Gather", np.eye(4), longest, axis=0), -1, 4, 1)
    column = graph.reshape(graph.add("MatMul", graph.reshape(products, -1, 4, 4), chosen), -1, 4)
    side = graph.add("Where", graph.add("Less", graph.take(column, [0], axis=1), 0.0), -1.0, 1.0)
    return graph.add("Div", graph.add("Mul", column, side), _norm(graph, column))


def _products() -> Array:
    """Linear part (9, 4, 4) of 4 q q^T, w first, in the entries of a rotation matrix, row by row; its constant is the identity."""
    found = np.zeros((9, 4, 4))
    for i, signs in enumerate([(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)]):
        found[[0, 4, 8], i, i] = signs
    for (i, j), (entry, mirrored) in {(1, 2): (3, 1), (1, 3): (6, 2), (2, 3): (7, 5)}.items():
        k = 6 - i - j  # the axis that is left
        found[[entry, mirrored], i, j] = found[[entry, mirrored], j, i] = 1.0
        found[[entry, mirrored], 0, k] = found[[entry, mirrored], k, 0] = (-1.0, 1.0) if k == 2 else (1.0, -1.0)
    return found


def _norm(graph: Graph, rows: str) -> str:
    """Norms (m, 1) of rows (m, n)."""
    return graph.add("Sqrt", graph.add("ReduceSum", graph.add("Mul", rows, rows), np.array([1]), keepdims=1))


def _cross(graph: Graph, a: str, b: str) -> str:
    """Cross products of rows (m, 3)."""
    forward, back = (graph.add("Mul", graph.take(a, i, axis=1), graph.take(b, j, axis=1)) for i, j in ((NEXT, LAST), (LAST, NEXT)))
    return graph.add("Sub", forward, back)
