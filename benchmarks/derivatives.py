"""CPU time of derivatives relative to a plain step, and the angle between gradients of rollouts by the adjoint and by differences.

    python benchmarks/derivatives.py [--quick] [--soromox] [--write-docs] [--out out]

The arm is the paper's at every preset, with and without effects, with control periods of 20 ms.

- Cost: CPU time per row and period on one thread, divided by that of a plain step with its reading. Both are measured in turns; the
  number is the median ratio. "adjoint" is `Arms.adjoint` of the state and the tip's pose. "of all readings" adds the tip's twist, tendon
  lengths, strains and their rates. "in two pieces" is "adjoint" with `pieces=2`. "rollout" is `Simulation.rollout` of a period.
- Direction: 1 - cosine between the gradient by the adjoint and that by differences, a product of matrices of `Simulation.linearize`. The
  cost is half the summed squared distance of the tip from a moving target, over 16 and 64 periods, for all rows together.
- Motions: "smooth" has tensions as sines of 0.8 Hz, "increments" a random walk of up to 2 N every period. The gradient is with respect to
  "commands", every command of every period, or to "changes" of commands, which are the actions with `action="increment"`.

With --soromox, where the extra `peers` is installed, below the tables: the gradient of a period by SoRoMoX, on the same arm.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_page, write_picture

import soft_tendon_env as ste
from soft_tendon_env.accuracy.test_inputs import HOLD, motion_tensions
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.tools.types import Array

PRESETS = ("fast", "standard", "fine")
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARMS: dict[str, dict[str, Any]] = {
    "bare": {},
    "50 g and gravity": {**GRAVITY, "effects.tip_load.mass": 0.05},
    "in water": {**GRAVITY, "effects.fluid.density": 1000.0},
    "actuators": {"effects.actuators": {"time_constant": 0.03, "delay": 0.02}},
}
MOTIONS = ("smooth", "increments")
HORIZONS = (16, 64)  # periods
LIVELY = 10  # periods of motion before costs are measured
SENSORS = (0.25, 0.5, 0.75, 1.0)  # of the length
COSTS = ("adjoint", "of all readings", "in two pieces", "rollout")
PIECES = (1, 2)
DIRECTIONS = tuple(f"{motion}, {by}, {horizon}" for motion in MOTIONS for by in ("commands", "changes") for horizon in HORIZONS)
HEADER = ("preset", "arm", "coordinates", "step [us]", *COSTS, "pieces", *(f"1 - cosine, {name}" for name in DIRECTIONS))


class Result(NamedTuple):
    """Costs and directions of derivatives of one arm at one preset."""

    coordinates: int
    step: float  # [us]
    costs: tuple[float, ...]  # in steps, as COSTS
    apart: Array  # (PIECES, DIRECTIONS) 1 - cosine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="try the script: one preset of two arms")
    parser.add_argument("--soromox", action="store_true", help="measure the gradient by SoRoMoX too")
    parser.add_argument("--write-docs", action="store_true", help=f"write {DOCS.name}")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    presets, arms, count = (PRESETS[:1], ("bare", "actuators"), 1) if arguments.quick else (PRESETS, tuple(ARMS), 4)
    found = {}
    for preset in presets:
        for arm in arms:
            model = ste.build_model(ste.load_scene("paper").replace(ARMS[arm]), preset)
            apart = 1.0 - np.concatenate([cosines(model, motion, count) for motion in MOTIONS], axis=1)
            found[preset, arm] = Result(model.coordinate_count, *costs(model, 3 if arguments.quick else 15), apart)
            print(preset, arm, found[preset, arm], flush=True)
    text = tables(found) + (of_soromox() if arguments.soromox else "")
    print(f"\n{machine()}\n\n{text}")
    if arguments.write_docs:
        title, _, told = __doc__.split("\n\n", 2)
        write_page(DOCS, "Cost and direction of derivatives", (title, told, text))
    rows = [(*key, *own[:2], *own.costs, *each) for key, own in found.items() for each in zip(PIECES, *own.apart.T, strict=True)]
    write_csv(arguments.out / "derivatives.csv", HEADER, rows)
    draw(found, arguments.out / "derivatives.png")


DOCS = Path(__file__).parent.parent / "docs" / "appendix" / "derivatives_measured.md"


class Rollout(NamedTuple):
    """Gradients of a rollout's cost by commands (rows, horizon, n_a), by the adjoint in each of PIECES, and by differences."""

    adjoint: tuple[Array, ...]
    differences: Array


def cosines(model: Model, motion: Any, rows: int) -> Array:
    """Cosines (PIECES, 2 HORIZONS) by commands and by their changes, at each horizon."""
    found = [rollout(model, motion, rows, horizon) for horizon in HORIZONS]
    ways = (lambda x: x, lambda x: np.cumsum(x[:, ::-1], axis=1))
    return np.array([[cosine(way(own.adjoint[i]), way(own.differences)) for way in ways for own in found] for i in range(len(PIECES))])


def cosine(x: Array, y: Array) -> float:
    """Cosine of the angle between two arrays."""
    return float(np.sum(x * y) / np.linalg.norm(x) / np.linalg.norm(y))


