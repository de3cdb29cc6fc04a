"""Picture of the demo: the circle as it was followed, and the errors on it and on random targets, in the recording's colours."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from soft_tendon_env.demo.demo import SKIPPED
from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.evaluation import EpisodeScore
from soft_tendon_env.evaluation.pictures import save_figure, set_log_scale
from soft_tendon_env.recording import Rollout

Colour = tuple[float, ...]
PALE = 0.35  # the first, of the paper's law as printed, goes far and wide: it hides no other
ROOM = 1.3  # around the circle, times its radius
HEADROOM = 2.0  # above the errors of all but the first, which is cut off there


def draw(on_circle: Mapping[str, Rollout], on_random: Mapping[str, Sequence[EpisodeScore]], path: Path) -> None:
    """Draw an episode on the circle and scores on the random targets, by the names of policies. Raises OSError."""
    figure, (paths, times, episodes) = plt.subplots(1, 3, figsize=(16, 5.4), constrained_layout=True)
    colours = {name: (*own.rgb, 1.0 if k else PALE) for k, (name, own) in enumerate(styles(on_circle).items())}
    draw_paths(paths, on_circle, colours)
    draw_errors(times, on_circle, colours)
    draw_episodes(episodes, on_random, colours)
    for axes in (paths, times, episodes):
        axes.grid(alpha=0.3, which="both")
    figure.legend(frameon=False, loc="outside lower center", ncols=len(colours) + 1)
    save_figure(figure, path)


def draw_paths(axes: Axes, rollouts: Mapping[str, Rollout], colours: Mapping[str, Colour]) -> None:
    """Draw the path of the tip in the plane of the circle; of the first policy until it leaves the picture."""
    first, poses = next(iter(rollouts.items()))[0], next(iter(rollouts.values())).target_pose
    assert poses is not None, "a circle is made of poses"
    target = poses[:, 1:3, 3]
    reach = ROOM * np.abs(target).max()
    for name, rollout in rollouts.items():
        path = rollout.tip_pose[:, 1:3, 3]
        outside = np.abs(path).max(axis=1) > reach
        end = 1 + int(outside.argmax()) if name == first and outside.any() else None
        axes.plot(*path[:end].T, color=colours[name], linewidth=1.2, label=name)
    axes.plot(*target.T, "--", color="black", linewidth=1.0, label="circle")
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="y [m]", ylabel="z [m]", title="the tip along the circle")


def draw_errors(axes: Axes, rollouts: Mapping[str, Rollout], colours: Mapping[str, Colour]) -> None:
    """Draw position errors against time."""
    counted = {}
    for name, rollout in rollouts.items():
        times, errors = rollout.period * np.arange(rollout.samples), 1e3 * rollout.scalars["position_error"]
        axes.plot(times, errors, color=colours[name], linewidth=1.2)
        counted[name] = errors[int(SKIPPED * rollout.samples) :]
    set_log_scale(axes, axes.yaxis)
    cut_off_the_first(axes, counted)
    axes.set(xlabel="time [s]", ylabel="position error [mm]", title="error on the circle")


def draw_episodes(axes: Axes, scores: Mapping[str, Sequence[EpisodeScore]], colours: Mapping[str, Colour]) -> None:
    """Draw root mean square errors of episodes, hollow where one diverged."""
    errors = {}
    for name, of_policy in scores.items():
        values = errors[name] = [1e3 * score.errors["position_error"].rms for score in of_policy]
        numbers = range(1, len(values) + 1)
        axes.plot(numbers, values, color=colours[name], alpha=0.4, linewidth=1.0)
        for number, value, score in zip(numbers, values, of_policy, strict=True):
            axes.plot(number, value, "o", color=colours[name], markerfacecolor=colours[name] if score.diverged is None else "none")
    set_log_scale(axes, axes.yaxis)
    cut_off_the_first(axes, errors)
    axes.set(xlabel="random target", ylabel="position error [mm], RMS of an episode", title="errors on random targets")
    axes.locator_params(axis="x", integer=True)


def cut_off_the_first(axes: Axes, errors: Mapping[str, ArrayLike]) -> None:
    """End the axis a little above the errors [mm] of all policies but the first, which is far off: where it is beyond, words say by how
    much."""
    (first, *others), found = errors, {name: np.asarray(values, dtype=float) for name, values in errors.items()}
    known = np.concatenate([found[name][np.isfinite(found[name])] for name in others])
    if not known.size:
        return
    axes.set_ylim(top=HEADROOM * known.max())
    if (off := np.sqrt(np.mean(found[first] ** 2))) > HEADROOM * known.max():
        axes.set_title(f"{first}: {off:.3g} mm, above", fontsize="small", loc="right", y=0.94, x=0.98)
