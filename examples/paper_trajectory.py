"""The arm of the paper under a second of lively tensions: a table of cost and accuracy, and a
picture of the motion.

    python examples/paper_trajectory.py [--models paper paper_16dof ...] [--duration 1.0] [--out
    out]

The same arm is simulated with five descriptions of its strain, from 10 to 48 coordinates. The
references are numbers integrated to 1e-7 (16 coordinates: 1e-5) by independent code, see
tests/data/trajectories.json.
"""

import argparse
import json
import time
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MultipleLocator
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.scene.scene import rod_radius, tendon_ends, tendon_offset

SAMPLE_PERIOD = 0.01  # [s], that of the references
REFERENCES = Path(__file__).parent.parent / "tests" / "data" / "trajectories.json"
OWN_REFERENCE = {
    "paper": "implicit_10dof",
    "paper_16dof": "implicit_16dof",
    "paper_48dof": "legendre_48dof",
}
FULL_REFERENCE = "legendre_48dof"
OWN_CHANGES = {
    "paper_16dof": {"strain.passive_coordinates": "raw"}
}  # what the reference was computed with
# of the scene "paper": passive moments by Legendre polynomials over the whole arm, by what they are
# called
PASSIVE = {
    f"moments 0-{order}": {
        "strain.passive": [
            {"strains": ["torsion", "bend_y", "bend_z"], "order": order, "span": "rod"}
        ]
    }
    for order in (2, 3)
}
MODELS = ("paper", "paper_16dof", *PASSIVE, "paper_48dof")
COLOURS = ("#d1495b", "#edae49", "#66a182", "#2e6f95", "#3d2c5e")
SNAPSHOTS = 6


def tension(t: float) -> np.ndarray:
    """Tensions of the ten tendons [N] at time t [s]."""
    u = np.zeros(10)
    u[0] = 6.0 * np.sin(np.pi * t) ** 2
    u[3] = 4.0 * np.sin(2.0 * np.pi * t) ** 2
    u[5] = 2.5 * (1.0 - np.cos(2.0 * np.pi * t / 1.5))
    u[8] = 3.0 * np.sin(np.pi * t) ** 2
    if t >= 0.5:
        u[1:3] = 8.0, 5.0
    return u


class Run(NamedTuple):
    """One model's motion, what it took, and its distance from the references [m], one entry per
    sample (None: there is none)."""

    model: ste.Model
    trajectory: ste.Trajectory
    compile_time: float  # [s] wall
    wall_time: float  # [s]
    cpu_time: float  # [s]
    own_error: np.ndarray | None
    full_error: np.ndarray


def main() -> None:
    arguments = parse_arguments()
    references = read_references(arguments.duration)
    with tqdm(
        total=len(arguments.models) * arguments.duration,
        bar_format="{l_bar}{bar}| {n:.1f} of {total:.1f} s simulated",
    ) as bar:
        runs = {name: run(name, arguments.duration, references, bar) for name in arguments.models}
    print_table(runs, arguments.duration)
    arguments.out.mkdir(parents=True, exist_ok=True)
    picture = arguments.out / "paper_trajectory.png"
    draw(runs, arguments.duration, picture)
    print(f"\npicture: {picture}")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument(
        "--duration",
        type=float,
        default=1.0,
        help="[s], at most 1, which is as far as the references go",
    )
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the picture")
    arguments = parser.parse_args()
    if not SAMPLE_PERIOD <= arguments.duration <= 1.0:
        parser.error("--duration should lie between 0.01 and 1")
    return arguments


def read_references(duration: float) -> dict[str, np.ndarray]:
    """Tip positions (samples, 3) [m] at 0.01 s, 0.02 s, ..."""
    samples = round(duration / SAMPLE_PERIOD)
    stored = json.loads(REFERENCES.read_text())
    return {
        name: np.array(stored[name]["tip_position"])[:samples]
        for name in (*OWN_REFERENCE.values(), FULL_REFERENCE)
    }


