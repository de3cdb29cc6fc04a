"""Figures 3 and 4: shapes by feedforward alone and with the feedback of (37) and (38).

Gains are kp = 1000 and kd = 100.

The paper gives its desired shapes as plots only. Ours: what tendons 2, 5, 8 and 9 hold with 8, 3, 4
and 3 N. They are approached within 2.5 s by a polynomial that is twice differentiable. The shape
error is ||q_bar - q||, in newton for the tensions and in square roots of joules for the passive
coordinates. In brackets: feedforward alone.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.control.dynamics import Gains
from soft_tendon_env.control.paper_laws import ShapeTarget, shape_tension
from soft_tendon_env.envs.targets.shipped import Rise
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.pictures import save_figure
from soft_tendon_env.paper.motion import ClosedLoop, Law, Motion, below_for_good, integrate, when
from soft_tendon_env.paper.report import (
    ACTUAL,
    DESIRED,
    Claim,
    Result,
    box,
    draw_arms,
    draw_errors,
    draw_tensions,
)

TENSION = np.array([0.0, 8.0, 0.0, 0.0, 3.0, 0.0, 0.0, 4.0, 3.0, 0.0])  # [N]
RISE = 2.5  # [s] within which they are approached
COURSE = Rise(np.zeros(10), TENSION, RISE)
DURATION = 5.0  # [s]
MODELS = {"paper": "fully actuated", "paper_16dof": "underactuated"}
LAWS = {"feedforward": Gains(0.0, 0.0), "feedback": Gains(1000.0, 100.0)}
PARTS = (0.1, 0.01)  # of the largest error of feedforward, below which errors are to fall


def target(t: float) -> ShapeTarget:
    """Tensions that hold the wanted shape at time t [s], and their rates."""
    times = np.array([t])
    tension, rate = COURSE(times)
    return ShapeTarget(tension[0], rate[0])


def law_of(model: ste.Model, gains: Gains) -> Law:
    """Control law (37), (38) of an arm."""
    return lambda t, q, q_dot, terms: shape_tension(model, q, q_dot, target(t), gains)


def wanted_shapes(model: ste.Model, time: np.ndarray) -> np.ndarray:
    """q_bar (m, n)."""
    equilibria = [model.rest_coordinates(target(t).tension) for t in time]
    return np.array(equilibria)


def reproduce(seconds: float, folder: Path) -> Result:
    """The first `seconds` of the motion."""
    models = {}
    for name in MODELS:
        scene = ste.load_scene(name)
        models[name] = ste.build_model(scene, "scene")
    duration = min(seconds, DURATION)
    motions = {}
    errors = {}
    for name, model in models.items():
        for law, gains in LAWS.items():
            loop = ClosedLoop(model, law_of(model, gains))
            title = f"Figure 3, {name}, {law}"
            motion = integrate(loop, duration, title)
            motions[name, law] = motion
            target_shapes = wanted_shapes(model, motion.time)
            error = target_shapes - motion.q
            errors[name, law] = np.linalg.norm(error, axis=1)
    draw_laws(motions, errors, folder / "figure_3.png")
    draw_shapes(models, motions, folder / "figure_4.png")
    # the size of an error is a share of feedforward's largest: units of coordinates differ
    numbers: dict[str, dict[str, dict[str, float]]] = {name: {} for name in MODELS}
    for (name, law), error in errors.items():
        largest = errors[name, "feedforward"].max()
        motion = motions[name, law]
        numbers[name][law] = summary(motion, error, largest)
    claims = [claim(name, numbers[name]) for name in MODELS]
    return Result(claims, {"shape_error": numbers})


def summary(
    motion: Motion,
    error: np.ndarray,
    of_feedforward: float,
) -> dict[str, float]:
    """Numbers of the errors (m,) of a motion; of_feedforward: the largest error of feedforward."""
    numbers = {
        "largest": float(error.max()),
        "rms": root_mean_square(error),
        "end": float(error[-1]),
    }
    for part in PARTS:
        threshold = part * of_feedforward
        numbers[below(part)] = below_for_good(motion.time, error, threshold)
    return numbers


def below(part: float) -> str:
    """Key of the time from which on errors are below a part of feedforward's largest."""
    return f"below_{part:g}_from_s"


def claim(name: str, numbers: dict[str, dict[str, float]]) -> Claim:
    """Claim of Figure 3(b) for an arm, from its numbers by law."""
    ahead = numbers["feedforward"]
    back = numbers["feedback"]
    keys = [below(part) for part in PARTS]
    parts = []
    for part, key in zip(PARTS, keys, strict=True):
        time_back = when(back[key])
        time_ahead = when(ahead[key])
        percent = 100 * part
        parts.append(f"{percent:g} % {time_back} ({time_ahead})")
    times = ", ".join(parts)
    sizes = f"rms {back['rms']:.2g} ({ahead['rms']:.2g})"
    ends = f"{back['end']:.1g} ({ahead['end']:.1g})"
    text = f"{sizes}; below {times}; at the end {ends}"
    return Claim(
        "3(b)",
        f"feedback converges fast, {MODELS[name]}",
        text,
        all(back[key] < ahead[key] for key in ("rms", "end", *keys)),
    )


def draw_laws(
    motions: dict[tuple[str, str], Motion],
    errors: dict[tuple[str, str], np.ndarray],
    path: Path,
) -> None:
    """Figure 3: wanted shapes, errors and tensions."""
    figure, ((wanted, error), (full, under)) = plt.subplots(
        2, 2, figsize=(13, 8), constrained_layout=True
    )
    time = motions["paper", "feedback"].time
    tensions = [target(t).tension for t in time]
    tension = np.array(tensions)
    draw_tensions(wanted, time, tension, "(a) wanted shape, as the tensions that hold it")
    courses = {}
    # the first sample, at rest, has no error: a logarithmic axis has no place for it
    for (name, law), values in errors.items():
        times = motions[name, law].time
        label = f"{MODELS[name]}, {law}"
        courses[label] = (times[1:], values[1:])
    draw_errors(error, courses, "shape error", "(b) shape error")
    rows = ((full, "paper", "c"), (under, "paper_16dof", "d"))
    for axes, name, letter in rows:
        title = f"({letter}) tensions with feedback, {MODELS[name]}"
        draw_tensions(
            axes,
            time,
            motions[name, "feedback"].tension,
            title,
        )
    save_figure(figure, path)


def draw_shapes(
    models: dict[str, ste.Model],
    motions: dict[tuple[str, str], Motion],
    path: Path,
) -> None:
    """Figure 4: wanted and actual shapes."""
    figure = plt.figure(figsize=(12, 11), constrained_layout=True)
    for place, ((name, law), motion) in enumerate(motions.items(), 1):
        model = models[name]
        wanted = wanted_shapes(model, motion.time)
        tips = [model.tip_pose(q)[:3, 3] for q in wanted]
        tip = np.array(tips)
        axes = figure.add_subplot(2, 2, place, projection="3d")
        draw_arms(axes, model, wanted, DESIRED)
        draw_arms(axes, model, motion.q, ACTUAL)
        box(
            axes,
            f"{MODELS[name]}, {law}",
            actual=motion.tip,
            wanted=tip,
        )
    save_figure(figure, path)
