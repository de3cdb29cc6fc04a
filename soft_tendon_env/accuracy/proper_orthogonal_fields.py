"""Passive strain fields of an arm's own by proper orthogonal decomposition (POD) of simulated
motions, for any scene.

Full physics moves under random tensions and loads; what its section wrenches have that the tendons
cannot make, at every sample w = Sigma (xi - xi*) - Phi_a(xi) tau with the least-squares tensions
tau, is what the passive coordinates of (30) have to make. The leading singular vectors of these
residuals are the fields, in the norm of the displacements and rotations along the rod that they
make.
"""

import hashlib
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from soft_tendon_env.accuracy.input_motions import MOTIONS, USUAL, Motion, motion_tensions
from soft_tendon_env.accuracy.reference import (
    distance,
    reference_motions,
    step_tolerance,
    tip_path,
    trajectory,
)
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.full_physics import LEVELS, full_physics
from soft_tendon_env.model.grid import (
    Grid,
    actuation_columns,
    screw_matrices,
    tendon_geometry,
)
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields, arm_of
from soft_tendon_env.scene.scene import Scene, breakpoints, rod_length
from soft_tendon_env.scene.strain import MOST_SNAPSHOT_FIELDS, SNAPSHOT_ORDER, STRAINS
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import new_data_folder
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

KINDS, TRAINED = (
    USUAL,
    (*USUAL, "wild"),
)  # kinds of motions that fields are tested on, and that snapshots are taken of
RUNS, FIRST_SEED = (
    10,
    1000,
)  # motions of each kind that snapshots are taken of, and the first of their seeds
WILD, ENERGY = (
    0.2,
    0.01,
    # weights of samples of wild motions, and of energy beside displacements, which fix no field
    # that moves nothing
)
# of the rod's length: full physics may change by so much at its next refinement, to take snapshots
# of
RESOLVED = 1e-3
TESTS, COUNTS = (
    2,
    (0, 3, 4, 6, 7, 8, 9, 10, 12, 15, 18, 24),
)  # motions of each usual kind, and numbers of fields, that are tested
REFERENCE = 1e-4  # of the rod's length, error of the reference motions
DIGITS, DEPENDENT = (
    9,
    1e-4,
)  # of the coefficients; relative size of tensions' fields that count as combinations of others


def make_passive_fields(scene: Scene) -> PassiveFields:
    """Simulates full physics under the tensions and loads that the scene may meet, and decomposes
    what its tendons cannot make.

    Loads are those of the scene in half of the motions, and in the other half of random direction
    and size up to theirs; obstacles are left out. Raises ConfigurationError where full physics has
    none of the motions.
    """
    strain = {
        "type": "statics_based",
        "strains": list(scene.strain.free),
        "borders": list(scene.strain.borders),
    }
    bare = scene.replace({"effects": scene.effects.everywhere(), "strain": strain})
    coefficients, singular_values = decompose(bare, *snapshots(bare))
    limits = np.array([tendon.tension_limits for tendon in scene.tendons])
    made = PassiveFields(
        arm_of(bare),
        limits,
        breakpoints(bare),
        coefficients,
        bare.effects,
        singular_values,
        errors={},
    )
    return replace(made, errors=tip_errors(bare, made))


def fields_path(scene: Scene) -> Path:
    """File of a scene's fields in the user's cache, named by its arm, tension limits and loads.
    Raises OSError where it has no folder."""
    made_for = [
        arm_of(scene),
        [tendon.tension_limits for tendon in scene.tendons],
        scene.effects.everywhere().model_dump(mode="json"),
    ]
    digest = hashlib.sha256(json.dumps(made_for, sort_keys=True).encode()).hexdigest()
    return new_data_folder("fields") / f"{digest[:16]}{SUFFIX}"


