"""Trial of an arm: the coordinates, quadrature and time steps that keep its tip within a share of
its length of full physics.

A trial is made once, in seconds, under the scene's loads and within its tension limits, and kept in
the user's cache. The arm is without obstacles, and without what lies between commands and tensions.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from filelock import FileLock

from soft_tendon_env.accuracy.input_motions import USUAL, motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.model.coordinates import coordinate_count
from soft_tendon_env.model.full_physics import part_borders
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.passive_fields import PassiveFields, fields_of, find_fields
from soft_tendon_env.scene.scene import (
    MOST_INTERVALS,
    Scene,
    breakpoints,
    extrapolation_columns,
    rod_length,
)
from soft_tendon_env.scene.strain import STRAINS, Snapshots, StaticsBased
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.files import (
    digest,
    new_data_folder,
    read_json,
    replacing,
    sources_digest,
)
from soft_tendon_env.tools.messages import say_once

SEED, SECONDS, RESTS = (
    500,
    2.0,
    16,
    # of the motions, one of each usual kind; equilibria under random tensions, besides the slack
    # arm's
)
# by which the error on these stays below what is asked for, since other motions may be worse
MARGIN = 2.0
REFERENCE, UNSURE = (
    0.1,
    10.0,
    # of what is asked for: error aimed at in full physics, and the largest that anything is judged
    # by
)
FIELDS, ROD, PIECE, EXPLICIT = (
    (6, 9, 12, 18, 24),
    (1, 2, 3, 4, 6, 8, 10, 12),
    (1, 2, 3, 4, 5, 6, 7, 9),
    (4, 6, 9),
)
"""Numbers of the arm's own passive fields, Legendre orders over the rod, over each part of it, and
of explicit strain, that are tried."""
FEW, RICH, FINER, SETTLED, SOME, TIGHTER, MOST, RICHEST, MOST_LEVELS = (
    3,
    5,
    10.0,
    0.15,
    3,
    5.0,
    5,
    3,
    3,
)
"""Orders of moments and explicit strain that steps and quadrature are settled with; finer ones, by
how much, change the tip by less than a part of what is asked for, in each of so many inputs; by how
much and how often steps are tightened; how many of the richest strains are compared where none
does; levels of full physics."""
SOURCES = tuple(
    f"{folder}/**/*.py" for folder in ("mechanics", "effects", "scene", "model", "accuracy")
)


class Accuracy(NamedTuple):
    """Accuracy that is asked of the tip and, to begin with, of the parts of a simulation, as shares
    of the rod's length."""

    share: float  # largest distance of the tip from full physics
    fields: float  # as measured for passive fields that ship, or that `soft-tendon fields` made
    quadrature: float  # at rest, whatever the tensions within limits
    least: int  # intervals per piece
    tolerance: float  # of a time step


class Choice(NamedTuple):
    """Coordinates, quadrature and time steps that a trial chose, and the error that it measured."""

    strain: dict[str, Any]
    quadrature: dict[str, Any]
    integrator: dict[str, Any]
    coordinates: int
    # bound of the tip's distance from full physics, as a share of the length; inf: full physics has
    # none of the motions
    error: float
    # motions and equilibria that full physics does not have, or leaves open: a column may fall
    # either way
    left_out: int = 0

    def of(self, scene: Scene) -> Scene:
        """The scene with this choice."""
        return scene.replace(
            {name: getattr(self, name) for name in ("strain", "quadrature", "integrator")}
        )

    def with_strain(self, scene: Scene, strain: dict[str, Any]) -> Choice:
        """The choice with another strain table, and at least as many intervals along the rod as
        that needs. Raises ConfigurationError."""
        changed = scene.replace({"strain": strain})
        spread = (breakpoints(scene).size - 1) / (breakpoints(changed).size - 1)
        order = (
            2 if "fields" in strain.get("passive", ()) else changed.strain.highest_order
        )  # leading POD modes are smooth
        least = max(math.ceil(self.quadrature["least"] * spread), order + 2)
        return self._replace(
            strain=strain,
            quadrature={**self.quadrature, "least": least},
            coordinates=coordinate_count(changed),
        )

    def finer(self, intervals: float, steps: float = 1.0) -> Choice:
        """The choice with so many times as many intervals, and a tolerance of time steps that is so
        many times less."""
        quadrature = {**self.quadrature, "least": math.ceil(intervals * self.quadrature["least"])}
        return self._replace(
            quadrature=quadrature, integrator={"tolerance": self.integrator["tolerance"] / steps}
        )

    def describe(self, scene: Scene) -> str:
        """The choice in words, with the error that was measured."""
        modes = self.strain.get("modes", self.strain.get("passive", []))
        if isinstance(modes, dict):
            name = f"{modes['fields']} POD modes"
        elif modes:
            kind = (
                "explicit strain"
                if "modes" in self.strain
                else f"passive {', '.join(modes[0]['strains'])}"
            )
            name = (
                f"{kind} up to order {modes[0]['order']} over"
                f" {'the rod' if modes[0]['span'] == 'rod' else 'each part'}"
            )
        else:
            name = "the tensions alone"
        bound = (
            f"{100 * self.error:.2g} % of the length, {1e3 * self.error * rod_length(scene):.2g} mm"
        )
        left_out = (
            f" without {self.left_out} inputs under which the arm's motion is not unique"
            if self.left_out
            else ""
        )
        return f"{name}, {self.coordinates} coordinates, were within {bound}, in a trial{left_out}"


