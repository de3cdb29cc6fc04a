"""What every effect does, a small picture each: shapes with and without, tips over time, what
friction and slack make of tensions.

    python examples/effects_gallery.py [--out out]

Writes effects_gallery.png, of what acts on the arm, and actuation_gallery.png, of what lies between
command and tension. The arm is that of three tendons, 0.3 m of silicone; under water it is the
scene `underwater`.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

import soft_tendon_env as ste

WITHOUT = "#8d99ae"
WITH = "#c1121f"
THIRD = "#2e6f95"
SOLID = "#e0dccf"
WEIGHT = {
    "effects.gravity.acceleration": [0.0, 0.0, -9.81]
}  # across the arm, which points along x [m/s^2]
BENDING = {
    "strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
}  # what tendons alone do not bend
SLACK = np.zeros(3)  # [N]
PERIOD = 0.02  # [s] between samples


def arm(changes: dict, name: str = "three_tendon") -> ste.Model:
    return ste.build_model(ste.load_scene(name).replace(changes), "scene")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder that the pictures are written to"
    )
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    on_the_arm = (
        gravity,
        tip_load,
        fluid_current,
        fluid_swing,
        contact,
        contact_friction,
        disturbance,
        moving_base,
        nonlinear_elasticity,
        viscoelastic_memory,
        quasi_static,
        loads_inside,
    )
    draw(on_the_arm, 3, out / "effects_gallery.png")
    draw((actuators, tendon_elasticity, tendon_friction), 3, out / "actuation_gallery.png")


def draw(panels: tuple[Callable[[plt.Axes], None], ...], columns: int, path: Path) -> None:
    rows = len(panels) // columns
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.9 * columns, 2.75 * rows), layout="constrained", squeeze=False
    )
    for panel, own in zip(tqdm(panels, desc=path.name), axes.flat, strict=True):
        panel(own)
        own.grid(alpha=0.25)
        own.legend(
            loc="lower left" if own.get_aspect() == 1.0 else "best", frameon=False, fontsize=8
        )
        own.set_title(own.get_title(), fontsize=10)
    figure.savefig(path, dpi=90)
    print(f"written: {path}")


def draw_shape(
    axes: plt.Axes,
    model: ste.Model,
    q: np.ndarray,
    colour: str,
    label: str,
    across: int = 2,
    **line,
) -> None:
    """The backbone, seen along y (across = 2) or along z (across = 1)."""
    backbone = 1e3 * model.backbone(q, 60)[:, :3, 3]
    axes.plot(
        backbone[:, 0],
        backbone[:, across],
        color=colour,
        label=label,
        linewidth=2.5,
        solid_capstyle="round",
        **line,
    )
    axes.set(xlabel="x [mm]", ylabel=f"{'xyz'[across]} [mm]")
    axes.set_aspect("equal", adjustable="datalim")


def draw_tip(
    axes: plt.Axes, motion: ste.Trajectory, colour: str, label: str, across: int = 1
) -> None:
    axes.plot(motion.time, 1e3 * motion.tip_pose[:, across, 3], color=colour, label=label)
    axes.set(xlabel="time [s]", ylabel=f"tip {'xyz'[across]} [mm]")


def gravity(axes: plt.Axes) -> None:
    axes.set_title("gravity")
    for changes, colour, label in (({}, WITHOUT, "without"), (WEIGHT, WITH, "its own weight")):
        model = arm({**BENDING, **changes})
        draw_shape(axes, model, ste.static_equilibrium(model, SLACK).q, colour, label)


def tip_load(axes: plt.Axes) -> None:
    axes.set_title("tip_load: 0.15 N, dead or following the tip")
    for frame, colour, label in (
        (None, WITHOUT, "without"),
        ("world", WITH, "dead"),
        ("tip", THIRD, "following"),
    ):
        load = (
            {}
            if frame is None
            else {"effects.tip_load": {"force": [0.0, 0.0, -0.15], "frame": frame}}
        )
        model = arm({**BENDING, **load})
        draw_shape(axes, model, ste.static_equilibrium(model, SLACK).q, colour, label)


def fluid_current(axes: plt.Axes) -> None:
    axes.set_title("fluid: in a current, hanging")
    for speed, colour in ((0.0, WITHOUT), (0.3, THIRD), (0.6, WITH)):
        model = arm({**BENDING, "effects.fluid.current": [0.0, speed, 0.0]}, "underwater")
        backbone = 1e3 * model.backbone(ste.static_equilibrium(model, SLACK).q, 60)[:, :3, 3]
        axes.plot(
            backbone[:, 1], -backbone[:, 0], color=colour, label=f"{speed:g} m/s", linewidth=2.5
        )
    axes.set(xlabel="downstream [mm]", ylabel="height [mm]")
    axes.set_aspect("equal", adjustable="datalim")


def fluid_swing(axes: plt.Axes) -> None:
    axes.set_title("fluid: let go, in air and under water")
    scene = ste.load_scene("underwater")
    in_air = ste.Scene(**{**scene.model_dump(), "effects": {"gravity": scene.effects.gravity}})
    for own, colour, label in ((in_air, WITHOUT, "in air"), (scene, WITH, "under water")):
        model = ste.build_model(own, "scene")
        start = ste.Simulation(model).reset(model.rest_coordinates([1.0, 0.0, 0.0]))
        draw_tip(axes, ste.simulate(model, SLACK, 3.0, PERIOD, initial=start), colour, label)


def contact(axes: plt.Axes) -> None:
    axes.set_title("contact: weight, over a bar")
    bar = {
        "type": "cylinder",
        "position": [0.15, 0.0, -0.04],
        "axis": [0.0, 1.0, 0.0],
        "radius": 0.03,
        "length": 0.2,
    }
    for changes, colour, label in (
        (WEIGHT, WITHOUT, "without"),
        ({**WEIGHT, "effects.contact.obstacles": [bar]}, WITH, "with the bar"),
    ):
        model = arm({**BENDING, **changes})
        draw_shape(axes, model, ste.simulate(model, SLACK, 3.0, PERIOD).final.q, colour, label)
    axes.add_patch(plt.Circle((150.0, -40.0), 30.0, facecolor=SOLID, edgecolor="black"))


def contact_friction(axes: plt.Axes) -> None:
    axes.set_title("contact: friction on a floor")
    floor = {"type": "plane", "position": [0.0, 0.0, -0.01]}
    pull = {"type": "sine", "frequency": 0.02}
    sideways = [{"at": 0.3, "force": [0.0, 0.1, 0.0], "signal": pull}]
    for friction, colour in ((0.0, WITHOUT), (0.5, WITH)):
        table = {"obstacles": [floor], "friction": friction}
        press = {
            "effects.tip_load.force": [0.0, 0.0, -0.1],
            "effects.disturbance.loads": sideways,
            "effects.contact": table,
        }
        short = {
            "integrator.quasi_static": True,
            "integrator.step": 2e-3,
        }  # of 20 ms, steps let it slide 2 mN late
        motion = ste.simulate(arm({**BENDING, **short, **press}), SLACK, 75.0, PERIOD)
        force = 100.0 * np.sin(0.04 * np.pi * motion.time)
        axes.plot(force, 1e3 * motion.tip_pose[:, 1, 3], color=colour, label=f"mu = {friction:g}")
    axes.set(xlabel="pull [mN]", ylabel="tip y [mm]")


def disturbance(axes: plt.Axes) -> None:
    axes.set_title("disturbance: a push of 0.2 s, and a vibration")
    push = {
        "at": 0.2,
        "force": [0.0, 0.1, 0.0],
        "signal": {"type": "pulse", "start": 0.2, "duration": 0.2},
    }
    shake = {"at": 0.15, "force": [0.0, 0.03, 0.0], "signal": {"type": "sine", "frequency": 2.0}}
    for load, colour, label in ((push, WITH, "pushed"), (shake, THIRD, "shaken")):
        draw_tip(
            axes,
            ste.simulate(arm({"effects.disturbance.loads": [load]}), SLACK, 3.0, PERIOD),
            colour,
            label,
        )
    axes.axvspan(0.2, 0.4, color=WITH, alpha=0.15, linewidth=0)


def moving_base(axes: plt.Axes) -> None:
    axes.set_title("moving_base: to and fro at 1 Hz")
    motion = ste.simulate(
        arm({"effects.moving_base": {"amplitude": [0.0, 0.02, 0.0], "frequency": 1.0}}),
        SLACK,
        4.0,
        PERIOD,
    )
    axes.plot(motion.time, 20.0 * np.sin(2.0 * np.pi * motion.time), color=WITHOUT, label="base")
    draw_tip(axes, motion, WITH, "tip")
    axes.set(ylabel="y [mm]")


def nonlinear_elasticity(axes: plt.Axes) -> None:
    axes.set_title("nonlinear_elasticity: a force at the tip")
    forces = np.linspace(0.0, 0.3, 13)
    for curvature, colour in ((None, WITHOUT), (5.0, WITH)):
        law = {} if curvature is None else {"effects.nonlinear_elasticity.bending": curvature}
        scene = ste.load_scene("three_tendon").replace({**BENDING, **law})
        models = [
            ste.build_model(scene.replace({"effects.tip_load.force": [0.0, 0.0, -force]}), "scene")
            for force in forces
        ]
        tips = [ste.static_equilibrium(model, SLACK).tip_pose[2, 3] for model in models]
        label = "linear" if curvature is None else "twice as stiff at 5 1/m"
        axes.plot(1e3 * forces, -1e3 * np.array(tips), color=colour, label=label)
    axes.set(xlabel="force [mN]", ylabel="deflection [mm]")


def viscoelastic_memory(axes: plt.Axes) -> None:
    axes.set_title("viscoelastic_memory: creep under a push")
    push = {
        "at": 0.3,
        "force": [0.0, 0.05, 0.0],
        "signal": {"type": "pulse", "start": 0.5, "duration": 4.0},
    }
    memory = {"effects.viscoelastic_memory.branches": [{"modulus": 2.0, "relaxation_time": 0.5}]}
    for changes, colour, label in (
        ({}, WITHOUT, "without"),
        (memory, WITH, "with memory of 0.5 s"),
    ):
        draw_tip(
            axes,
            ste.simulate(arm({"effects.disturbance.loads": [push], **changes}), SLACK, 8.0, PERIOD),
            colour,
            label,
        )
    axes.axvspan(0.5, 4.5, color=WITH, alpha=0.15, linewidth=0)


def quasi_static(axes: plt.Axes) -> None:
    axes.set_title("integrator.quasi_static: 1 N on a tendon")
    for inertia_free, colour, label in (
        (False, WITHOUT, "with inertia"),
        (True, WITH, "without inertia"),
    ):
        model = arm({"integrator.quasi_static": inertia_free})
        draw_tip(axes, ste.simulate(model, [1.0, 0.0, 0.0], 3.0, PERIOD), colour, label)


def loads_inside(axes: plt.Axes) -> None:
    axes.set_title("strain.include_loads: weight, lifted a little")
    tension = np.array([0.25, 0.5, 0.0])
    explicit = {
        "strain": {
            "type": "explicit",
            "modes": [{"strains": ["bend_y", "bend_z", "stretch"], "order": 4, "span": "rod"}],
        }
    }
    arms = (
        ({}, WITHOUT, "-", "outside"),
        ({"strain.include_loads": True}, WITH, "-", "inside"),
        (explicit, "black", ":", "explicit"),
    )
    for changes, colour, style, label in arms:
        model = arm({**WEIGHT, **changes})
        label = f"{label}, {model.coordinate_count} coordinates"
        draw_shape(
            axes, model, ste.static_equilibrium(model, tension).q, colour, label, linestyle=style
        )


def actuators(axes: plt.Axes) -> None:
    axes.set_title("actuators: a command of 3 N at 0 s")
    cases = {
        "lag 50 ms": {"time_constant": 0.05},
        "and 30 N/s": {"time_constant": 0.05, "rate_limit": 30.0},
        "and 40 ms late": {"time_constant": 0.05, "rate_limit": 30.0, "delay": 0.04},
    }
    times = np.linspace(0.0, 0.4, 81)
    axes.plot([-0.05, 0.0, 0.0, 0.4], [0.0, 0.0, 3.0, 3.0], color=WITHOUT, label="command")
    for (label, table), colour in zip(cases.items(), (THIRD, WITH, "black"), strict=True):
        simulation = ste.Simulation(arm({"effects.actuators": table}))
        found = [0.0]
        for now, later in zip(times[:-1], times[1:], strict=True):
            simulation.step([3.0, 0.0, 0.0], later - now)
            found.append(simulation.state.effects[0])
        axes.plot(times, found, color=colour, label=label)
    axes.set(xlabel="time [s]", ylabel="tension [N]")


def tendon_elasticity(axes: plt.Axes) -> None:
    axes.set_title("tendon_elasticity: one tendon wound up")
    displacements = np.linspace(-0.002, 0.006, 33)
    for stiffness, colour in ((500.0, THIRD), (2e3, WITH), (1e5, "black")):
        springs = {"stiffness": stiffness, "displacement_limits": [-0.01, 0.02]}
        model = arm({"effects.tendon_elasticity": springs})
        tensions = [
            ste.commanded_equilibrium(model, [displacement, 0.0, 0.0])[1][0]
            for displacement in displacements
        ]
        axes.plot(1e3 * displacements, tensions, color=colour, label=f"{1e-3 * stiffness:g} N/mm")
    axes.annotate("slack", (-1.6, 0.06), fontsize=8)
    axes.set(xlabel="displacement [mm]", ylabel="tension [N]")


def tendon_friction(axes: plt.Axes) -> None:
    axes.set_title("tendon_friction: pulled in and let out")
    period = 40.0  # [s]
    for coefficient, colour in ((0.0, WITHOUT), (0.2, THIRD), (0.4, WITH)):
        model = arm(
            {
                **BENDING,
                "integrator.quasi_static": True,
                "effects.tendon_friction.coefficient": coefficient,
            }
        )
        motion = ste.simulate(
            model,
            lambda time: [1.5 - 1.5 * np.cos(2.0 * np.pi * time / period), 0.0, 0.0],
            2.0 * period,
            PERIOD,
        )
        last = motion.time >= period
        pull = 1.5 - 1.5 * np.cos(2.0 * np.pi * motion.time[last] / period)
        axes.plot(
            pull, 1e3 * motion.tip_pose[last, 1, 3], color=colour, label=f"mu = {coefficient:g}"
        )
    axes.set(xlabel="tension [N]", ylabel="tip y [mm]")


if __name__ == "__main__":
    main()
