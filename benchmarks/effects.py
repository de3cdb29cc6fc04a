"""CPU time of effects, their compilation on first use, and the tip error without them: a section of
docs/appendix/speed.md.

    python benchmarks/effects.py [--quick] [--out out]

Costs are CPU times of an evaluation of the equation of motion of the paper's arm (10 coordinates, 6
intervals per piece), measured in turns and divided by those without effects: medians. The row of
loads inside the strain (`strain.include_loads`) is relative to the arm without gravity. Compilation
is the CPU time of the first step in a new process, everything but the effect compiled, minus that
without the effect.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _in_step import evaluate_force_often
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import HOLD, motion_tensions
from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.compiler.kept_code import cache_folder
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces_of_command, rod_matrices
from soft_tendon_env.model.model import model_on


class Case(NamedTuple):
    """An effect on the paper's arm, of which costs are measured, and a scene that needs it."""

    on_paper: dict[str, Any]
    scene: str  # "-": its commands are no tensions, so that no motion compares
    needed: dict[str, Any]  # changes of the scene


DOWN = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
PUSH = {
    "at": 0.8,
    "force": [0.0, 0.5, 0.0],
    "signal": {"type": "pulse", "start": 0.5, "duration": 0.2},
}
AWAY = [
    {"type": "sphere", "position": [2.0, 0.0, 0.0], "radius": 0.1},
    {
        "type": "capsule",
        "position": [0.0, 2.0, 0.0],
        "axis": [0.0, 0.0, 1.0],
        "radius": 0.1,
        "length": 1.0,
    },
    {"type": "box", "position": [0.0, 0.0, 2.0], "size": [0.4, 0.1, 0.3]},
]
LATE = {"time_constant": 0.02, "delay": 0.013}
CASES = {
    "contact": Case({"effects.contact.obstacles": AWAY}, "paper_among_obstacles", {}),
    "moving_base": Case(
        {"effects.moving_base.acceleration": [0.0, 0.0, 1.0]},
        "three_tendon",
        {"effects.moving_base.acceleration": [0.0, 0.0, 1.0]},
    ),
    "gravity": Case(DOWN, "three_tendon", DOWN),
    "tip_load": Case(
        {"effects.tip_load.force": [0.0, 0.0, -0.1]},
        "three_tendon",
        {"effects.tip_load": {"mass": 0.01}},
    ),
    "fluid": Case(
        {"effects.fluid": {"density": 1000.0, "current": [0.0, 0.2, 0.0]}}, "underwater", {}
    ),
    "disturbance": Case(
        {"effects.disturbance.loads": [PUSH]},
        "three_tendon",
        {"effects.disturbance.loads": [{**PUSH, "at": 0.3}]},
    ),
    "nonlinear_elasticity": Case(
        {"effects.nonlinear_elasticity.bending": 5.0},
        "three_tendon",
        {"effects.nonlinear_elasticity.bending": 3.0},
    ),
    "viscoelastic_memory": Case(
        {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.2}]},
        "three_tendon",
        {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.2}]},
    ),
    "actuators": Case({"effects.actuators": LATE}, "three_tendon", {"effects.actuators": LATE}),
    "tendon_elasticity": Case(
        {"effects.tendon_elasticity": {"stiffness": 1.0, "displacement_limits": [0.0, 10.0]}},
        "-",
        {},
    ),
    "tendon_friction": Case(
        {"effects.tendon_friction.coefficient": 0.2},
        "three_tendon",
        {"effects.tendon_friction.coefficient": 0.2},
    ),
}
EVERYTHING = "all together"
INSIDE = "loads inside"
LEFT_OUT = ("disturbance",)  # of the page, not of the chart: it costs what gravity does
INTERVALS = 6
LEAST = 1.0  # [%], added CPU time below which a bar is cut: two measurements differ by that
EVALUATIONS = 1000
HEADER = ("effect", "evaluation", "in a step", "compilation [s]", "scene", "without it [mm]")

FIRST_STEP = """
import sys, time
started = time.process_time()
import json
import numpy as np
import soft_tendon_env as ste
from soft_tendon_env.model.model import model_on
scene = ste.load_scene("paper").replace(json.loads(sys.argv[1]))
ste.Simulation(model_on(scene, 6)).step(np.zeros(10), 0.01)
print(time.process_time() - started)
"""


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    quick = arguments.quick
    together = {key: value for case in CASES.values() for key, value in case.on_paper.items()}
    inside = {**DOWN, "strain.include_loads": True}
    arms = {
        "": {},
        **{name: case.on_paper for name, case in CASES.items()},
        EVERYTHING: together,
        INSIDE: inside,
    }
    evaluation, in_step = costs(arms, turns=2 if quick else 41)
    compiling = compile_times(
        {name: arms[name] for name in (["gravity"] if quick else [*CASES, EVERYTHING])}
    )
    rows = []
    for name in (*CASES, EVERYTHING, INSIDE):
        seconds = f"{compiling[name]:.1f}" if name in compiling else "-"
        scene = CASES[name].scene if name in CASES else "-"
        off = (
            "-"
            if scene == "-"
            else f"{1e3 * left_out(name, CASES[name], 0.1 if quick else 2.0):.3g}"
        )
        rows.append((name, f"{evaluation[name]:.2f}", f"{in_step[name]:.2f}", seconds, scene, off))
    write_csv(arguments.out / "effects.csv", HEADER, rows)
    draw(rows, arguments.out / "effects.png")
    shown = [row for row in rows if row[0] not in LEFT_OUT]
    write_tables(arguments.out / "effects.md", markdown_table(HEADER, shown))


