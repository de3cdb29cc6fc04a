"""Passive strain fields of an arm by proper orthogonal decomposition (POD), for any scene.

The motions are simulated.

Full physics moves under random tensions and loads; what its section wrenches have that the tendons
cannot make, at every sample w = Sigma (xi - xi*) - Phi_a(xi) tau with the least-squares tensions
tau, is what the passive coordinates of (30) have to make. The leading singular vectors of these
residuals are the fields, in the norm of the displacements and rotations along the rod that they
make.
"""

import hashlib
import itertools
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

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
from soft_tendon_env.model.grid import (
    Grid,
    actuation_columns,
    screw_matrices,
    tendon_geometry,
)
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.reference_model import LEVELS, Level, reference_model
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields, arm_of
from soft_tendon_env.scene.scene import Scene, breakpoints, rod_length
from soft_tendon_env.scene.strain import MOST_SNAPSHOT_FIELDS, SNAPSHOT_ORDER, STRAINS
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import new_data_folder
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

TRAINED: tuple[Motion, ...] = (*USUAL, "wild")
"""Kinds of motions that snapshots are taken of; fields are tested on the usual ones."""

RUNS = 10
"""Motions of each kind that snapshots are taken of."""

FIRST_SEED = 1000
"""The first of their seeds."""

SHORT = 0.5
"""Duration [s] of the motions by which the level of full physics is chosen."""

WILD = 0.2
"""Weight of samples of wild motions."""

ENERGY = 0.01
"""Weight of energy beside displacements, which fix no field that moves nothing."""

RESOLVED = 1e-3
"""Share of the rod's length by which full physics, of which snapshots are taken, may change at its
next refinement."""

TESTS = 2
"""Motions of each usual kind that fields are tested on."""

COUNTS = (0, 3, 4, 6, 7, 8, 9, 10, 12, 15, 18, 24)
"""Numbers of fields that are tested."""

TEST_STEP = 0.005
"""Integrator step [s] of these tests, whose error is far below that of the fields."""

TEST_COLUMNS = 4
"""Columns of extrapolation of these tests."""

TEST_INTERVALS = 16
"""Quadrature intervals per piece of these tests."""

REFERENCE = 1e-4
"""Error of the reference motions, as a share of the rod's length."""

DIGITS = 9
"""Digits of the coefficients."""

DEPENDENT = 1e-4
"""Relative size of tensions' fields that count as combinations of others."""

NOISE = 1e-9
"""Relative singular value below which a field is round-off."""


