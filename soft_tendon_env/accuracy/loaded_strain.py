"""Learned strain under dead loads of one arm (paper III-B): a small network trained from the exact solution, with its errors.

The exact strain (35) at many tensions tells the section wrench that the loads make, w = Sigma (xi - xi*) - Phi_a(xi) q_a. Its leading
fields by proper orthogonal decomposition are kept, and a network of the tensions learns their amplitudes. What the model makes of it, and
why any error of the network leaves a sound one: mechanics/terms/learned_strain.py.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from soft_tendon_env.accuracy.proper_orthogonal_fields import energy_norm, fitted_polynomials, weighted_measures
from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.model.coordinates import actuation_columns
from soft_tendon_env.model.grid import tendon_geometry
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.artifacts.artifact import arm_of, polynomials_at
from soft_tendon_env.scene.artifacts.learned_strain import WEIGHTS, LearnedStrain, loads_of
from soft_tendon_env.scene.scene import Scene, breakpoints
from soft_tendon_env.scene.strain import StaticsBased
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.messages import QUIET
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

INTERVALS = 12
"""Intervals of quadrature per piece, at which samples are taken; the fields are polynomials, which go to any other quadrature."""
MARGIN = 0.2
"""Distance that samples reach beyond the limits of tensions, as a share of their range: coordinates of a motion overshoot its tensions."""
DECOMPOSED = 3000  # samples that the fields are made from
AT_ONCE = 500  # samples whose wrenches are computed together
BATCH = 512
LEARNING_RATE = 1e-2  # largest, of Adam
HISTORY = 50  # of L-BFGS
TESTS = 200
"""Unseen tensions that the errors are stated for."""


class Training(NamedTuple):
    """How a learned strain is trained."""

    samples: int = 40_000
    epochs: int = 40  # of Adam, in batches
    iterations: int = 1500  # of L-BFGS afterwards, on all samples
    fields: int = 8
    hidden: int = 32  # of each of two hidden layers, a multiple of 8
    seed: int = 0


STANDARD = Training()


def learn_loaded_strain(scene: Scene, training: Training = STANDARD) -> LearnedStrain:
    """Trains the strain of the scene's arm under its dead loads, for tensions within their limits and MARGIN beyond.

    The same seed gives the same strain on the same machine. Effects that are no dead loads stay outside of a strain and play no role.
    Needs torch.

    Raises ConfigurationError for a scene without dead loads, with an explicit strain, or whose arm does not hold its loads.
    """
    exact = exact_model(scene)
    scene = exact.scene
    limits = np.array([tendon.tension_limits for tendon in scene.tendons])
    wide = limits + MARGIN * np.diff(limits) * np.array([-1.0, 1.0])
    random = np.random.default_rng([training.seed, 0])
    q, strain = _sampled(exact, wide, training.samples, random)
    wrench = _load_wrenches(exact, q, strain)
    measure = _measure(exact, wrench)
    coefficients = _leading_fields(exact, wrench, measure, training.fields)
    fields = polynomials_at(breakpoints(scene), coefficients, exact.grid.points[exact.grid.real].ravel()).reshape(len(coefficients), -1)
    seen = fields @ measure.T  # what the fields do, in the norm that counts
    amplitudes = np.linalg.lstsq(seen.T, measure @ wrench.T, rcond=None)[0].T
    root = np.linalg.cholesky(seen @ seen.T)
    extent = np.stack([q.min(axis=0), q.max(axis=0)], axis=1)
    weights = _trained(q, extent, amplitudes @ root, training)
    weights = {**weights, **{name: weights[name] @ np.linalg.inv(root) for name in WEIGHTS[-2:]}}
    learned = LearnedStrain(arm_of(scene), limits, breakpoints(scene), coefficients, extent, loads_of(scene), weights, {})
    errors = tested(exact, learned, np.random.default_rng([training.seed, 1]))
    return replace(learned, errors=errors)


def exact_model(scene: Scene) -> Model:
    """The arm with its dead loads inside the strain exactly, without passive coordinates and other effects. Raises ConfigurationError."""
    if not isinstance(scene.strain, StaticsBased):
        raise ConfigurationError([Problem(("strain", "type"), 'should be "statics_based": explicit strains answer to nothing')])
    if not scene.effects.dead_loads().exist:
        text = "has no dead loads to learn the strain under: gravity, or a force or moment at the tip in the world frame"
        raise ConfigurationError([Problem(("effects",), text)])
    dead = {name: effect for name, effect in scene.effects.chosen().items() if effect.dead_loads() is not None}
    kept = scene.replace({"effects": {}, "strain.passive": [], "strain.include_loads": True})
    model = model_on(kept.replace({"effects": {name: effect.model_dump(mode="json") for name, effect in dead.items()}}), INTERVALS)
    try:
        model.tip_pose(np.zeros(model.coordinate_count))
    except StrainLimitError as error:
        raise ConfigurationError([Problem(("effects",), f"weigh more than the arm holds without tensions: {error}")]) from error
    return model


def _drawn(limits: Array, random: np.random.Generator) -> Array:
    """Tensions (n_a,): some tendons, from few to all, up to a random part of their limits, the others as slack as they can be."""
    slack = np.clip(0.0, *limits.T)
    pulled = random.random(len(limits)) < random.random()
    return np.asarray(slack + np.sqrt(random.random()) * pulled * (random.uniform(*limits.T) - slack))


def _sampled(model: Model, limits: Array, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Random tensions (samples, active) [N] and their exact strains (samples, points, 6). ConfigurationError where most have none."""
    q = np.array([model.rest_coordinates(_drawn(limits, random)) for _ in range(count)])

    def strains(rows: range) -> list[Array | None]:
        return [_strain(model, q[row]) for row in rows]

    parts = [range(first, min(first + AT_ONCE, count)) for first in range(0, count, AT_ONCE)]
    found = [strain for own in run_all(strains, parts, processors(), "exact strains", threads=True) for strain in own]
    kept = [row for row, strain in enumerate(found) if strain is not None]
    if len(kept) < count // 2:
        text = f"have no strain under the loads at {count - len(kept)} of {count} random tensions within them: narrow them"
        raise ConfigurationError([Problem(("tendons", "tension_limits"), text)])
    return q[kept], np.array([found[row] for row in kept])