def rollout(model: Model, motion: Any, rows: int, horizon: int) -> Rollout:
    """Gradients of a rollout from rest."""
    commands = np.stack([motion_tensions(model.scene, motion, row, (horizon + 1) * HOLD)[:horizon] for row in range(rows)])
    commands += 1e-3 * np.random.default_rng(0).normal(size=commands.shape)  # none is the one before again, see Arms.adjoint
    arms, members = placed(model, rows), np.arange(rows)
    tapes, pulls = [arms.make_tape() for _ in range(horizon)], []
    for k, tape in enumerate(tapes):
        arms.step(np.ascontiguousarray(commands[:, k : k + 1]), members, None, tape)
        pose = arms.reading.tip_pose
        away = pose[:, :3, 3] - target(model, k, rows)
        pulls.append(np.einsum("rji,rj->ri", pose[:, :3, :3], away))
    by_adjoint = tuple(gradient(arms, tapes, pulls, pieces) for pieces in PIECES)
    by_differences = [difference_gradient(model, own, [pull[row] for pull in pulls]) for row, own in enumerate(commands)]
    return Rollout(by_adjoint, np.array(by_differences))


def gradient(arms: Arms, tapes: list[Any], pulls: list[Array], pieces: int) -> Array:
    """Gradient by commands (rows, horizon, n_a), by the adjoint; pulls: derivatives (rows, 3) by the tips' positions."""
    members, cotangents, found = np.arange(arms.size), arms.make_cotangents(), []
    for tape, pull in zip(tapes[::-1], pulls[::-1], strict=True):
        cotangents.tip_pose[:, 3:] = pull
        arms.adjoint(tape, members, cotangents, pieces)
        found.append(cotangents.command[:, 0].copy())
    return np.stack(found[::-1], axis=1)


def placed(model: Model, rows: int) -> Arms:
    """Rows at rest under their loads."""
    arms = Arms(model, rows, HOLD, np.zeros(0), model.length * np.array(SENSORS), threads=1)
    arms.place(np.arange(rows), np.tile(Simulation(model).reset_at_rest().q, (rows, 1)))
    return arms


def target(model: Model, k: int, rows: int) -> Array:
    """Positions (rows, 3) [m] that the tips are to be at after period k, on circles of their own."""
    angle = 0.1 * k + np.arange(rows)
    return model.length * np.stack([np.full(rows, 0.9), 0.2 * np.sin(angle), 0.2 * np.cos(angle)], axis=1)


def difference_gradient(model: Model, commands: Array, pulls: list[Array]) -> Array:
    """Gradient by commands (horizon, n_a) of one row, of the Jacobians of all periods; pulls: derivatives by the tip's position."""
    simulation, maps = Simulation(model), []
    simulation.reset_at_rest()
    for command in commands:
        maps.append(simulation.linearize(command, HOLD))
        simulation.step(command, HOLD)
    later, found = np.zeros(len(maps[0].state)), np.empty_like(commands)
    for k in range(len(maps) - 1, -1, -1):
        own = maps[k]
        by_tip = own.tip[3:].T @ pulls[k]
        found[k] = own.command.T @ later + by_tip[later.size :]
        later = own.state.T @ later + by_tip[: later.size]
    return found


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

    def adjoint(pieces: int = 1) -> None:
        arms.adjoint(tape, members, cotangents, pieces)

    ways: tuple[tuple[Callable[[], None], Callable[[], object], int], ...] = (
        (restore, lambda: arms.step(command, members, None, tape), rows),
        (lambda: give(few), adjoint, rows),
        (lambda: give((*few, *many)), adjoint, rows),
        (lambda: give(few), lambda: adjoint(2), rows),
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


def tables(found: dict[tuple[str, str], Result]) -> str:
    """Tables of costs and of directions."""
    in_steps = [(*key, own.coordinates, f"{own.step:.0f}", *(f"{cost:.1f}" for cost in own.costs)) for key, own in found.items()]
    apart = [
        (*key, pieces, *(f"{value:.0e}" for value in each))
        for key, own in found.items()
        for pieces, each in zip(PIECES, own.apart, strict=True)
    ]
    return f"{markdown_table((*HEADER[:4], *COSTS), in_steps)}\n\n{markdown_table((*HEADER[:2], 'pieces', *DIRECTIONS), apart)}\n"


def of_soromox() -> str:
    """Cost of a gradient by SoRoMoX, in words."""
    from _peers.soromox_strains import DISTRIBUTION, NAME, gradient_cost

    own = gradient_cost(ste.load_scene("paper"), order=1, step=0.5 * HOLD)
    period, gradient = (f"{1e6 * seconds:.0f} us" for seconds in (own.period, own.gradient))
    return (
        f"\n{NAME} {version(DISTRIBUTION)} on the same arm, bare ({own.coordinates} coordinates, two steps of implicit Euler a period): a "
        f"period takes {period}, and `jax.grad` of a scalar of its end by state and tensions {gradient}.\n"
    )


def draw(found: dict[tuple[str, str], Result], path: Path) -> None:
    figure, axis = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for (preset, arm), own in found.items():
        axis.loglog(own.costs[:3:2], own.apart.mean(axis=1), "o-", label=f"{preset}, {arm}")
    axis.set(xlabel="cost of the adjoint in one piece and in two [steps]", ylabel="1 - cosine, mean")
    axis.legend(frameon=False, fontsize=7)
    axis.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