def snapshots(scene: Scene) -> tuple[Array, Grid]:
    """Residual wrenches (samples, 6 points) of RUNS motions of every kind, times their weights, and
    the grid of their points."""
    trial = [motion_tensions(scene, kind, FIRST_SEED, 0.5) for kind in USUAL]
    tolerance = RESOLVED * rod_length(scene)
    level = reference_motions(scene, trial, tolerance).level
    level = LEVELS[
        LEVELS.index(level) - 1
    ]  # the coarsest full physics whose motion the next one hardly changes
    steps = step_tolerance(scene, level, tolerance)

    def residuals(which: tuple[Motion, int]) -> Array | None:
        kind, run = which
        effects = (
            scene.effects
            if run % 2 == 0
            else scene.effects.sample_smaller(np.random.default_rng([run, MOTIONS.index(kind)]))
        )
        model = full_physics(
            scene.replace({"effects": effects.model_dump(mode="json", exclude_none=True)}),
            level,
            steps,
        )
        found = trajectory(model, motion_tensions(scene, kind, FIRST_SEED + run))
        weight = WILD if kind == "wild" else 1.0
        return (
            None
            if found is None
            else weight * residual_wrenches(model, found.q[1:]).reshape(len(found.q) - 1, -1)
        )

    runs = [(kind, run) for run in range(RUNS) for kind in TRAINED]
    wrenches = run_all(
        residuals, runs, processors(), "snapshots of full physics", unit="motion", threads=True
    )
    if not (found := [wrench for wrench in wrenches if wrench is not None]):
        raise ConfigurationError(
            [
                Problem(
                    (), "full physics diverges under every motion that passive fields are made from"
                )
            ]
        )
    return np.concatenate(found), full_physics(scene, level).grid


def residual_wrenches(model: Model, q: Array) -> Array:
    """Sigma (xi - xi*) - Phi_a(xi) tau at the points (samples, points, 6), tau by least squares in
    the norm of the compliance."""
    scene, grid = model.scene, model.grid
    fields = grid.unpacked(make_workspace(model.arm).Phi.reshape(model.coordinate_count, -1))
    strain = np.einsum("sj,jpc->spc", q, fields)
    k, p = np.split(strain + grid.unpacked(model.arm.rod.reference_strain), 2, axis=-1)
    geometry = tendon_geometry(scene, grid)[:, grid.real].reshape(model.tendon_count, -1, 5)
    elasticity, root = energy_norm(scene, grid)
    columns = (actuation_columns(geometry, k[:, None], p[:, None]) * root).reshape(
        len(q), model.tendon_count, -1
    )
    wrench = (strain * elasticity * root).reshape(len(q), -1)
    rest = [
        sample - basis.T @ np.linalg.lstsq(basis.T, sample, rcond=DEPENDENT)[0]
        for sample, basis in zip(wrench, columns, strict=True)
    ]
    exists = root > 0.0
    return np.array(rest).reshape(strain.shape) / np.where(exists, root, 1.0) * exists


def energy_norm(scene: Scene, grid: Grid) -> tuple[Array, Array]:
    """Sigma and the root of compliance times weight at the points, (points, 6) each; the latter is
    0 where the rod has no such strain."""
    elasticity = screw_matrices(scene, grid.points[grid.real].ravel())[0]
    exists = np.array([strain in scene.strain.free for strain in STRAINS], dtype=float)
    return elasticity, np.sqrt(exists / elasticity * grid.weights[grid.real].ravel()[:, None])


def decompose(scene: Scene, samples: Array, grid: Grid) -> tuple[Array, Array]:
    """Legendre coefficients (fields, pieces, 6, orders) of the leading fields of wrenches (samples,
    6 points), and singular values."""
    _, root = energy_norm(scene, grid)
    measures = []
    for measure, share in make_measures(scene, grid):
        seen = samples @ measure.T
        measures.append(np.sqrt(share) * seen / np.linalg.norm(seen))
    left, sizes, _ = np.linalg.svd(np.concatenate(measures, axis=1), full_matrices=False)
    count = min(MOST_SNAPSHOT_FIELDS, int(np.count_nonzero(sizes > 1e-9 * sizes[0])))
    fields = left[:, :count].T @ samples
    fields /= np.linalg.norm(fields * root.ravel(), axis=1, keepdims=True)
    return fit_polynomials(fields.reshape(count, -1, 6), scene, grid), sizes[:count] / sizes[0]