def _strain(model: Model, q: Array) -> Array | None:
    try:
        return model.grid.unpacked(model.packed_strain(q))
    except StrainLimitError:
        return None


def _load_wrenches(model: Model, q: Array, strain: Array) -> Array:
    """Section wrench that the loads add, Sigma (xi - xi*) - Phi_a(xi) tau: (samples, points x 6), 0 for rigid strains."""
    elasticity, root = energy_norm(model.scene, model.grid)
    geometry = tendon_geometry(model.scene, model.grid)[:, model.grid.real].reshape(model.tendon_count, -1, 5)
    reference, law = model.grid.unpacked(model.arm.rod.reference_strain), model.arm.strain
    assert isinstance(law, Loaded)
    found = []
    for first in range(0, len(q), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        tension = np.array([law.tensions(own) for own in q[some]])
        k, p = np.split(strain[some, None], 2, axis=-1)
        pulled = np.einsum("si,sipc->spc", tension, actuation_columns(geometry, k, p))
        found.append(((strain[some] - reference) * elasticity - pulled) * (root > 0.0))
    wrench = np.concatenate(found)
    return wrench.reshape(len(wrench), -1)


def _measure(model: Model, wrench: Array) -> Array:
    """Effect of wrenches (points x 6): displacements and rotations along the straight rod, and energy, alike in size, (m, points x 6)."""
    parts = weighted_measures(model.scene, model.grid)
    return np.concatenate([np.sqrt(share) * part / np.linalg.norm(wrench[:DECOMPOSED] @ part.T) for part, share in parts])


def _leading_fields(model: Model, wrench: Array, measure: Array, count: int) -> Array:
    """Legendre coefficients (fields, pieces, 6, orders) of the leading fields of the wrenches."""
    some = wrench[:DECOMPOSED]
    left, sizes, _ = np.linalg.svd(some @ measure.T, full_matrices=False)
    count = min(count, int(np.count_nonzero(sizes > 1e-9 * sizes[0])))
    fields = (left[:, :count] / sizes[:count]).T @ some
    return fitted_polynomials(fields.reshape(count, -1, 6), model.scene, model.grid)


def _trained(x: Array, extent: Array, y: Array, training: Training) -> dict[str, Array]:
    """Weights of a network from x (samples, inputs) in a range (inputs, 2) to y (samples, outputs), see mechanics.types.Network.

    Adam in batches, then L-BFGS on all samples; on one thread, since sums in another order would be other weights.
    """
    import torch

    middle, half = extent.mean(axis=1), 0.5 * np.ptp(extent, axis=1)
    unit = float(np.sqrt(np.mean(y**2)))
    inputs, wanted = torch.tensor((x - middle) / half), torch.tensor(y / unit)
    generator, threads = torch.Generator().manual_seed(training.seed), torch.get_num_threads()
    sizes = [x.shape[1], training.hidden, training.hidden, y.shape[1]]
    weights: list[Any] = []
    for own, after in zip(sizes[:-1], sizes[1:], strict=True):
        weights += [torch.randn(own, after, generator=generator, dtype=torch.float64) / own**0.5, torch.zeros(after, dtype=torch.float64)]
    for weight in weights:
        weight.requires_grad_()

    def activation(a: Any) -> Any:
        return a * torch.rsqrt(1.0 + a * a)

    def loss(rows: Any) -> Any:
        hidden = activation(activation(inputs[rows] @ weights[0] + weights[1]) @ weights[2] + weights[3])
        return ((hidden @ weights[4] + weights[5] - wanted[rows]) ** 2).mean()

    torch.set_num_threads(1)
    try:
        batches = -(-len(x) // BATCH)
        adam = torch.optim.Adam(weights)
        rate = torch.optim.lr_scheduler.OneCycleLR(adam, LEARNING_RATE, total_steps=max(training.epochs * batches, 1))
        for _ in tqdm(range(training.epochs), desc="network, Adam", leave=False, disable=QUIET):
            for rows in torch.randperm(len(x), generator=generator).split(BATCH):
                adam.zero_grad()
                loss(rows).backward()
                adam.step()
                rate.step()
        newton = torch.optim.LBFGS(weights, 1.0, training.iterations, 2 * training.iterations, 0.0, 0.0, HISTORY, "strong_wolfe")

        def evaluated() -> Any:
            bar.update()
            newton.zero_grad()
            value = loss(slice(None))
            value.backward()
            return value

        if training.iterations:
            with tqdm(desc="network, L-BFGS", leave=False, disable=QUIET) as bar:
                newton.step(evaluated)
    finally:
        torch.set_num_threads(threads)
    first, first_bias, second, second_bias, third, third_bias = (weight.detach().numpy() for weight in weights)
    first = first / half[:, None]
    arrays = (first, first_bias - middle @ first, second, second_bias, unit * third, unit * third_bias)
    return dict(zip(WEIGHTS, arrays, strict=True))


def learned_model(scene: Scene, learned: LearnedStrain, intervals: int) -> Model:
    """Model of the scene with this learned strain, which is in no file yet."""
    with tempfile.TemporaryDirectory() as folder:
        learned.save(path := Path(folder) / "learned.npz")
        return model_on(scene.replace({"strain.include_loads": {"type": "learned", "file": str(path)}}), intervals)


def tested(exact: Model, learned: LearnedStrain, random: np.random.Generator) -> Mapping[str, float]:
    """Errors at TESTS random tensions within their limits.

    "strain_rms": distance of the strain at q = [u; 0] from the exact one, in the norm of energy, as a share of the latter; "tip_rms" and
    "tip_largest" [m]: of the tip there; "rest_rms", "rest_largest" [m]: of the tip at rest, see Equilibrium.tip_error; "unsettled": how
    many had no rest; "loads_rms" [m]: how far the loads move the tip from where the strain without them has it; "tests": how many
    tensions.
    """
    own, bare = learned_model(exact.scene, learned, INTERVALS), model_on(exact.scene.replace({"strain.include_loads": False}), INTERVALS)
    elasticity, root = energy_norm(exact.scene, exact.grid)
    elastic, reference = root * elasticity, exact.grid.unpacked(exact.arm.rod.reference_strain)
    strain: list[list[Any]] = []
    tip, rest, moved, unsettled = [], [], [], 0
    while len(strain) < TESTS:
        u = _drawn(learned.tension_limits, random)
        q = exact.rest_coordinates(u)
        try:
            right, place = exact.strain(q)[1], exact.tip_pose(q)[:3, 3]
        except StrainLimitError:
            continue
        strain.append([np.linalg.norm(elastic * (own.strain(q)[1] - right)), np.linalg.norm(elastic * (right - reference))])
        tip.append(np.linalg.norm(own.tip_pose(q)[:3, 3] - place))
        moved.append(np.linalg.norm(bare.tip_pose(q)[:3, 3] - place))
        found = static_equilibrium(own, u, q)
        unsettled += not found.converged
        rest.append(found.tip_error if found.converged else np.nan)
    off, whole = np.array(strain).T
    return {
        "strain_rms": float(np.linalg.norm(off) / np.linalg.norm(whole)),
        "tip_rms": _rms(tip),
        "tip_largest": float(np.max(tip)),
        "rest_rms": _rms(rest),
        "rest_largest": float(np.nanmax(rest)),
        "unsettled": float(unsettled),
        "loads_rms": _rms(moved),
        "tests": float(TESTS),
    }


def _rms(values: list[Any]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
