"""`soft-tendon learn-strain`: a network for an arm's strain under dead loads, from the exact solution, with its errors and its cost."""

import functools
import time
import timeit
from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.loaded_strain import INTERVALS, STANDARD, Training, exact_model, learn_loaded_strain, learned_model
from soft_tendon_env.cli.arms import FileSettings, written
from soft_tendon_env.cli.errors import require
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.mechanics.motion.equilibrium import Linearisation, linearise_balance
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.artifacts.learned_strain import SUFFIX, LearnedStrain, find_learned, learned_path, read_learned
from soft_tendon_env.scene.scene import Scene

STOPPED = "stopped: nothing was written"
EVALUATIONS, TURNS = 200, 21


class LearnStrain(FileSettings):
    """Train a network for the strain of an arm under its dead loads, from the exact solution, and report its errors and its cost.

    It holds for tensions within the scene's limits: --set tendons.0.tension_limits=[0,5] narrows them.

    Attributes:
        samples: number of exact strains to learn from.
        iterations: number of iterations of the optimiser on all samples; more of them lower the errors.
        seed: seed of samples and network.
    """

    samples: int = Field(default=STANDARD.samples, ge=100, le=1_000_000)
    iterations: int = Field(default=STANDARD.iterations, ge=0, le=100_000)
    seed: int = Field(default=0, ge=0)


def run(arguments: Sequence[str]) -> None:
    """Train it or find it, and report."""
    parser = Parser("learn-strain", LearnStrain)
    settings = parser.read(arguments)
    with parser.mistakes():
        scene = settings.changed_scene()
        path = settings.file(learned_path(scene), SUFFIX)
        exact_model(scene)
        learned = settings.present(scene, read_learned, find_learned)
        if learned is None:
            require("agents")
    if learned is None:
        training = Training(samples=settings.samples, iterations=settings.iterations, seed=settings.seed)
        learned = written(learn_loaded_strain(scene, training), path)
    print(report(scene, learned))
    print(f'\nIn the scene\'s file:\n\n[strain]\ninclude_loads = {{ type = "learned"{settings.entry()} }}')


def report(scene: Scene, learned: LearnedStrain) -> str:
    """Errors on unseen tensions, the range, and the cost beside that of the exact and of no loads."""
    errors, low, high = learned.errors, *learned.tension_limits.T
    rows = [
        ("tip, strain at q = [u; 0]", f"{1e3 * errors['tip_rms']:.3g}", f"{1e3 * errors['tip_largest']:.3g}"),
        ("tip at rest", f"{1e3 * errors['rest_rms']:.3g}", f"{1e3 * errors['rest_largest']:.3g}"),
    ]
    inputs, hidden = learned.weights["first"].shape
    ranges = sorted({f"{a:g} to {b:g} N" for a, b in zip(low, high, strict=True)})
    unsettled = f", of which {errors['unsettled']:.0f} have no rest" if errors["unsettled"] else ""
    return "\n".join(
        [
            f"{scene.name}, {1e3 * learned.borders[-1]:.4g} mm long, digest {learned.digest}: {len(learned.coefficients)} fields, network "
            f"{inputs}-{hidden}-{hidden}-{len(learned.coefficients)}.",
            f"Errors on {errors['tests']:.0f} tensions that it was not trained with{unsettled}; the loads move the tip by "
            f"{1e3 * errors['loads_rms']:.3g} mm (rms).",
            f"They hold for tensions of {', '.join(ranges)}. Strain: {100 * errors['strain_rms']:.2g} % (rms, in the norm of energy).\n",
            markdown_table(("distance from the exact strain", "rms [mm]", "largest [mm]"), rows),
            "",
            cost_table(scene, learned),
        ]
    )


def cost_table(scene: Scene, learned: LearnedStrain) -> str:
    """CPU time of one evaluation of the equations of motion, without loads, with them outside, learned and exact."""
    exact = exact_model(scene)
    outside = exact.scene.replace({"strain.include_loads": False})
    times = evaluation_times(
        {
            "without loads": model_on(outside.replace({"effects": {}}), INTERVALS),
            "loads outside of the strain": model_on(outside, INTERVALS),
            "learned": learned_model(exact.scene, learned, INTERVALS),
            "exact": exact,
        }
    )
    bare = next(iter(times.values()))
    rows = [(name, f"{1e6 * own:.1f}", f"{own / bare:.2f}") for name, own in times.items()]
    return markdown_table((f"one evaluation, {INTERVALS} intervals per piece", "CPU [µs]", "ratio"), rows)


def evaluation_times(models: Mapping[str, Model]) -> dict[str, float]:
    """CPU time [s] of one evaluation at rest under slack tendons, by name: in turns, the median."""
    timers = {}
    for name, model in models.items():
        n = model.coordinate_count
        out = Linearisation(np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, EVALUATIONS)))
        still, directions, work = np.zeros(model.tendon_count), np.zeros((EVALUATIONS, n)), make_workspace(model.arm)
        evaluate = functools.partial(linearise_balance, model.arm, still, np.zeros(n), 1.0, False, directions, work, out)
        evaluate()
        timers[name] = timeit.Timer(evaluate, timer=time.process_time)
    turns = [[timer.timeit(1) for timer in timers.values()] for _ in range(TURNS)]
    return dict(zip(timers, (np.median(turns, axis=0) / (EVALUATIONS + 1)).tolist(), strict=True))