def bare_rod(scene: Scene) -> dict[str, Any]:
    """Strain table of the rod alone, without what is a matter of accuracy."""
    if isinstance(scene.strain, StaticsBased):
        return scene.strain.model_dump(
            mode="json", include={"type", "strains", "borders", "rank_tolerance", "include_loads"}
        )
    free = [strain for strain in STRAINS if strain in scene.strain.free]
    return {"type": "statics_based", "strains": free, "borders": list(scene.strain.borders)}


def known_fields(scene: Scene) -> PassiveFields | None:
    """Passive fields of the arm: those of the file that its scene names, or those that ship or are
    kept, the best for its loads first."""
    named = scene.strain.passive if isinstance(scene.strain, StaticsBased) else None
    return (
        fields_of(scene)
        if isinstance(named, Snapshots)
        else find_fields(scene.replace({"strain": bare_rod(scene)}))
    )


def snapshots(scene: Scene, fields: PassiveFields, count: int) -> dict[str, Any]:
    """Strain table with this many of the passive fields."""
    file = getattr(getattr(scene.strain, "passive", None), "file", None)
    table = {
        "type": "snapshots",
        "fields": count,
        "digest": fields.digest,
        **({"file": file} if file else {}),
    }
    return {**bare_rod(scene), "passive": table if count else []}


def strain_tables(scene: Scene, fields: PassiveFields | None) -> list[dict[str, Any]]:
    """Strain tables that a trial goes through, fewest coordinates first."""
    rod, free, cuts = bare_rod(scene), list(scene.strain.free), part_borders(scene)
    tables = [rod | {"passive": []}]
    if fields is not None:
        tables += [
            snapshots(scene, fields, count) for count in FIELDS if count <= len(fields.coefficients)
        ]
    for strains in ([strain for strain in STRAINS[:3] if strain in free], free):
        moments = [{"strains": strains, "order": order, "span": "rod"} for order in ROD if strains]
        tables += [rod | {"passive": [table]} for table in moments]
        parts = [
            {"strains": strains, "order": order, "span": "piece"} for order in PIECE if strains
        ]
        tables += [
            rod | {"passive": [table], "borders": [*rod["borders"], *cuts]} for table in parts
        ]
    explicit = [{"strains": free, "order": order, "span": "piece"} for order in EXPLICIT]
    tables += [
        {"type": "explicit", "modes": [modes], "borders": [*rod["borders"], *cuts]}
        for modes in explicit
    ]
    sized = list[tuple[int, int]]()
    for i, table in enumerate(tables):
        with contextlib.suppress(ConfigurationError):  # no independent coordinates
            sized.append((coordinate_count(scene.replace({"strain": table})), i))
    return [tables[i] for count, i in sorted(sized) if count]


class Trial:
    """Equilibria and motions of full physics, and distances of models from them."""

    def __init__(self, scene: Scene, share: float) -> None:
        """share: of the rod's length, that models should be judged by."""
        self.scene, self.unit = (
            scene.replace({"effects": scene.effects.everywhere()}),
            share * rod_length(scene),
        )
        low, high = np.array([tendon.tension_limits for tendon in scene.tendons]).T
        rests = [
            np.clip(0.0, low, high),
            *(low + np.random.default_rng(SEED).random((RESTS, low.size)) * (high - low)),
        ]
        is_damped = extrapolation_columns(scene.replace({"integrator": {}})) > 2
        seconds = SECONDS / (
            1.0 + bool(part_borders(scene)) + 3.0 * (not is_damped)
        )  # many coordinates, or short steps, take longer
        inputs = [*rests, *(motion_tensions(scene, kind, SEED, seconds) for kind in USUAL)]
        found = reference_motions(self.scene, inputs, REFERENCE * self.unit, MOST_LEVELS)
        tests = zip(inputs, found.tips, found.tip_errors, strict=True)
        self.tests = [
            (tensions, tips, error)
            for tensions, tips, error in tests
            if tips is not None and error <= UNSURE * self.unit
        ]
        self.left_out = len(inputs) - len(self.tests)

    def model(self, choice: Choice) -> Model:
        """Model of a choice with the fewest of its quadrature intervals."""
        return model_on(choice.of(self.scene), choice.quadrature["least"])

    def distance(self, model: Model, enough: float = np.inf) -> float:
        """Bound of the tip's distance [m] from full physics, whose own uncertainty counts; inf
        where it is more than that and `enough`."""
        worst = 0.0 if self.tests else np.inf
        for i, (tensions, tips, error) in enumerate(self.tests):
            off = distance(tip_path(model, tensions), tips)
            worst = max(worst, off + error)
            if off > max(enough, error):
                self.tests.insert(0, self.tests.pop(i))  # it may well tell the next one too
                return np.inf
        return worst

    def agree(self, first: Choice, second: Choice, dimension: int, part: float = SETTLED) -> bool:
        """Whether the tips of two models are apart by a part of what they are judged by at most, at
        some rests (1) or in a motion (2)."""
        models, inputs = (
            (self.model(first), self.model(second)),
            [tensions for tensions, *_ in self.tests if tensions.ndim == dimension],
        )
        paths = ([tip_path(model, tensions) for model in models] for tensions in inputs[::SOME])
        return all(
            distance(one, two) <= part * self.unit
            for one, two in paths
            if one is not None and two is not None
        )