def run(name: str, duration: float, references: dict[str, np.ndarray], bar: tqdm) -> Run:
    """Simulate one scene, timed once its kernels are compiled."""
    bar.set_description(f"{name:<11}")
    scene = ste.load_scene("paper" if name in PASSIVE else name).replace(PASSIVE.get(name, {}))
    model = ste.build_model(scene, "scene")
    compile_time = seconds(
        time.perf_counter, lambda: ste.simulate(model, tension, SAMPLE_PERIOD, SAMPLE_PERIOD)
    )[1]
    started = time.process_time()
    trajectory, wall_time = seconds(
        time.perf_counter, lambda: ste.simulate(model, tension, duration, SAMPLE_PERIOD)
    )
    cpu_time = time.process_time() - started
    bar.update(duration)
    own = None
    if name in OWN_REFERENCE:
        as_reference = ste.build_model(scene.replace(OWN_CHANGES.get(name, {})), "scene")
        own = distance(
            ste.simulate(as_reference, tension, duration, SAMPLE_PERIOD),
            references[OWN_REFERENCE[name]],
        )
    return Run(
        model,
        trajectory,
        compile_time,
        wall_time,
        cpu_time,
        own,
        distance(trajectory, references[FULL_REFERENCE]),
    )


def seconds(clock, action):
    """What the action returns, and the seconds that it takes."""
    started = clock()
    result = action()
    return result, clock() - started


def distance(trajectory: ste.Trajectory, reference: np.ndarray) -> np.ndarray:
    """Distance of the tip from the reference at every sample but the first, [m]."""
    return np.linalg.norm(trajectory.tip_pose[1:, :3, 3] - reference, axis=1)


def print_table(runs: dict[str, Run], duration: float) -> None:
    print(
        f"\n{duration:g} s of motion. Largest distance of the tip from a reference, on an arm of 1"
        " m: its own model, integrated"
    )
    print(
        "exactly, and full physics (48 coordinates). Compiling or loading the machine code happens"
        " once and is not in the times.\n"
    )
    print(
        "model        coordinates  wall ms   CPU ms  x real time  own model mm  full physics mm "
        " compile or load s"
    )
    for name, run in runs.items():
        own = "-" if run.own_error is None else f"{1e3 * run.own_error.max():.3f}"
        print(
            f"{name:<12} {run.model.coordinate_count:11d} {1e3 * run.wall_time:8.1f}"
            f" {1e3 * run.cpu_time:8.1f} {duration / run.wall_time:12.0f} {own:>13}"
            f" {1e3 * run.full_error.max():16.2f} {run.compile_time:18.1f}"
        )


def draw(runs: dict[str, Run], duration: float, picture: Path) -> None:
    figure = plt.figure(figsize=(13, 7), constrained_layout=True)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
    draw_arm(figure.add_subplot(grid[:, 0], projection="3d", elev=38, azim=-75), *shown_model(runs))
    draw_tensions(figure.add_subplot(grid[0, 1]), duration)
    draw_errors(figure.add_subplot(grid[1, 1]), runs)
    figure.savefig(picture, dpi=130)
    plt.close(figure)


def shown_model(runs: dict[str, Run]) -> tuple[ste.Model, ste.Trajectory]:
    """The most accurate run."""
    best = min(runs.values(), key=lambda run: run.full_error.max())
    return best.model, best.trajectory


def draw_arm(axes: plt.Axes, model: ste.Model, trajectory: ste.Trajectory) -> None:
    """The arm's surface at a few times, light to dark, with its tendons at the last, and the path
    of its tip."""
    samples = snapshots(trajectory)
    shades = plt.get_cmap("viridis_r")(np.linspace(0.1, 0.9, len(samples)))
    for shade, sample in zip(shades, samples, strict=True):
        draw_skin(axes, model, trajectory.q[sample], shade, 0.3 if sample == samples[-1] else 0.5)
        tip = trajectory.tip_pose[sample, :3, 3]
        axes.text(
            *(tip + [0.05, 0.0, 0.0]),
            f"{trajectory.time[sample]:.2f} s",
            color=shade,
            fontweight="bold",
            va="center",
        )
    draw_tendons(axes, model, trajectory.q[-1], tension(trajectory.time[-1]))
    axes.plot(
        *trajectory.tip_pose[:, :3, 3].T,
        color="black",
        linewidth=1.5,
        linestyle="--",
        label="path of the tip",
    )
    axes.scatter(0.0, 0.0, 0.0, color="black", s=40, label="clamped base")
    unique_legend(axes)
    equal_scales(axes, trajectory, model)
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_title(
        f"The arm at {len(samples)} times, and the path of its tip ({model.coordinate_count}"
        " coordinates)"
    )


