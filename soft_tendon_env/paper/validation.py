"""Figure 2: the statics-based models against a model of 48 coordinates.

They are under tensions that vary, step and stay.

The paper gives its inputs as plots only. Ours: tendon i pulls A_i sin^2(pi f_i t) until 7.5 s and
then as much as it did at that time; tendons 2 and 3 pull 8 N and 5 N more from 5 s on.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.pictures import save_figure
from soft_tendon_env.paper.report import (
    ACTUAL,
    Claim,
    Result,
    box,
    draw_arms,
    draw_errors,
    draw_tensions,
)
from soft_tendon_env.tools.messages import say

AMPLITUDE = np.array([6.0, 2.0, 2.0, 5.0, 4.0, 5.0, 3.0, 4.0, 5.0, 4.0])  # [N]
FREQUENCY = np.array([0.4, 0.6, 0.3, 0.5, 0.7, 0.8, 0.45, 0.65, 0.55, 0.35])  # [Hz]
DURATION = 10.0  # [s]
HELD = 7.5  # [s] from which on tensions stay
STEP = 5.0  # [s] from which on some tendons pull more
AFTER_STEP = 1.0  # [s] after the step that count as around it
STEP_TENSION = np.array([0.0, 8.0, 5.0, *np.zeros(7)])  # [N]
SAMPLE_PERIOD = 0.01  # [s]
FINE = {"integrator.step": 0.0025}  # which changes the tip by less than 0.02 mm
SIMILAR = 0.05  # of the arm's length, up to which motions count as similar
REDUCED = {
    "paper": "fully actuated, 10 coordinates",
    "paper_16dof": "underactuated, 16 coordinates",
}
FULL = "paper_48dof"


def tension(t: float) -> np.ndarray:
    """Tensions (10,) [N] at time t [s]."""
    time = min(t, HELD)
    angle = np.pi * FREQUENCY * time
    sine = np.sin(angle)
    smooth = AMPLITUDE * sine**2
    if t >= STEP:
        return smooth + STEP_TENSION
    return smooth


def reproduce(seconds: float, folder: Path) -> Result:
    """The first `seconds` of the motion."""
    models = {
        name: ste.build_model(ste.load_scene(name).replace(FINE), "scene")
        for name in (*REDUCED, FULL)
    }
    duration = min(seconds, DURATION)
    title = f"Figure 2: {duration:g} s of {', '.join(models)}"
    say(title)
    motions = {
        name: ste.simulate(model, tension, duration, SAMPLE_PERIOD)
        for name, model in models.items()
    }
    mismatch = {}
    for name in REDUCED:
        poses = motions[name].tip_pose - motions[FULL].tip_pose
        positions = poses[:, :3, 3]
        mismatch[name] = np.linalg.norm(positions, axis=1)
    draw(models["paper"], motions, mismatch, folder / "figure_2.png")
    time = motions[FULL].time
    numbers = {name: summary(time, 1e3 * error) for name, error in mismatch.items()}
    list_of_claims = claims(numbers, models[FULL].length)
    return Result(list_of_claims, {"tip_mismatch_mm": numbers})


def summary(time: np.ndarray, error: np.ndarray) -> dict[str, float]:
    """Largest, root mean square and last of errors [mm].

    Those around the step are there only where the motion comes to it.
    """
    numbers = {
        "largest": float(error.max()),
        "rms": root_mean_square(error),
        "end": float(error[-1]),
    }
    # a shorter motion says nothing of the step
    last = time[-1]
    if last < STEP + AFTER_STEP:
        return numbers
    before = time < STEP
    is_soon = time <= STEP + AFTER_STEP
    around = (time >= STEP) & is_soon
    return numbers | {
        "largest_before_step": float(error[before].max()),
        "largest_around_step": float(error[around].max()),
    }


def claims(numbers: dict[str, dict[str, float]], length: float) -> list[Claim]:
    """Claims of Figure 2 on an arm of a length [m], from numbers by scene."""
    full, under = (numbers[name] for name in REDUCED)
    size = "mm of tip mismatch on an arm of 1 m"
    similar = f"largest {full['largest']:.1f}, rms {full['rms']:.1f} {size}"
    better = (
        f"largest {under['largest']:.2f}, rms {under['rms']:.2f} mm:"
        f" {full['rms'] / under['rms']:.0f} times less"
    )
    claims = [
        Claim(
            "2(e)",
            "10 coordinates move like the high-order model",
            similar,
            full["largest"] < 1e3 * SIMILAR * length,
        ),
        Claim(
            "2(f)",
            "passive coordinates improve the accuracy further",
            better,
            under["rms"] < full["rms"],
        ),
    ]
    # by how much passive coordinates help around the step, and by how much before it
    if "largest_around_step" in full:
        calm = full["largest_before_step"]
        around = full["largest_around_step"]
        calm_under = under["largest_before_step"]
        around_under = under["largest_around_step"]
        text = (
            f"largest from {STEP:g} s to {STEP + AFTER_STEP:g} s {around:.1f} mm without,"
            f" {around_under:.2f} mm with them; "
        )
        text += f"before it {calm:.1f} and {calm_under:.2f} mm"
        claims.append(
            Claim(
                "2(f)",
                "especially during the step at 5 s",
                text,
                around - around_under > calm - calm_under > 0.0,
            )
        )
    return claims


def draw(
    model: ste.Model,
    motions: dict[str, ste.Trajectory],
    mismatch: dict[str, np.ndarray],
    path: Path,
) -> None:
    """Figure 2: inputs, coordinates, shapes, tips and mismatches."""
    figure = plt.figure(figsize=(15, 9), constrained_layout=True)
    grid = figure.add_gridspec(2, 3)
    reduced = motions["paper"]
    time = motions[FULL].time
    tensions_of_times = [tension(t) for t in time]
    tensions = np.array(tensions_of_times)
    draw_tensions(
        figure.add_subplot(grid[0, 0]),
        time,
        tensions,
        "(b) inputs",
    )
    title = "(c) coordinates of the fully actuated system"
    draw_tensions(
        figure.add_subplot(grid[0, 1]),
        time,
        reduced.q,
        title,
    )
    right = grid[0, 2]
    arms = figure.add_subplot(right, projection="3d")
    draw_arms(arms, model, reduced.q, ACTUAL)
    tip_path = reduced.tip_pose[:, :3, 3]
    box(arms, "(d) shapes of the fully actuated system", actual=tip_path)
    tips = figure.add_subplot(grid[1, 0])
    names = (FULL, *REDUCED)
    for name, style in zip(names, ("-", "--", ":"), strict=True):
        # the same colours for x, y, z of every model
        position = motions[name].tip_pose[:, :3, 3]
        tips.plot(
            time,
            position,
            style,
            label=[f"{axis}, {name}" for axis in "xyz"],
        )
        tips.set_prop_cycle(None)
    tips.set(xlabel="time [s]", ylabel="tip position [m]", title="(e) tip")
    tips.legend(frameon=False, fontsize="small", ncols=3)
    courses = {}
    for name, label in REDUCED.items():
        millimetres = 1e3 * mismatch[name]
        courses[label] = (time[1:], millimetres[1:])
    title = f"(f) distance of the tip from that of {FULL}"
    draw_errors(
        figure.add_subplot(grid[1, 1:]),
        courses,
        "mismatch [mm]",
        title,
    )
    save_figure(figure, path)
