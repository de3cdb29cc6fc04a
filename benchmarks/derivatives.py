"""CPU time of derivatives relative to a plain step, and their error on every arm that ships and
with every effect.

    python benchmarks/derivatives.py [--quick] [--out out]

Control periods are 20 ms. docs/explanation/derivatives.md has the paper's arm at every preset; the
CSV file has the other arms and the effects too, at `standard`.

- Cost: CPU time per row and period on one thread, divided by that of a plain step with its reading.
  Both are measured in turns; the number is the median ratio. "adjoint" is `Arms.adjoint` of the
  state and the tip's pose, "rollout" is `Simulation.rollout` of a period.
- Gradient: the least cosine, of three rollouts, between the adjoint's gradient and central
  differences of the same rollout, and the ratio of their lengths. The gradient is that of a
  tracking error over 16 periods by all commands, which change by up to 5 % of their range every
  period. "-": no adjoint. Where stiff tendons hang slack the motion has kinks, and differences of
  two step sizes disagree as much.
- Linearisation: the largest error of the blocks of `Simulation.rollout` by state and by tension, in
  percent of the largest entry of those of `Simulation.linearize`, in units of the coordinates,
  after six periods with other tensions. "-": commands are no tensions.
"""

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _results import markdown_table, parser_of, write_csv, write_picture, write_tables
from _scenes import WITH_FIELDS

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import HOLD, motion_tensions
from soft_tendon_env.differentiable import gradient_accuracy
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation

PRESETS = ("fast", "standard", "fine")
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARMS: dict[str, dict[str, Any]] = {
    "50 g and gravity": {**GRAVITY, "effects.tip_load.mass": 0.05},
    "in water": {**GRAVITY, "effects.fluid.density": 1000.0},
    "actuators": {"effects.actuators": {"time_constant": 0.03, "delay": 0.02}},
}
FLOOR = {"obstacles": [{"type": "plane", "position": [0.0, 0.0, -0.05]}]}
EFFECTS: dict[str, dict[str, Any]] = {
    "gravity": GRAVITY,
    "tip_load": {**GRAVITY, "effects.tip_load.mass": 0.005},
    "fluid": {**GRAVITY, "effects.fluid.density": 1000.0},
    "disturbance": {
        "effects.disturbance.loads": [
            {"at": 0.3, "force": [0.0, 0.05, 0.0], "signal": {"type": "sine", "frequency": 2.0}}
        ]
    },
    "moving_base": {"effects.moving_base": {"amplitude": [0.0, 0.02, 0.0], "frequency": 2.0}},
    "nonlinear_elasticity": {"effects.nonlinear_elasticity.bending": 3.0},
    "actuators": {"effects.actuators": {"time_constant": 0.03, "delay": 0.03}},
    "tendon_elasticity, 2 kN/m": {
        "effects.tendon_elasticity": {"stiffness": 2e3, "displacement_limits": [0.0, 0.01]}
    },
    "tendon_elasticity, 20 kN/m": {
        "effects.tendon_elasticity": {"stiffness": 2e4, "displacement_limits": [0.0, 0.01]}
    },
    "contact": {**GRAVITY, "effects.contact": FLOOR},
    "tendon_friction": {"effects.tendon_friction.coefficient": 0.2},
    "viscoelastic_memory": {
        "effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.2}]
    },
}
CASES = [
    *((scene, "as it is", {}) for scene in WITH_FIELDS),
    *(("paper", name, table) for name, table in ARMS.items()),
    *(("three_tendon", name, table) for name, table in EFFECTS.items()),
]
CHANGE = 0.05
SEEDS = 3
LIVELY = 10  # periods of motion before costs are measured
SENSORS = (0.25, 0.5, 0.75, 1.0)  # shares of the length
HEADER = (
    "arm",
    "effect",
    "preset",
    "adjoint",
    "rollout",
    "cosine",
    "ratio",
    "by state [%]",
    "by tension [%]",
)


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    warnings.simplefilter("ignore")
    cases = [(*CASES[0], preset) for preset in PRESETS] + [
        (*case, "standard") for case in CASES[1:]
    ]
    rows = []
    for scene, effect, changes, preset in cases[:1] if arguments.quick else cases:
        model = ste.build_model(ste.load_scene(scene).replace(changes), preset)
        cosine, ratio = accuracy(model)
        adjoint, rollout = costs(model, 3 if arguments.quick else 15, has_adjoint=cosine != "-")
        percent = (
            "-" if np.isnan(share) else f"{100.0 * share:.0f}" for share in rollout_error(model)
        )
        rows.append((scene, effect, preset, adjoint, rollout, cosine, ratio, *percent))
        print(*rows[-1], flush=True)
    write_csv(arguments.out / "derivatives.csv", HEADER, rows)
    draw(rows, arguments.out / "derivatives.png")
    write_tables(
        arguments.out / "derivatives.md",
        markdown_table(HEADER[2:], [row[2:] for row in rows[: len(PRESETS)]]),
    )


