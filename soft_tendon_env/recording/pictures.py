"""One-page picture of an episode: the arm at a few times, its tensions, and its errors."""

from pathlib import Path

import numpy as np

from soft_tendon_env.drawing.renderer import ArmRenderer, Picture
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.recording.rollout import Rollout

FRAME = (520, 440)
"""Pixels, width and height."""
DPI = 100.0


def save_picture(rollout: Rollout, path: str | Path, frames: int = 4) -> None:
    """Draw a rollout to an image file of the format that its name ends in. Raises gymnasium.error.DependencyNotInstalled."""
    renderer = ArmRenderer(rollout.model, *FRAME)  # raises
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(frames * FRAME[0] / DPI, 1.75 * FRAME[1] / DPI), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = np.asarray(figure.subfigures(2, 1, height_ratios=(1.0, 0.75)))
    samples = np.unique(np.linspace(0, rollout.samples - 1, frames + 1).round().astype(int)[1:])
    for axes, sample in zip(above.subplots(1, frames, squeeze=False)[0], samples, strict=False):
        axes.imshow(renderer.frame(_shown(rollout, int(sample))))
        axes.set_axis_off()
    times = rollout.period * np.arange(rollout.samples)
    tensions, errors = below.subplots(1, 2)
    for number, tension in enumerate(rollout.tension.T):
        tensions.plot(times, tension, linewidth=1.0, label=f"tendon {number}")
    tensions.set(xlabel="time [s]", ylabel="tension [N]")
    tensions.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))  # beside the curves
    names = [name for name in rollout.scalars if name.endswith("_error")]
    for name in names:
        unit = error_unit(name)
        errors.semilogy(times, unit.factor * rollout.scalars[name], label=unit.titled)
    errors.set(xlabel="time [s]", ylabel="errors")
    if names:
        errors.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axes in (tensions, errors):
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    figure.savefig(path)


def _shown(rollout: Rollout, sample: int) -> Picture:
    """One frame, with the tip's way there."""
    target_backbone = rollout.target_backbone
    return Picture(
        strain=rollout.strain[sample],
        tension=rollout.tension[sample],
        trail=rollout.tip_pose[: sample + 1, :3, 3],
        target_pose=None if rollout.target_pose is None else rollout.target_pose[sample],
        target_backbone=None if target_backbone is None or not target_backbone.shape[1] else target_backbone[sample],
        title=f"t = {sample * rollout.period:.2f} s",
        time=sample * rollout.period,
        effects=rollout.effects,
    )