def search(scene: Scene, asked: Accuracy) -> Choice:
    """The choice with the fewest coordinates whose error is below what is asked for, by MARGIN; or
    the best there is."""
    trial, length = Trial(scene, asked.share), rod_length(scene)
    settled, best = settle(trial, asked), list[Choice]()
    tables, enough = (
        strain_tables(trial.scene, known_fields(scene)) if trial.tests else [],
        trial.unit / MARGIN,
    )
    for table, most in [
        *((table, enough) for table in tables),
        *((table, np.inf) for table in tables[-RICHEST:]),
    ]:
        with contextlib.suppress(ConfigurationError):  # no independent coordinates
            found = settled.with_strain(trial.scene, table)
            found = found._replace(error=trial.distance(trial.model(found), most) / length)
            if most == enough and np.isfinite(found.error):
                return found
            best += [found] * (most == np.inf)
    return min(best, key=lambda choice: choice.error, default=settled)


def settle(trial: Trial, asked: Accuracy) -> Choice:
    """A choice with few moments whose intervals and time steps are so fine that finer ones hardly
    move the tip."""
    scene, free = trial.scene, list(trial.scene.strain.free)
    order = max(1, RICH - 2 * int(math.log2(breakpoints(scene).size - 1)))  # less on many pieces
    rich: dict[str, Any] = {
        "type": "explicit",
        "modes": [{"strains": free, "order": order, "span": "piece"}],
    }
    rich["borders"] = [*scene.strain.borders, *part_borders(scene)]
    moments = {
        "strains": [strain for strain in STRAINS[:3] if strain in free] or free,
        "order": FEW,
        "span": "rod",
    }
    quadrature = {"tolerance": asked.quadrature, "least": RICH - 1}
    found = Choice(
        rich,
        quadrature,
        {"tolerance": asked.tolerance * rod_length(scene)},
        0,
        np.inf,
        trial.left_out,
    )
    parts = (breakpoints(found.of(scene)).size - 1) / (breakpoints(scene).size - 1)  # of each piece
    found.quadrature["least"] = max(math.ceil(asked.least / parts), RICH - 1)
    while found.quadrature["least"] < MOST_INTERVALS and not trial.agree(
        found, found.finer(2.0), 1
    ):
        found = found.finer(1.3)
    found.quadrature["least"] = math.ceil(parts * found.quadrature["least"])
    found = found.with_strain(scene, bare_rod(scene) | {"passive": [moments]})
    for _ in range(MOST):
        if trial.agree(found, found.finer(1.0, FINER), 2):
            break
        found = found.finer(1.0, TIGHTER)
    return found


def choose(scene: Scene, asked: Accuracy) -> Choice:
    """Choice of a trial of the arm, from the cache or made now. Raises ConfigurationError."""
    key = trial_digest(scene, asked)
    try:
        path = new_data_folder("trials") / f"{key}.json"
    except OSError:  # nothing can be kept
        return search(scene, asked)
    with FileLock(path.with_suffix(".lock")):  # one process makes it, the others find it
        with contextlib.suppress(OSError, ValueError, TypeError):  # none, or damaged
            return Choice(**read_json(path))
        say_once(
            f"the coordinates of {scene.name!r} are chosen by a short trial against a converged"
            f" reference, once: {path}"
        )
        found = search(scene, asked)
        with contextlib.suppress(OSError), replacing(path) as temporary:
            temporary.write_text(json.dumps(found._asdict()))
    say_once(f"{scene.name!r}: {found.describe(scene)}; the bound is {100 * asked.share:.3g} %")
    return found


@functools.cache
def code_digest() -> str:
    """Digest of the sources that a trial depends on."""
    return sources_digest(*SOURCES)


def trial_digest(scene: Scene, asked: Accuracy) -> str:
    """16 hex digits of all that a trial depends on: arm, limits, loads, fields, what is asked for,
    and the code that simulates it."""
    arm = scene.model_dump(
        mode="json",
        exclude={"name", "description", "strain", "quadrature", "integrator", "effects"},
    )
    loads, fields = scene.effects.everywhere(), known_fields(scene)
    code = [
        code_digest(),
        *(digest(Path(inspect.getfile(type(effect)))) for effect in loads.chosen().values()),
    ]
    made_of = [
        arm,
        loads.model_dump(mode="json"),
        bare_rod(scene),
        fields and fields.digest,
        asked,
        code,
    ]
    return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:16]