def accuracy(model: Model) -> tuple[str, str]:
    """Least cosine of a few rollouts, with the ratio of lengths of that one."""
    least, greatest = model.scene.effects.command_limits(
        np.array([tendon.tension_limits for tendon in model.scene.tendons])
    ).T
    try:
        found = [
            gradient_accuracy(model, HOLD, least, greatest, CHANGE * (greatest - least), seed)
            for seed in range(SEEDS)
        ]
    except ValueError:  # effects whose states follow the motion
        return "-", "-"
    return f"{min(found).cosine:.4f}", f"{min(found).ratio:.2f}"


def rollout_error(model: Model) -> tuple[float, float]:
    """Largest errors of a linearisation by state and by tension, as shares of the largest
    entries."""
    n = model.coordinate_count
    simulation = Simulation(model)
    random = np.random.default_rng(0)
    least, greatest = model.scene.effects.command_limits(
        np.array([tendon.tension_limits for tendon in model.scene.tendons])
    ).T
    simulation.reset_at_rest()
    for _ in range(6):
        simulation.step(least + 0.2 * (greatest - least) * random.random(least.size), HOLD)
    command = least + 0.2 * (greatest - least) * random.random(least.size)
    cheap = simulation.rollout(command[None], HOLD)
    exact = simulation.linearize(command, HOLD)
    scale = model.coordinate_scale()
    unit = np.append(scale, scale / HOLD)
    pairs = (
        (cheap.by_state[0] * unit, exact.state[: 2 * n, : 2 * n] * unit),
        (cheap.by_tension[0], exact.command[: 2 * n]),
    )
    by_state, by_tension = (
        np.abs((x - y) / unit[:, None]).max() / max(np.abs(y / unit[:, None]).max(), 1e-30)
        for x, y in pairs
    )
    return by_state, np.nan if model.arm.effects.transmission.acts else by_tension


def placed(model: Model, rows: int) -> Arms:
    """Rows at rest under their loads."""
    arms = Arms(model, rows, HOLD, np.zeros(0), model.length * np.array(SENSORS), threads=1)
    arms.place(np.arange(rows), np.tile(Simulation(model).reset_at_rest().q, (rows, 1)))
    return arms


def costs(model: Model, repeats: int, has_adjoint: bool) -> list[str]:
    """Costs of an adjoint and of a rollout in plain steps with their readings; "-": no adjoint."""
    rows = 32
    arms = placed(model, rows)
    members = np.arange(rows)
    tape = None
    table = np.stack(
        [
            motion_tensions(model.scene, "increments", row, (LIVELY + 1) * HOLD)
            for row in range(rows)
        ]
    )
    for k in range(LIVELY):
        arms.step(np.ascontiguousarray(table[:, k : k + 1]), members)
    simulation = Simulation(model)
    simulation.reset(
        arms.rows.q[0],
        arms.rows.q_dot[0],
        effects=arms.rows.state[0],
        time=float(arms.rows.clock[0, 0]),
    )
    kept = {
        name: getattr(arms.rows, name).copy()
        for name in ("q", "q_dot", "xi", "state", "clock", "step")
    }
    command = np.ascontiguousarray(table[:, LIVELY:])
    tape = arms.make_tape()
    cotangents = arms.make_cotangents()
    random = np.random.default_rng(0)
    drawn = {
        name: random.normal(size=getattr(cotangents, name).shape)
        for name in ("q", "q_dot", "tip_pose")
    }

    def restore() -> None:
        for name, values in kept.items():
            getattr(arms.rows, name)[:] = values

    def give() -> None:
        for name, values in drawn.items():
            getattr(cotangents, name)[:] = values

    ways: list[tuple[Callable[[], None], Callable[[], object], int]] = [
        (restore, lambda: arms.step(command, members, None, tape), rows),
        (lambda: None, lambda: simulation.rollout(command[0, :1], HOLD), 1),
        *([(give, lambda: arms.adjoint(tape, members, cotangents), rows)] if has_adjoint else []),
    ]
    times = np.array([[timed(*way) for way in ways] for _ in range(repeats + 1)][1:])
    rollout, *adjoint = (f"{ratio:.1f}" for ratio in np.median(times[:, 1:] / times[:, :1], axis=0))
    return [*(adjoint or "-"), rollout]


def timed(prepare: Callable[[], None], action: Callable[[], object], count: int) -> float:
    """CPU seconds of an action, each of so many."""
    prepare()
    started = time.thread_time()
    action()
    return (time.thread_time() - started) / count


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axis = plt.subplots(figsize=(6, 5), constrained_layout=True)
    shown = [
        (f"{scene}, {effect}, {preset}", float(adjoint))
        for scene, effect, preset, adjoint, *_ in rows
        if adjoint != "-"
    ]
    axis.barh(*zip(*shown, strict=True), color="#2e6f95")
    axis.invert_yaxis()
    axis.set(xlabel="cost of the adjoint [steps]")
    axis.tick_params(labelsize=7)
    write_picture(figure, path)


if __name__ == "__main__":
    main()
