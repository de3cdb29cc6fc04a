"""`soft-tendon learn-strain`: a network for an arm's strain under dead loads, from the exact solution, with its errors and its cost."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field
from tqdm import tqdm

from soft_tendon_env.cli.errors import require
from soft_tendon_env.cli.fields import changed_scene
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.learning.loaded_strain import INTERVALS, STANDARD, Training, exact_model, learn_loaded_strain, learned_model
from soft_tendon_env.mechanics.motion.equilibrium import Linearisation, linearise_balance
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.learned_strain import SUFFIX, LearnedStrain, find_learned, learned_path, read_learned
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration

STOPPED = "stopped: nothing was written"
EVALUATIONS, TURNS = 200, 21


class LearnStrain(Configuration):
    """Train a network for the strain of an arm under its dead loads, from the exact solution, and report its errors and its cost.

    Attributes:
        scene: a shipped scene's name, or the path of a TOML file.
        set: changes of the scene, dotted keys with values as in TOML, such as effects.gravity.acceleration=[0,0,-9.81] or the
            tension_limits within which the strain is to hold.
        samples: exact strains to learn from.
        iterations: of the optimiser on all samples; more of them lower the errors.
        seed: of samples and network.
        out: the file to write, beside the scene say; by default in the user's cache, where every scene with this arm finds it.
        anew: train again where there is one for this arm, these limits and loads.
    """

    scene: str
    set: tuple[str, ...] = ()
    samples: int = Field(default=STANDARD.samples, ge=100, le=1_000_000)
    iterations: int = Field(default=STANDARD.iterations, ge=0, le=100_000)
    seed: int = Field(default=0, ge=0)
    out: str | None = None
    anew: bool = False


def run(arguments: Sequence[str]) -> None:
    """Train it or find it, and report."""
    parser = Parser("learn-strain", LearnStrain)
    settings = parser.read(arguments)
    with parser.mistakes():
        scene = changed_scene(settings.scene, settings.set)
        if settings.out is not None and not settings.out.endswith(".npz"):
            raise ValueError(f"--out is {settings.out}: it should be the path of a .npz file, such as {Path(settings.scene).stem}{SUFFIX}")
        exact_model(scene)
        path = learned_path(scene) if settings.out is None else Path(settings.out)
        learned = None if settings.anew else present(scene, path if settings.out else None)
        if learned is None:
            require("agents")
    if learned is None:
        training = Training(samples=settings.samples, iterations=settings.iterations, seed=settings.seed)
        with tqdm(total=100, desc="exact strains and their network", unit="%", bar_format="{desc}: {percentage:3.0f}%|{bar}|") as bar:
            learned = learn_loaded_strain(scene, training, lambda part: bar.update(100 * part - bar.n))
        learned.save(path)
        print(f"written: {path}\n")
    print(report(scene, learned))
    named = f', file = "{path.name}"' if settings.out else ""
    print(f'\nIn the scene\'s file:\n\n[strain]\ninclude_loads = {{ type = "learned"{named} }}')


def present(scene: Scene, path: Path | None) -> LearnedStrain | None:
    """One that was trained for this very arm, its limits and loads: that in the file, or any."""
    found = find_learned(scene) if path is None else read_learned(path) if path.exists() else None
    return found if found is not None and found.fits(scene) and not found.misfit(scene) else None


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
    ready, times = {}, dict[str, list[float]]()
    for name, model in models.items():
        n = model.coordinate_count
        out = Linearisation(np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, EVALUATIONS)))
        still, directions = np.zeros(model.tendon_count), np.zeros((EVALUATIONS, n))
        ready[name] = (model.arm, still, np.zeros(n), 1.0, False, directions, make_workspace(model.arm), out)
        linearise_balance(*ready[name])
        times[name] = []
    for _ in range(TURNS):
        for name, arguments in ready.items():
            started = time.process_time()
            linearise_balance(*arguments)
            times[name].append((time.process_time() - started) / (EVALUATIONS + 1))
    return {name: float(np.median(own)) for name, own in times.items()}
