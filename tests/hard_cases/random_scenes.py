"""Random scenes through the statics: branch, stability, honest failure, and the number of
quadrature intervals that they get.

Scene number k is drawn with seed k, the same everywhere.
"""

import warnings
from typing import NamedTuple

import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, rod_length
from soft_tendon_env.scene.strain import STRAINS

MOVES = (
    0.05,
    0.01,
    # [rad] at a time, in the slow loading that statics are compared with; the smaller where the
    # larger differs
)
FIRST_PART = 1e-5  # of the load
SMALLEST_PART = 1e-8  # of the load reached
CLOSE = 1e-6  # of the rod's length
LIMIT = 0.02  # of the load reached, by which the slow loading may end elsewhere


class Verdict(NamedTuple):
    """What became of one scene."""

    number: int
    kind: str  # "converged", or why not
    problems: tuple[str, ...]  # empty where all is as it should be
    distance: float  # tip to the slow loading [lengths]
    # tip to that with three times as many intervals, where nothing was warned of [tolerances]
    quadrature: float


def direction(dice):
    return (v := dice.normal(size=3)) / np.linalg.norm(v)


def drawn_segments(dice):
    young = 10 ** dice.uniform(4, 8)
    segments = []
    for _ in range(dice.integers(1, 4)):
        length = dice.uniform(0.05, 0.4)
        radius = dice.uniform(0.004, 0.02)
        profile = radius
        if dice.random() < 0.3:
            profile = {"type": "linear", "base": radius, "tip": radius * dice.uniform(0.4, 1.0)}
        elif dice.random() < 0.15:
            table = list(radius * dice.uniform(0.6, 1.2, 4))
            profile = {
                "type": "table",
                "arc_length": list(length * np.linspace(0, 1, 4)),
                "radius": table,
            }
        segments.append(
            {
                "length": length,
                "young_modulus": young * dice.uniform(0.5, 2.0),
                "poisson_ratio": dice.uniform(0.3, 0.5),
                "density": dice.uniform(800, 1500),
                "damping": 0.05 * young,
                "radius": profile,
                "curvature": list(direction(dice) * dice.uniform(0, 6))
                if dice.random() < 0.2
                else [0.0, 0.0, 0.0],
            }
        )
    return segments


def drawn_routing(dice, radius, length):
    kind = dice.choice(
        ["straight", "converging", "surface", "helix", "table"], p=[0.35, 0.15, 0.15, 0.2, 0.15]
    )

    def offset():
        return list(
            radius * dice.uniform(0.3, 0.9) * (v := dice.normal(size=2)) / np.linalg.norm(v)
        )

    if kind == "straight":
        return {"type": "straight", "offset": offset()}
    if kind == "converging":
        return {"type": "converging", "start_offset": offset(), "end_offset": offset()}
    if kind == "surface":
        return {
            "type": "surface",
            "fraction": dice.uniform(0.3, 0.9),
            "angle": dice.uniform(0, 360),
        }
    if kind == "helix":
        turns = dice.choice([0.5, 1.0, 2.0, 4.0, 8.0]) * dice.choice([-1, 1])
        rate = 2 * np.pi * turns / length
        return {
            "type": "helix",
            "radius": radius * dice.uniform(0.3, 0.9),
            "angular_rate": rate,
            "phase": dice.uniform(0, 360),
        }
    knots = int(dice.integers(4, 9))
    y = list(radius * dice.uniform(-0.7, 0.7, knots))
    z = list(radius * dice.uniform(-0.7, 0.7, knots))
    return {"type": "table", "arc_length": list(np.linspace(0, length, knots)), "y": y, "z": z}


def drawn_strain(dice):
    if dice.random() < 0.7:
        free = list(STRAINS)
    else:
        free = list(STRAINS[:3])
    if dice.random() < 0.25:
        modes = {
            "strains": free,
            "order": int(dice.integers(1, 4)),
            "span": str(dice.choice(["rod", "piece"])),
        }
        return {"type": "explicit", "modes": [modes]}
    strain = {"type": "statics_based", "strains": free}
    if dice.random() < 0.5:
        strain["passive"] = [
            {"strains": list(STRAINS[:3]), "order": int(dice.integers(0, 3)), "span": "rod"}
        ]
    return strain