def make_passive_fields(scene: Scene) -> PassiveFields:
    """Simulates the reference under random inputs, and decomposes its residual wrenches.

    The tensions and loads are those that the scene may meet; the residuals are what its tendons
    cannot make.

    Loads are those of the scene in half of the motions, and in the other half of random direction
    and size up to theirs; obstacles are left out. Raises ConfigurationError where full physics has
    none of the motions.
    """
    strain = {
        "type": "statics_based",
        "strains": list(scene.strain.free),
        "borders": list(scene.strain.borders),
    }
    changes = {"effects": scene.effects.everywhere(), "strain": strain}
    bare = scene.replace(changes)
    samples, grid = snapshots(bare)
    coefficients, singular_values = decompose(bare, samples, grid)
    tension_limits = [tendon.tension_limits for tendon in scene.tendons]
    limits = np.array(tension_limits)
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

    Raises OSError where it has no folder.
    """
    made_for = [
        arm_of(scene),
        [tendon.tension_limits for tendon in scene.tendons],
        scene.effects.everywhere().model_dump(mode="json"),
    ]
    text = json.dumps(made_for, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()
    name = f"{digest[:16]}{SUFFIX}"
    return new_data_folder("fields") / name


def snapshots(scene: Scene) -> tuple[Array, Grid]:
    """Residual wrenches (samples, 6 points) of RUNS motions of every kind, times their weights.

    They come with the grid of their points.
    """
    level = snapshot_level(scene)
    resolution = RESOLVED * rod_length(scene)
    steps = step_tolerance(scene, level, resolution)

    def residuals(run: Run) -> Array | None:
        effects = scene.effects
        if run.number % 2:  # half of the motions have other loads
            motion_number = MOTIONS.index(run.kind)
            seeds = [run.number, motion_number]
            random = np.random.default_rng(seeds)
            effects = effects.sample_smaller(random)
        table = effects.model_dump(mode="json", exclude_none=True)
        loaded = scene.replace({"effects": table})
        model = reference_model(loaded, level, steps)
        seed = FIRST_SEED + run.number
        tensions = motion_tensions(scene, run.kind, seed)
        motion = trajectory(model, tensions)
        if motion is None:
            return None
        # the first sample is the same in all motions
        wrenches = residual_wrenches(model, motion.q[1:])
        if run.kind == "wild":
            weight = WILD
        else:
            weight = 1.0
        in_rows = wrenches.reshape(len(wrenches), -1)
        return weight * in_rows

    runs = [Run(kind, number) for number in range(RUNS) for kind in TRAINED]
    label = f"{scene.name}: snapshots of full physics"
    results = run_all(residuals, runs, processors(), label, unit="motion", threads=True)
    wrenches = [wrench for wrench in results if wrench is not None]
    if not wrenches:
        text = "full physics diverges under every motion that passive fields are made from"
        raise ConfigurationError([Problem((), text)])
    every_wrench = np.concatenate(wrenches)
    return every_wrench, reference_model(scene, level).grid


class Run(NamedTuple):
    """A motion that snapshots are taken of."""

    kind: Motion
    number: int


def snapshot_level(scene: Scene) -> Level:
    """The coarsest full physics whose motion the next one hardly changes."""
    trial = [motion_tensions(scene, kind, FIRST_SEED, SHORT) for kind in USUAL]
    resolution = RESOLVED * rod_length(scene)
    finer = reference_motions(scene, trial, resolution).level
    return LEVELS[LEVELS.index(finer) - 1]


def residual_wrenches(model: Model, q: Array) -> Array:
    """Residual wrenches Sigma (xi - xi*) - Phi_a(xi) tau at the points (samples, points, 6).

    tau is by least squares in the norm of the compliance.
    """
    scene = model.scene
    grid = model.grid
    samples = len(q)

    # strain xi = xi* + Phi q of every sample, angular and linear components
    packed = make_workspace(model.arm).strain.Phi
    packed = packed.reshape(model.coordinate_count, -1)
    fields = grid.unpacked(packed)
    change = np.einsum("sj,jpc->spc", q, fields)
    reference = grid.unpacked(model.arm.rod.reference_strain)
    strain = change + reference
    k, p = np.split(strain, 2, axis=-1)

    # what the tensions make, Phi_a(xi), in the norm of the compliance
    every_point = tendon_geometry(scene, grid)
    geometry = every_point[:, grid.real]
    geometry = geometry.reshape(model.tendon_count, -1, 5)
    elasticity, root = energy_norm(scene, grid)
    curvature = k[:, None]
    position = p[:, None]
    columns = actuation_columns(geometry, curvature, position)
    actuation = columns * root
    actuation = actuation.reshape(samples, model.tendon_count, -1)

    # what is left of Sigma (xi - xi*) beside that
    wrench = change * elasticity * root
    wrench = wrench.reshape(samples, -1)
    residual = np.empty_like(wrench)
    for row, sample in enumerate(wrench):
        basis = actuation[row].T
        tau, *_ = np.linalg.lstsq(basis, sample, rcond=DEPENDENT)
        residual[row] = sample - basis @ tau

    # back from the norm; strains that the rod has not stay zero
    exists = root > 0.0
    divisor = np.where(exists, root, 1.0)
    residual = residual.reshape(strain.shape)
    return residual / divisor * exists


def energy_norm(scene: Scene, grid: Grid) -> tuple[Array, Array]:
    """Sigma and the root of compliance times weight at the points, (points, 6) each.

    The latter is 0 where the rod has no such strain.
    """
    points = grid.points[grid.real]
    places = points.ravel()
    elasticity, _, _ = screw_matrices(scene, places)
    free = [strain in scene.strain.free for strain in STRAINS]
    exists = np.array(free, dtype=float)
    weights = grid.weights[grid.real]
    weight = weights.ravel()
    compliance = exists / elasticity
    squares = compliance * weight[:, None]
    return elasticity, np.sqrt(squares)


def decompose(scene: Scene, samples: Array, grid: Grid) -> tuple[Array, Array]:
    """Legendre coefficients (fields, pieces, 6, orders) of the leading fields of wrenches.

    Wrenches are (samples, 6 points); their singular values come with them.
    """
    measured = []
    for measure, share in make_measures(scene, grid):
        values = samples @ measure.T
        size = np.linalg.norm(values)
        values_of_kind = np.sqrt(share) * values
        measured.append(values_of_kind / size)
    matrix = np.concatenate(measured, axis=1)
    left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)

    # the leading ones
    is_seen = sizes > NOISE * sizes[0]
    above_noise = int(np.count_nonzero(is_seen))
    count = min(MOST_SNAPSHOT_FIELDS, above_noise)
    weights = left[:, :count].T
    fields = weights @ samples

    # of unit energy
    _, root = energy_norm(scene, grid)
    scaled = fields * root.ravel()
    energy = np.linalg.norm(scaled, axis=1, keepdims=True)
    fields = fields / energy
    fields = fields.reshape(count, -1, 6)
    coefficients = fit_polynomials(fields, scene, grid)
    kept = sizes[:count]
    relative = kept / sizes[0]
    return coefficients, relative


def make_measures(scene: Scene, grid: Grid) -> tuple[tuple[Array, float], ...]:
    """Measures (m, 6 points) of wrenches (points, 6), with their weights.

    They are displacements and rotations along the rod, and energy.
    """
    places = grid.points[grid.real].ravel()
    weight = grid.weights[grid.real].ravel()
    elasticity, root = energy_norm(scene, grid)

    # integral from the base to each point, with half of the weight of the point itself
    is_before = places[:, None] > places
    before = is_before * weight
    half = 0.5 * np.diag(weight)
    reach = before + half
    lever = reach @ reach
    size = len(reach)

    # of a straight rod along x: rows are points and axes, columns points and strains
    moved = np.zeros((size, 3, size, 6))
    turned = np.zeros((size, 3, size, 6))
    for axis in range(3):
        moved[:, axis, :, 3 + axis] = reach
        turned[:, axis, :, axis] = reach
    moved[:, 1, :, 2] += lever  # bending about z moves along y
    moved[:, 2, :, 1] -= lever

    # a wrench strains by the compliance, and each point counts by its weight
    compliance = (root > 0.0) / elasticity
    density = np.sqrt(weight)[:, None, None, None]
    shape = (3 * size, 6 * size)
    displacement = moved * compliance * density
    displacement = displacement.reshape(shape)
    rotation = turned * compliance * density
    rotation = rotation.reshape(shape)
    energy = np.diag(root.ravel())
    return (displacement, 1.0), (rotation, 1.0), (energy, ENERGY)


def fit_polynomials(fields: Array, scene: Scene, grid: Grid) -> Array:
    """Legendre coefficients (fields, pieces, 6, orders) of fields at the points.

    Fields are (fields, points, 6); their largest one is positive.
    """
    borders = breakpoints(scene)
    places = grid.points[grid.real].ravel()
    count = len(fields)
    orders = SNAPSHOT_ORDER + 1
    pieces = borders.size - 1
    shape = (count, pieces, 6, orders)
    coefficients = np.zeros(shape)
    for piece, (a, b) in enumerate(itertools.pairwise(borders)):
        inside = (places > a) & (places < b)
        from_base = places[inside] - a
        doubled_share = 2 * from_base / (b - a)
        place = doubled_share - 1  # -1 to 1 along the piece
        basis = legendre.legvander(place, SNAPSHOT_ORDER)

        # least squares for every field and component at once
        values = fields[:, inside]
        values = np.moveaxis(values, 1, 0)
        values = values.reshape(len(basis), -1)
        solution, *_ = np.linalg.lstsq(basis, values, rcond=None)
        solution = solution.reshape(orders, count, 6)
        coefficients[:, piece] = np.moveaxis(solution, 0, -1)

    # the sign that makes the largest coefficient positive
    flat = coefficients.reshape(count, -1)
    column = np.abs(flat).argmax(axis=1)
    row = np.arange(count)
    largest = flat[row, column]
    largest = largest[:, None, None, None]
    positive = coefficients * np.sign(largest)
    return rounded(positive, np.abs(largest))


def rounded(values: Array, largest: Array) -> Array:
    """Values with as many decimals as leave DIGITS digits of the largest one."""
    leading = np.floor(np.log10(largest))
    unit = 10.0 ** (leading + 1 - DIGITS)
    whole = np.round(values / unit)
    return np.asarray(whole * unit)


def tip_errors(scene: Scene, fields: PassiveFields) -> dict[str, tuple[float, ...]]:
    """Largest tip distance [m] from the reference, for COUNTS of the fields.

    It is on TESTS other motions of each usual kind, under the loads.
    """
    counts = [count for count in COUNTS if count <= len(fields.coefficients)]
    inputs = [motion_tensions(scene, kind, seed) for kind in USUAL for seed in range(TESTS)]
    resolution = REFERENCE * rod_length(scene)
    exact = reference_motions(scene, inputs, resolution).tips
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tested.json"
        fields.save(path)

        def largest(count: int) -> Array:
            table = {"type": "snapshots", "fields": count, "file": str(path)}
            changes = {
                "strain.passive": table if count else [],
                "integrator": {"step": TEST_STEP, "columns": TEST_COLUMNS},
            }
            model = model_on(scene.replace(changes), TEST_INTERVALS)
            errors = np.empty(len(inputs))
            for place, tensions in enumerate(inputs):
                path_of_model = tip_path(model, tensions)
                errors[place] = distance(path_of_model, exact[place])
            by_kind = errors.reshape(len(USUAL), TESTS)
            return by_kind.max(axis=1)

        label = f"{scene.name}: tests of the fields"
        results = run_all(largest, counts, processors(), label, unit="model", threads=True)

    errors_of = {"fields": tuple(map(float, counts))}
    table = np.array(results)
    for column, kind in enumerate(USUAL):
        errors = table[:, column]
        errors_of[kind] = tuple(errors.tolist())
    return errors_of
