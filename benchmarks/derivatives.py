"""CPU time of derivatives relative to a plain step, and their error on every arm that ships and with every effect.

    python benchmarks/derivatives.py [--quick] [--soromox] [--write-docs] [--out out]

Control periods are 20 ms.

- Cost, on the paper's arm at every preset: CPU time per row and period on one thread, divided by that of a plain step with its reading.
  Both are measured in turns; the number is the median ratio. "adjoint" is `Arms.adjoint` of the state and the tip's pose. "of all readings"
  adds the tip's twist, tendon lengths, strains and their rates. "rollout" is `Simulation.rollout` of a period.
- Gradient, at the presets "fast" and "standard": cosine between the adjoint's gradient and central differences of the same rollout, and the
  ratio of their lengths, the least cosine of three rollouts. The gradient is that of a tracking error over 16 periods by all commands,
  which change by up to 5 % of their range every period (`differentiable.accuracy`), and by up to 20 % for "quick, fast". "-": no
  adjoint. Where stiff tendons hang slack the motion has kinks, and differences of two step sizes are no nearer to each other.
- Linearisation: the largest error of the blocks of `Simulation.rollout` by state and by tension, in percent of the largest entry of those
  of `Simulation.linearize`, in units of the coordinates, after six periods with other tensions. The larger of the two presets. "-":
  commands are no tensions.

With --soromox, where the extra `peers` is installed, below the tables: the gradient of a period by SoRoMoX, on the same arm.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_page, write_picture

import soft_tendon_env as ste
from soft_tendon_env.accuracy.test_inputs import HOLD, motion_tensions
from soft_tendon_env.differentiable import gradient_accuracy
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation

PRESETS = ("fast", "standard", "fine")
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARMS: dict[str, dict[str, Any]] = {
    "bare": {},
    "50 g and gravity": {**GRAVITY, "effects.tip_load.mass": 0.05},
    "in water": {**GRAVITY, "effects.fluid.density": 1000.0},
    "actuators": {"effects.actuators": {"time_constant": 0.03, "delay": 0.02}},
}
FLOOR = {"obstacles": [{"type": "plane", "position": [0.0, 0.0, -0.05]}]}
EFFECTS: dict[str, dict[str, Any]] = {
    "gravity": GRAVITY,
    "tip_load": {**GRAVITY, "effects.tip_load.mass": 0.005},
    "fluid": {**GRAVITY, "effects.fluid.density": 1000.0},
    "disturbance": {"effects.disturbance.loads": [{"at": 0.3, "force": [0.0, 0.05, 0.0], "signal": {"type": "sine", "frequency": 2.0}}]},
    "moving_base": {"effects.moving_base": {"amplitude": [0.0, 0.02, 0.0], "frequency": 2.0}},
    "nonlinear_elasticity": {"effects.nonlinear_elasticity.bending": 3.0},
    "actuators": {"effects.actuators": {"time_constant": 0.03, "delay": 0.03}},
    "tendon_elasticity, 2 kN/m": {"effects.tendon_elasticity": {"stiffness": 2e3, "displacement_limits": [0.0, 0.01]}},
    "tendon_elasticity, 20 kN/m": {"effects.tendon_elasticity": {"stiffness": 2e4, "displacement_limits": [0.0, 0.01]}},
    "contact": {**GRAVITY, "effects.contact": FLOOR},
    "tendon_friction": {"effects.tendon_friction.coefficient": 0.2},
    "viscoelastic_memory": {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.2}]},
}
SHIPPED = ("paper", "three_tendon", "four_tendon", "helical", "two_segment_six", "catheter", "underwater")
CASES = [
    *((scene, "as it is", {}) for scene in SHIPPED),
    *(("paper", name, table) for name, table in ARMS.items() if table),
    *(("three_tendon", name, table) for name, table in EFFECTS.items()),
]
CHANGE, QUICK, SEEDS = 0.05, 0.2, 3
LIVELY = 10  # periods of motion before costs are measured
SENSORS = (0.25, 0.5, 0.75, 1.0)  # of the length
COSTS = ("adjoint", "of all readings", "rollout")
COST_HEADER = ("preset", "arm", "coordinates", "step [us]", *COSTS)
OF_GRADIENTS = (*(f"{name}, {preset}" for preset in PRESETS[:2] for name in ("cosine", "ratio")), "quick, fast")
ERROR_HEADER = ("arm", "effect", *OF_GRADIENTS, "by state [%]", "by tension [%]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="try the script: one preset of two arms")
    parser.add_argument("--soromox", action="store_true", help="measure the gradient by SoRoMoX too")
    parser.add_argument("--write-docs", action="store_true", help=f"write {DOCS.name}")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    presets, arms, cases = (PRESETS[:1], ("bare",), CASES[10:11]) if arguments.quick else (PRESETS, tuple(ARMS), CASES)
    times, errors = [], []
    for preset in presets:
        for arm in arms:
            model = ste.build_model(ste.load_scene("paper").replace(ARMS[arm]), preset)
            step, found = costs(model, 3 if arguments.quick else 15)
            times.append((preset, arm, model.coordinate_count, f"{step:.0f}", *(f"{cost:.1f}" for cost in found)))
            print(*times[-1], flush=True)
    for scene, effect, changes in cases:
        models = [ste.build_model(ste.load_scene(scene).replace(changes), preset) for preset in PRESETS[:2]]
        away = np.max([rollout_error(model) for model in models], axis=0)
        percent = ("-" if np.isnan(share) else f"{100.0 * share:.0f}" for share in away)
        errors.append((scene, effect, *(text for model in models for text in accuracy(model)), accuracy(models[0], QUICK)[0], *percent))
        print(*errors[-1], flush=True)
    text = f"{markdown_table(COST_HEADER, times)}\n\n{markdown_table(ERROR_HEADER, errors)}\n" + (of_soromox() if arguments.soromox else "")
    print(f"\n{machine()}\n\n{text}")
    if arguments.write_docs:
        title, _, told = __doc__.split("\n\n", 2)
        write_page(DOCS, "Cost and error of derivatives", (title, told, text))
    write_csv(arguments.out / "derivatives.csv", ERROR_HEADER, errors)
    draw(times, arguments.out / "derivatives.png")


DOCS = Path(__file__).parent.parent / "docs" / "appendix" / "derivatives_measured.md"


def accuracy(model: Model, change: float = CHANGE) -> tuple[str, str]:
    """Least cosine of a few rollouts, with the ratio of lengths of that one."""
    least, greatest = model.scene.effects.command_limits(np.array([tendon.tension_limits for tendon in model.scene.tendons])).T
    try:
        found = [gradient_accuracy(model, HOLD, least, greatest, change * (greatest - least), seed) for seed in range(SEEDS)]
    except ValueError:  # effects whose states follow the motion
        return "-", "-"
    return f"{min(found).cosine:.4f}", f"{min(found).ratio:.2f}"


def rollout_error(model: Model) -> tuple[float, float]:
    """Largest errors of a linearisation by state and by tension, as shares of the largest entries."""
    n, simulation, random = model.coordinate_count, Simulation(model), np.random.default_rng(0)
    least, greatest = model.scene.effects.command_limits(np.array([tendon.tension_limits for tendon in model.scene.tendons])).T
    simulation.reset_at_rest()
    for _ in range(6):
        simulation.step(least + 0.2 * (greatest - least) * random.random(least.size), HOLD)
    command = least + 0.2 * (greatest - least) * random.random(least.size)
    cheap, exact, scale = simulation.rollout(command[None], HOLD), simulation.linearize(command, HOLD), model.coordinate_scale()
    unit = np.append(scale, scale / HOLD)
    pairs = ((cheap.by_state[0] * unit, exact.state[: 2 * n, : 2 * n] * unit), (cheap.by_tension[0], exact.command[: 2 * n]))
    by_state, by_tension = (np.abs((x - y) / unit[:, None]).max() / max(np.abs(y / unit[:, None]).max(), 1e-30) for x, y in pairs)
    return by_state, np.nan if model.arm.effects.transmission.acts else by_tension


def placed(model: Model, rows: int) -> Arms:
    """Rows at rest under their loads."""
    arms = Arms(model, rows, HOLD, np.zeros(0), model.length * np.array(SENSORS), threads=1)
    arms.place(np.arange(rows), np.tile(Simulation(model).reset_at_rest().q, (rows, 1)))
    return arms


def costs(model: Model, repeats: int) -> tuple[float, tuple[float, ...]]:
    """Microseconds of a plain step with its reading, and what derivatives cost in such steps."""
    rows = 32
    arms, members, tape = placed(model, rows), np.arange(rows), None
    table = np.stack([motion_tensions(model.scene, "increments", row, (LIVELY + 1) * HOLD) for row in range(rows)])
    for k in range(LIVELY):
        arms.step(np.ascontiguousarray(table[:, k : k + 1]), members)
    simulation = Simulation(model)
    simulation.reset(arms.rows.q[0], arms.rows.q_dot[0], effects=arms.rows.state[0], time=float(arms.rows.clock[0, 0]))
    kept = {name: getattr(arms.rows, name).copy() for name in ("q", "q_dot", "xi", "state", "clock", "step")}
    command, tape, cotangents = np.ascontiguousarray(table[:, LIVELY:]), arms.make_tape(), arms.make_cotangents()
    random, few, many = np.random.default_rng(0), ("q", "q_dot", "tip_pose"), ("tip_twist", "tendon_length", "strain", "strain_rate")
    drawn = {name: random.normal(size=getattr(cotangents, name).shape) for name in (*few, *many)}

    def restore() -> None:
        for name, values in kept.items():
            getattr(arms.rows, name)[:] = values

    def give(names: tuple[str, ...]) -> None:
        for name, values in drawn.items():
            getattr(cotangents, name)[:] = values if name in names else 0.0

    def adjoint() -> None:
        arms.adjoint(tape, members, cotangents)

    ways: tuple[tuple[Callable[[], None], Callable[[], object], int], ...] = (
        (restore, lambda: arms.step(command, members, None, tape), rows),
        (lambda: give(few), adjoint, rows),
        (lambda: give((*few, *many)), adjoint, rows),
        (lambda: None, lambda: simulation.rollout(command[0, :1], HOLD), 1),
    )
    times = np.array([[timed(*way) for way in ways] for _ in range(repeats + 1)][1:])
    return 1e6 * float(np.median(times[:, 0])), tuple(np.median(times[:, 1:] / times[:, :1], axis=0).tolist())


def timed(prepare: Callable[[], None], action: Callable[[], object], count: int) -> float:
    """CPU seconds of an action, each of so many."""
    prepare()
    started = time.thread_time()
    action()
    return (time.thread_time() - started) / count


def of_soromox() -> str:
    """Cost of a gradient by SoRoMoX, in words."""
    from _peers.soromox_strains import DISTRIBUTION, NAME, gradient_cost

    own = gradient_cost(ste.load_scene("paper"), order=1, step=0.5 * HOLD)
    period, gradient = (f"{1e6 * seconds:.0f} us" for seconds in (own.period, own.gradient))
    return (
        f"\n{NAME} {version(DISTRIBUTION)} on the same arm, bare ({own.coordinates} coordinates, two steps of implicit Euler a period): a "
        f"period takes {period}, and `jax.grad` of a scalar of its end by state and tensions {gradient}.\n"
    )


def draw(times: list[tuple[Any, ...]], path: Path) -> None:
    figure, axis = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for preset in dict.fromkeys(own[0] for own in times):
        names, adjoint = zip(*((own[1], float(own[4])) for own in times if own[0] == preset), strict=True)
        axis.plot(names, adjoint, "o-", label=preset)
    axis.set(ylabel="cost of the adjoint [steps]", ylim=(0.0, None))
    axis.legend(frameon=False, fontsize=7)
    axis.grid(alpha=0.3)
    write_picture(figure, path)


if __name__ == "__main__":
    main()
