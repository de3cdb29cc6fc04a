"""Figures 5 and 6: the tip along the paper's circle with (39), from rest without tension.

Gains are kp = 10 000 and kd = 1000.

The paper does not give the circle's period; ours is 4 s. Tensions are unlimited and may push. On
the underactuated arm two choices matter: which left inverse of B the law uses, and what the passive
coordinates are. "As printed" has those of the paper, the pseudo-inverse and constant moments. This
package's default is the pseudo-inverse in the elastic energy, with passive coordinates orthogonal
to the tendons' fields. Each stable variant keeps a steady-state error, because (39) asks for forces
that tensions cannot make.

"Sampled" is the package's tip tracker in TendonRod-TipPose-v0, with a control period of 20 ms,
tensions of at most 60 N, an integral, and feedforward. Its gains become the paper's as the period
goes to zero.

"Later" is the second turn. The threshold of 1 mm is ours.
"""

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.control.dynamics import Gains
from soft_tendon_env.control.paper_laws import (
    LeftInverse,
    TipPoseTarget,
    energy_left_inverse,
    euclidean_left_inverse,
    tip_pose_tension,
)
from soft_tendon_env.envs.targets.shipped import Circle, CircleCourse
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.pictures import save_figure
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.paper.motion import (
    ClosedLoop,
    Law,
    Motion,
    below_for_good,
    integrate,
    track,
    when,
)
from soft_tendon_env.paper.report import (
    ACTUAL,
    Claim,
    Result,
    box,
    draw_arms,
    draw_errors,
    draw_tensions,
)

CIRCLE = Circle()
COURSE = CircleCourse(CIRCLE)
GAINS = Gains(10_000.0, 1000.0)  # kp [1/s^2] and kd [1/s]
DURATION = 2.0 * CIRCLE.period  # [s]
VERY_SMALL = 1e-3  # [m], an error below which the tip is to stay
SMOOTH = 0.5  # [s] from which on tensions are to be smooth
CALM = 0.1  # share of the tension before, below which a tension counts as smooth
APART = 1e-4  # [s] between the twists whose difference is the acceleration

FULL = "fully actuated"
UNDER = "underactuated"
PRINTED = "underactuated, as printed"
DESIGNS: Mapping[str, tuple[str, str, LeftInverse]] = {
    FULL: ("paper", "none", energy_left_inverse),
    UNDER: ("paper_16dof", "orthogonal", energy_left_inverse),
    PRINTED: ("paper_16dof", "raw", euclidean_left_inverse),
    "underactuated, moments": ("paper_16dof", "raw", energy_left_inverse),
    "underactuated, Euclidean": ("paper_16dof", "orthogonal", euclidean_left_inverse),
}
"""Scenes, their passive coordinates, and left inverses for (39)."""
SAMPLED = {FULL: f"{FULL}, sampled", UNDER: f"{UNDER}, sampled"}
SHOWN = {FULL: 5, UNDER: 6, PRINTED: 6, SAMPLED[FULL]: 5, SAMPLED[UNDER]: 6}
"""Figures whose claims they are judged by."""
INVERSES: Mapping[LeftInverse, str] = {
    energy_left_inverse: "in the energy",
    euclidean_left_inverse: "Euclidean",
}


def target(t: float) -> TipPoseTarget:
    """Pose, twist and acceleration of the target at time t [s]."""
    directions = np.array([-1.0, 0.0, 1.0])
    offsets = APART * directions
    samples = COURSE.sample(t + offsets)
    before, twist, after = samples.tip_twist
    acceleration = (after - before) / (2.0 * APART)
    return TipPoseTarget(samples.tip_pose[1], twist, acceleration)


def law_of(left_inverse: LeftInverse) -> Law:
    """Control law (39) with a left inverse of B."""
    return lambda t, q, q_dot, terms: tip_pose_tension(terms, q_dot, target(t), GAINS, left_inverse)


def reproduce(seconds: float, folder: Path) -> Result:
    """The first `seconds` of the motion."""
    duration = min(seconds, DURATION)
    models = dict[str, ste.Model]()
    motions = dict[str, Motion]()
    # the paper's law, continuous in time
    for name, (scene, passive, inverse) in DESIGNS.items():
        if passive == "none":
            changes = {}
        else:
            changes = {"strain.passive_coordinates": passive}
        changed = ste.load_scene(scene).replace(changes)
        models[name] = ste.build_model(changed, "scene")
        loop = ClosedLoop(models[name], law_of(inverse))
        motions[name] = integrate(loop, duration, f"Figures 5 and 6, {name}")
    # what the package makes of it at a control period
    for design, name in SAMPLED.items():
        scene, _, _ = DESIGNS[design]
        motions[name] = track(scene, CIRCLE, duration)
    # the other variants have no figure of their own: their errors stand beside these
    for name in (FULL, UNDER):
        draw(
            name,
            models[name],
            motions,
            folder / f"figure_{SHOWN[name]}.png",
        )
    numbers = {name: summary(motion, duration) for name, motion in motions.items()}
    rows = []
    for name, (scene, passive, inverse) in DESIGNS.items():
        result = outcome(numbers[name])
        row = (scene, passive, INVERSES[inverse], result)
        rows.append(row)
    table = markdown_table(("scene", "passive coordinates", "pseudo-inverse", "from rest"), rows)
    return Result(claims(numbers), {"tip_error": numbers}, (table,))