@kernel
def evaluate_often(arm, u, q, q_dot, scratch, count):
    """Terms at slightly different states, each strain found from the one before."""
    for _ in range(count):
        q[0] += 1e-9
        evaluate_forces_of_command(arm, u, q, q_dot, STEP_TOLERANCE, scratch.work)
        rod_matrices(arm, scratch.work)


def costs(arms: dict[str, dict[str, Any]], turns: int) -> tuple[dict[str, float], dict[str, float]]:
    """CPU times as ratios to the first arm, by name: of an evaluation, and of one in a step."""
    found = []
    for often in (evaluate_often, evaluate_force_often):
        ready = {}
        times = {name: [] for name in arms}
        for name, changes in arms.items():
            model = model_on(ste.load_scene("paper").replace(changes), INTERVALS)
            random = np.random.default_rng(0)
            scratch = make_scratch(model.arm, 3)
            scratch.work.strain.xi[:] = model.arm.rod.reference_strain
            ready[name] = (
                model.arm,
                np.full(10, 3.0),
                random.uniform(0.0, 5.0, 10),
                random.normal(size=10),
                scratch,
            )
            often(*ready[name], 5)
        for _ in range(turns):
            for name, arguments in ready.items():
                started = time.process_time()
                often(*arguments, EVALUATIONS)
                times[name].append(time.process_time() - started)
        bare = np.array(times[next(iter(arms))])
        found.append({name: float(np.median(np.array(own) / bare)) for name, own in times.items()})
    return found[0], found[1]


def compile_times(arms: dict[str, dict[str, Any]]) -> dict[str, float]:
    """CPU seconds that the first step takes longer than without effects, by name, with no effect's
    machine code in the cache."""
    folder = cache_folder()
    found = {}
    if folder is None:
        return found
    with tempfile.TemporaryDirectory() as temporary:
        cache = Path(temporary) / "soft_tendon_env" / folder.name

        def first_step(changes: dict[str, Any]) -> float:
            environment = {**os.environ, "NUMBA_CACHE_DIR": temporary, "SOFT_TENDON_ENV_QUIET": "1"}
            command = [sys.executable, "-c", FIRST_STEP, json.dumps(changes)]
            return float(
                subprocess.run(
                    command, env=environment, check=True, capture_output=True, text=True
                ).stdout
            )

        shutil.copytree(folder, cache)
        first_step({})
        for name, changes in arms.items():
            forget_effects(cache)
            found[name] = first_step(changes) - first_step({})
    return found


def forget_effects(cache: Path) -> None:
    """Delete the machine code of all effects."""
    for file in (
        *cache.glob("*/effects_*/*"),
        *cache.glob("*/contact_*/*"),
        *cache.glob("*/mechanics_*/effects._entry*"),
    ):
        file.unlink()


def left_out(name: str, case: Case, seconds: float) -> float:
    """Largest distance [m] of the tip with the effect and without."""
    scene = ste.load_scene(case.scene).replace(case.needed)
    table = motion_tensions(scene, "smooth", 0, seconds)
    tips = []
    for own in (scene, scene.replace({f"effects.{name}": None})):
        tips.append(
            ste.simulate(ste.build_model(own, "scene"), table, len(table) * HOLD, HOLD).tip_pose[
                :, :3, 3
            ]
        )
    return float(np.linalg.norm(tips[0] - tips[1], axis=1).max())


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    """What each effect adds to the CPU time, on a logarithmic axis: small bars stay visible."""
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    places = np.arange(len(rows))
    for column, shift, colour, label in (
        (1, -0.2, "#2e6f95", "evaluation"),
        (2, 0.2, "#edae49", "in a step"),
    ):
        added = np.array([100.0 * (float(row[column]) - 1.0) for row in rows])
        axes.barh(places + shift, np.maximum(added, LEAST), 0.4, color=colour, label=label)
        for place, share in zip(places + shift, added, strict=True):
            text = f"{share:.0f} %" if share >= LEAST else f"< {LEAST:g} %"
            axes.annotate(
                text,
                (max(share, LEAST), place),
                xytext=(3, 0),
                textcoords="offset points",
                verticalalignment="center",
                fontsize=7,
            )
    axes.set(
        yticks=places,
        yticklabels=[row[0] for row in rows],
        xlabel="CPU time that it adds [%]",
        xscale="log",
        xlim=(0.8 * LEAST, 5000.0),
    )
    axes.invert_yaxis()
    axes.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.25))
    write_picture(figure, path)


if __name__ == "__main__":
    main()