def drawn_scene(number: int) -> tuple[Scene, np.ndarray]:
    """A scene and tensions (n_a,) [N] within its limits: slack to past what the section can bear,
    loads from none to many times it."""
    dice = np.random.default_rng(number)
    segments = drawn_segments(dice)
    length = sum(segment["length"] for segment in segments)
    radii = [
        np.min(s["radius"]["radius"])
        if isinstance(s["radius"], dict) and "radius" in s["radius"]
        else min(s["radius"]["base"], s["radius"]["tip"])
        if isinstance(s["radius"], dict)
        else s["radius"]
        for s in segments
    ]
    radius = min(radii)
    young = min(segment["young_modulus"] for segment in segments)
    bending = young * np.pi * radius**4 / 4
    greatest = (
        10 ** dice.uniform(-1, 0.7) * bending / (length * 0.6 * radius)
    )  # bends the arm by 0.1 to 5 rad
    if dice.random() < 0.05:
        greatest *= 30.0  # as much as the section can bear, or more
    tendons = []
    for _ in range(dice.integers(1, 7)):
        if dice.random() < 0.7:
            ends = {}
        else:
            ends = {"end": length * dice.uniform(0.3, 0.95)}
        if dice.random() < 0.15:
            least = -0.2 * greatest
        else:
            least = 0.0
        tendons.append(
            {
                "routing": drawn_routing(dice, radius, length),
                "tension_limits": [least, greatest],
                **ends,
            }
        )
    force = direction(dice) * bending / length**2
    load = {"mass": 0.0, "force": [0.0, 0.0, 0.0]}
    if dice.random() < 0.6:
        load["mass"] = 10 ** dice.uniform(-1.5, 1.0) * bending / length**2 / 9.81
    if dice.random() < 0.4:
        load["force"] = list(force * 10 ** dice.uniform(-1.5, 1.0))
    if dice.random() < 0.15:
        load["frame"] = "tip"
    elif dice.random() < 0.15:
        load["moment"] = list(direction(dice) * bending / length * 10 ** dice.uniform(-1.5, 0.0))
    if dice.random() < 0.8:
        gravity = direction(dice) * 9.81
    else:
        gravity = np.zeros(3)
    if dice.random() < 0.15:  # upright, a little beyond or below what such a column bears
        gravity = np.array([-1.0, 0.0, 0.0]) * 9.81
        load["mass"] = 10 ** dice.uniform(-0.5, 1.0) * bending / length**2 / 9.81
    scene = Scene.parse(
        {
            "name": f"random_{number}",
            "segments": segments,
            "tendons": tendons,
            "strain": drawn_strain(dice),
            "effects": {"gravity": {"acceleration": list(gravity)}, "tip_load": load},
        },
        "scene",
    )
    limits = np.array([tendon.tension_limits for tendon in scene.tendons])
    tension = dice.uniform(limits[:, 0], limits[:, 1]) * (dice.random(len(limits)) < 0.7)
    return scene, tension


def slow_loading(model, tension, move=MOVES[0]):
    """Load the arm so slowly that it moves by at most `move` [rad] at a time: (q at the end, the
    part of the load reached).

    Newton's method along the tangent; parts of the load are halved until the move is small and its
    end is stable.
    """
    path = LoadPath(Balance(model, tension, make_workspace(model.arm)))
    reached = path.balance.unloaded()
    part = FIRST_PART
    while reached.evaluation.part < 1.0:
        q = reached.evaluation.q
        aim = min(reached.evaluation.part + part, 1.0)
        along_tangent = q + (aim - reached.evaluation.part) * reached.tangent
        ahead = path.equilibrium(along_tangent, aim)
        moved = np.inf
        if ahead is not None and ahead.stability.stable:
            moved = path.balance.angle(ahead.evaluation.q - q)
        if moved <= move:
            reached = ahead
            if moved < 0.5 * move:
                part *= 1.5
            continue
        part *= 0.5
        if part < SMALLEST_PART * aim:
            break
    return reached.evaluation.q, reached.evaluation.part


def verdict(number: int) -> Verdict:
    """Statics of one scene against slow loading."""
    scene, tension = drawn_scene(number)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        model = ste.build_model(scene)
    found = ste.static_equilibrium(model, tension)
    length = rod_length(scene)
    problems = []
    if not (np.isfinite(found.q).all() and np.isfinite(found.tip_pose).all()):
        problems.append("not finite")
    if (
        found.converged != (found.reason == "")
        or found.converged != (found.load == 1.0)
        or not found.stable
    ):
        problems.append(
            f"converged {found.converged}, stable {found.stable}, load {found.load}, reason"
            f" {found.reason!r}"
        )
    distance = np.nan
    for move in MOVES:
        q, reached = slow_loading(model, tension, move)
        agrees = (reached == 1.0) == found.converged and (
            found.converged or abs(reached - found.load) <= LIMIT * found.load
        )
        if reached == 1.0 and found.converged:
            distance = float(
                np.linalg.norm(model.tip_pose(q)[:3, 3] - found.tip_pose[:3, 3]) / length
            )
            agrees = distance <= CLOSE
        if agrees:
            break
    else:
        problems.append(
            f"slow loading reached {reached:.4g}, statics {found.load:.4g} ({found.reason}), tips"
            f" {distance:.2g} apart"
        )
    quadrature = np.nan
    if found.converged and not warned:
        quadrature = off_finer_quadrature(model, tension, found.tip_pose) / (
            scene.quadrature.tolerance * length
        )
        if quadrature > 1.0:
            problems.append(
                f"{model.grid.per_piece} quadrature intervals put the tip {quadrature:.3g}"
                " tolerances off, without a warning"
            )
    kind = (
        "converged"
        if found.converged
        else found.reason.split("load: ")[-1].split(":")[0].split("(")[-1][:40]
    )
    return Verdict(number, kind, tuple(problems), distance, quadrature)


def off_finer_quadrature(model, tension, tip_pose):
    """Distance [m] of the tip from where three times as many quadrature intervals put it, on the
    same branch."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        finer = ste.build_model(
            model.scene.replace(
                {"quadrature.intervals": min(3 * model.grid.per_piece, MOST_INTERVALS)}
            )
        )
    rest = ste.static_equilibrium(finer, tension)
    if rest.converged:
        return float(np.linalg.norm(rest.tip_pose[:3, 3] - tip_pose[:3, 3]))
    return np.nan