def tip_error(motion: Motion) -> np.ndarray:
    """Distance (m,) [m] of the tip from the target."""
    distance = target_path(motion) - motion.tip
    return np.linalg.norm(distance, axis=1)


def target_path(motion: Motion) -> np.ndarray:
    """Positions (m, 3) [m] of the target at the times of a motion."""
    course = COURSE.sample(motion.time)
    positions = course.tip_pose[:, :3, 3]
    return np.asarray(positions)


def summary(motion: Motion, duration: float) -> dict[str, float]:
    """Numbers of a motion; fewer where it breaks down before its end."""
    error = tip_error(motion)
    last_time = float(motion.time[-1])
    first_error = 1e3 * float(error[0])
    numbers = {"until_s": last_time, "start_mm": first_error}
    if numbers["until_s"] < duration - SMOOTH:
        return numbers
    # the second turn, or the second half of a shorter motion
    first_turn = min(CIRCLE.period, 0.5 * duration)
    late = motion.time >= first_turn
    smooth = motion.time >= SMOOTH
    rough = motion.tension[~smooth]
    first = np.abs(rough)
    then = np.abs(motion.tension[smooth])
    tension = motion.tension[smooth]
    changes = np.diff(tension, axis=0)
    change = np.abs(changes)
    return numbers | {
        "below_1_mm_from_s": below_for_good(motion.time, error, VERY_SMALL),
        "late_rms_mm": 1e3 * root_mean_square(error[late]),
        "late_largest_mm": 1e3 * float(error[late].max()),
        "largest_tension_first_N": float(first.max()),
        "largest_tension_then_N": float(then.max()),
        "largest_tension_change_then_N": float(change.max()),
    }


def claims(numbers: dict[str, dict[str, float]]) -> list[Claim]:
    """Claims of Figures 5 and 6, from numbers by variant."""
    # (c) errors
    claims = []
    for name, figure in SHOWN.items():
        claim = staying_below(f"{figure}(c)", name, numbers[name])
        claims.append(claim)
    # (b) tensions
    for name in (FULL, UNDER):
        first = numbers[name]["largest_tension_first_N"]
        then = numbers[name]["largest_tension_then_N"]
        change = numbers[name]["largest_tension_change_then_N"]
        text = (
            f"up to {first:.0f} N before {SMOOTH:g} s, then up to {then:.1f} N, changing by at most"
            f" {change:.2g} N in 5 ms"
        )
        is_calm = then < CALM * first
        is_smooth = is_calm and change < CALM * then
        saying = f"strengths high at first, then smooth, {name}"
        picture = f"{SHOWN[name]}(b)"
        claims.append(Claim(picture, saying, text, is_smooth))
    # both figures
    full = numbers[FULL]
    under = numbers[UNDER]
    better = full["late_rms_mm"] <= under["late_rms_mm"]
    later = outcome(under).removeprefix("later ")
    text = f"{outcome(full)} against {later}"
    claims.append(Claim("5, 6", "slightly better when fully actuated", text, better))
    return claims


def staying_below(
    figure: str,
    name: str,
    numbers: dict[str, float],
) -> Claim:
    """Claim of very small errors.

    What misses the threshold keeps a steady-state error above it, or breaks down.
    """
    since = numbers.get("below_1_mm_from_s", np.inf)
    holds = bool(np.isfinite(since))
    if holds or "late_rms_mm" not in numbers:
        steady = ""
    else:
        steady = "steady-state error: "
    saying = f"tip error stays below {1e3 * VERY_SMALL:g} mm, {name}"
    return Claim(
        figure,
        saying,
        f"{when(since)}; {steady}{outcome(numbers)}",
        holds,
    )


def outcome(numbers: dict[str, float]) -> str:
    """Words for the errors of a motion at its end."""
    if "late_rms_mm" not in numbers:
        return f"breaks down after {numbers['until_s']:.2f} s"
    return f"later {numbers['late_rms_mm']:.2g} mm rms, at most {numbers['late_largest_mm']:.2g} mm"


def draw(
    name: str,
    model: ste.Model,
    motions: dict[str, Motion],
    path: Path,
) -> None:
    """`name` in space and as tensions, its error beside those of others."""
    motion = motions[name]
    figure = plt.figure(figsize=(16, 8), constrained_layout=True)
    grid = figure.add_gridspec(2, 3)
    left_column = grid[:, 0]
    arms = figure.add_subplot(left_column, projection="3d")
    upper_right = grid[0, 1:]
    tensions = figure.add_subplot(upper_right)
    lower_right = grid[1, 1:]
    errors = figure.add_subplot(lower_right)
    draw_arms(arms, model, motion.q, ACTUAL)
    box(
        arms,
        f"(a) {name}",
        actual=motion.tip,
        wanted=target_path(motion),
    )
    draw_tensions(tensions, motion.time, motion.tension, "(b) tensions")
    is_smooth = motion.time >= SMOOTH
    sizes = np.abs(motion.tension[is_smooth])
    largest = sizes.max()
    tensions.set_ylim(-1.5 * largest, 1.5 * largest)  # cuts off what is high at first
    courses = {}
    labels = (FULL, UNDER, PRINTED, SAMPLED[name])
    for label in labels:
        motion = motions[label]
        millimetres = 1e3 * tip_error(motion)
        courses[f"(39), {label}"] = (motion.time, millimetres)
    draw_errors(errors, courses, "tip error [mm]", "(c) distance of the tip from the target")
    errors.axhline(1e3 * VERY_SMALL, color="black", linestyle=":", linewidth=1.0)
    save_figure(figure, path)