def snapshots(trajectory: ste.Trajectory) -> np.ndarray:
    """Samples evenly spaced along the path of the tip, the first and the last among them."""
    moved = np.linalg.norm(np.diff(trajectory.tip_pose[:, :3, 3], axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(moved)])
    return np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], SNAPSHOTS)))


def draw_skin(
    axes: plt.Axes, model: ste.Model, q: np.ndarray, colour: np.ndarray, alpha: float
) -> None:
    arc_length = np.linspace(0.0, model.length, 81)
    radius, _ = rod_radius(model.scene, arc_length)
    around = np.linspace(0.0, 2.0 * np.pi, 25)
    circle = np.stack([np.zeros_like(around), np.cos(around), np.sin(around)])
    pose = model.backbone_at(q, arc_length)
    skin = pose[:, None, :3, 3] + radius[:, None, None] * np.einsum(
        "mij,jk->mki", pose[:, :3, :3], circle
    )
    axes.plot_surface(
        *np.moveaxis(skin, -1, 0), color=colour, alpha=alpha, linewidth=0, rstride=1, cstride=1
    )


def draw_tendons(axes: plt.Axes, model: ste.Model, q: np.ndarray, u: np.ndarray) -> None:
    for tendon, pull in zip(model.scene.tendons, u, strict=True):
        along = np.linspace(*tendon_ends(model.scene, tendon), 100)
        offset, _ = tendon_offset(model.scene, tendon, along)
        pose = model.backbone_at(q, along)
        path = pose[:, :3, 3] + np.einsum("mij,mj->mi", pose[:, :3, 1:3], offset)
        colour, width, label = (
            ("#c1121f", 2.0, "tendon that pulls")
            if pull > 0.05
            else ("#222222", 0.7, "slack tendon")
        )
        axes.plot(*path.T, color=colour, linewidth=width, label=label)


def unique_legend(axes: plt.Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper left", frameon=False)


def equal_scales(axes: plt.Axes, trajectory: ste.Trajectory, model: ste.Model) -> None:
    """Limits around the arm's shapes, with one scale for the three axes."""
    margin = 0.05  # [m]
    every = max(1, len(trajectory.q) // 20)
    backbones = [model.backbone(q) for q in trajectory.q[::every]]
    positions = np.array(backbones)[:, :, :3, 3]
    low = positions.min(axis=(0, 1)) - margin
    high = positions.max(axis=(0, 1)) + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=1.05)
    # Distances of the ticks [m].
    axes.xaxis.set_major_locator(MultipleLocator(0.2))
    axes.yaxis.set_major_locator(MultipleLocator(0.2))
    axes.zaxis.set_major_locator(MultipleLocator(0.1))


def draw_tensions(axes: plt.Axes, duration: float) -> None:
    times = np.linspace(0.0, duration, 501)
    table = np.array([tension(t) for t in times])
    pulled = np.flatnonzero(table.max(axis=0))
    for colour, index in zip(plt.get_cmap("tab10").colors, pulled, strict=False):
        axes.plot(times, table[:, index], color=colour, label=f"tendon {index + 1}")
    axes.set(xlabel="time [s]", ylabel="tension [N]", title="What pulls", xlim=(0.0, duration))
    axes.legend(frameon=False, ncols=2)
    axes.grid(alpha=0.3)


def draw_errors(axes: plt.Axes, runs: dict[str, Run]) -> None:
    for name, run in runs.items():
        label = f"{name}: {run.model.coordinate_count} coordinates, {1e3 * run.cpu_time:.0f} ms CPU"
        axes.semilogy(
            run.trajectory.time[1:],
            1e3 * run.full_error,
            color=COLOURS[MODELS.index(name)],
            label=label,
        )
    axes.set(
        xlabel="time [s]",
        ylabel="distance [mm]",
        title="Distance of the tip from full physics, on an arm of 1 m",
    )
    axes.set_xlim(0.0, runs[next(iter(runs))].trajectory.time[-1])
    axes.set_ylim(bottom=1e-3)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)


if __name__ == "__main__":
    main()