def make_measures(scene: Scene, grid: Grid) -> tuple[tuple[Array, float], ...]:
    """Measures (m, 6 points) of wrenches (points, 6), with their weights: displacements and
    rotations along the rod, and energy."""
    places, weight = grid.points[grid.real].ravel(), grid.weights[grid.real].ravel()
    elasticity, root = energy_norm(scene, grid)
    reach = (places[:, None] > places) * weight + 0.5 * np.diag(
        weight
    )  # integral from the base to each point
    size, lever, compliance = len(reach), reach @ reach, (root > 0.0) / elasticity
    moved, turned = np.zeros((2, size, 3, size, 6))
    for axis in range(3):
        moved[:, axis, :, 3 + axis] = turned[:, axis, :, axis] = reach
    moved[:, 1, :, 2] += lever
    moved[:, 2, :, 1] -= lever
    along = (
        (motion * compliance * np.sqrt(weight)[:, None, None, None]).reshape(3 * size, 6 * size)
        for motion in (moved, turned)
    )
    return *((motion, 1.0) for motion in along), (np.diag(root.ravel()), ENERGY)


def fit_polynomials(fields: Array, scene: Scene, grid: Grid) -> Array:
    """Legendre coefficients (fields, pieces, 6, orders) of fields at the points (fields, points,
    6); their largest one is positive."""
    borders, places = breakpoints(scene), grid.points[grid.real].ravel()
    found = np.zeros((len(fields), borders.size - 1, 6, SNAPSHOT_ORDER + 1))
    for piece, (a, b) in enumerate(zip(borders[:-1], borders[1:], strict=True)):
        inside = (places > a) & (places < b)
        basis = legendre.legvander(2 * (places[inside] - a) / (b - a) - 1, SNAPSHOT_ORDER)
        values = np.moveaxis(fields[:, inside], 1, 0).reshape(inside.sum(), -1)
        solution = np.linalg.lstsq(basis, values, rcond=None)[0].reshape(
            SNAPSHOT_ORDER + 1, len(fields), 6
        )
        found[:, piece] = np.moveaxis(solution, 0, -1)
    flat = found.reshape(len(found), -1)
    largest = np.take_along_axis(flat, np.abs(flat).argmax(axis=1)[:, None], axis=1)[
        :, :, None, None
    ]
    unit = 10.0 ** (np.floor(np.log10(np.abs(largest))) + 1 - DIGITS)
    return np.asarray(np.round(found * np.sign(largest) / unit) * unit)


def tip_errors(scene: Scene, fields: PassiveFields) -> dict[str, tuple[float, ...]]:
    """Largest tip distance [m] from full physics on TESTS other motions of each usual kind, for
    COUNTS of the fields, under the loads."""
    counts = [count for count in COUNTS if count <= len(fields.coefficients)]
    inputs = [motion_tensions(scene, kind, seed) for kind in USUAL for seed in range(TESTS)]
    exact = reference_motions(scene, inputs, REFERENCE * rod_length(scene)).tips
    with tempfile.TemporaryDirectory() as folder:
        fields.save(path := Path(folder) / "tested.json")

        def largest(count: int) -> Array:
            passive = {"type": "snapshots", "fields": count, "file": str(path)} if count else []
            model = model_on(
                scene.replace(
                    {"strain.passive": passive, "integrator": {"step": 0.005, "columns": 4}}
                ),
                16,
            )
            errors = [
                distance(tip_path(model, tensions), tips)
                for tensions, tips in zip(inputs, exact, strict=True)
            ]
            return np.array(errors).reshape(len(USUAL), TESTS).max(axis=1)

        found = np.array(
            run_all(
                largest, counts, processors(), "tests of the fields", unit="model", threads=True
            )
        ).T.tolist()
    return {
        "fields": tuple(map(float, counts)),
        **{kind: tuple(errors) for kind, errors in zip(USUAL, found, strict=True)},
    }
