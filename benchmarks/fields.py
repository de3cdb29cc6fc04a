"""Tip error of strain fields: no passive modes, Legendre moments, POD modes, explicit polynomials.
A section of docs/appendix/accuracy.md.

    python benchmarks/fields.py [--scenes paper ...] [--quick] [--out out]

Largest distance of the tip [mm] from a converged reference over 2 s, with converged time
integration. No mode was made from these motions. Loaded arms have gravity, a payload and a tip
force within the loads that their modes were made for.
"""

from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from _scenes import SOFT_ARMS
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import MOTIONS, USUAL, motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.scene.passive_fields import find_fields, read_fields
from soft_tendon_env.scene.scene import Scene, rod_length

KINDS = MOTIONS[:4]
SEEDS = range(100, 103)
OWN = (6, 9, 18)
INTERVALS = 16
STEP = 0.005  # [s]
COLUMNS = 4
REFERENCE = 5e-5  # share of the length
WILD_REFERENCE = 2e-3  # share of the length
ANGULAR = ["torsion", "bend_y", "bend_z"]
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
HEADER = ("scene", "strain fields", "coordinates", *(f"{kind} [mm]" for kind in KINDS))
LOOKS = {
    "Legendre": ("#edae49", "s"),
    "POD": ("#2e6f95", "o"),
    "explicit": ("#d1495b", "^"),
    "none": ("black", "x"),
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", nargs="+", default=SOFT_ARMS, choices=SOFT_ARMS)
    arguments = parser.parse_args()
    seeds, seconds = (SEEDS[:1], 0.2) if arguments.quick else (SEEDS, 2.0)
    cases = [
        (name, scene) for name in arguments.scenes for scene in (ste.load_scene(name), loaded(name))
    ]
    rows = [
        row
        for name, scene in tqdm(cases, desc="arms", leave=False)
        for row in measured(name, scene, seeds, seconds)
    ]
    write_csv(arguments.out / "fields.csv", HEADER, rows)
    draw(rows, arguments.out / "fields.png")
    write_tables(arguments.out / "fields.md", by_strain(rows))


def by_strain(rows: list[tuple[str, ...]]) -> str:
    """A row for every arm: the largest error of the usual motions, and the coordinates, of every
    strain."""
    fields = list(dict.fromkeys(row[1] for row in rows))
    found = {
        (row[0], row[1]): f"{max(row[3 : 3 + len(USUAL)], key=float)} ({row[2]})" for row in rows
    }
    cases = list(dict.fromkeys(row[0] for row in rows))
    return markdown_table(
        ("arm", *fields), [(case, *(found[case, field] for field in fields)) for case in cases]
    )


def loaded(name: str) -> Scene:
    """The scene under loads that its fields were not made from, within those that they were made
    for."""
    most = read_fields(SHIPPED / f"{name}_loaded.fields.json").effects
    smaller = most.sample_smaller(np.random.default_rng(7))
    return ste.load_scene(name).replace(
        {"effects": smaller.model_dump(mode="json", exclude_none=True)}
    )


def strains(scene: Scene) -> Iterator[tuple[str, dict]]:
    """What is compared, with names."""
    yield "none", {"type": "statics_based"}
    yield (
        "Legendre moments 0-2",
        {"type": "statics_based", "passive": [{"strains": ANGULAR, "order": 2, "span": "rod"}]},
    )
    digest = find_fields(scene).digest
    for count in OWN:
        yield (
            f"{count} POD modes",
            {
                "type": "statics_based",
                "passive": {"type": "snapshots", "fields": count, "digest": digest},
            },
        )
    yield (
        "explicit, order 3",
        {"type": "explicit", "modes": [{"strains": STRAINS, "order": 3, "span": "piece"}]},
    )


def measured(name: str, scene: Scene, seeds: range, seconds: float) -> Iterator[tuple[str, ...]]:
    """A row for every strain field."""
    inputs = {
        kind: [motion_tensions(scene, kind, seed, seconds) for seed in seeds] for kind in KINDS
    }
    exact = {}
    for kind in KINDS:
        tolerance = (REFERENCE if kind in USUAL else WILD_REFERENCE) * rod_length(scene)
        exact[kind] = reference_motions(scene, inputs[kind], tolerance).tips
    for label, strain in strains(scene):
        model = model_on(
            scene.replace({"strain": strain, "integrator": {"step": STEP, "columns": COLUMNS}}),
            INTERVALS,
        )
        errors = [largest_error(model, inputs[kind], exact[kind]) for kind in KINDS]
        case = f"{name}, loaded" if scene.effects.chosen() else name
        yield case, label, str(model.coordinate_count), *(f"{1e3 * error:.3g}" for error in errors)


def largest_error(model: ste.Model, inputs: list[np.ndarray], exact: tuple) -> float:
    """Largest error over the motions that the reference completes; inf where the model does not
    complete one of them."""
    errors = [
        distance(tip_path(model, tensions), reference)
        for tensions, reference in zip(inputs, exact, strict=True)
    ]
    return max((error for error in errors if not np.isnan(error)), default=np.nan)


def draw(rows: list[tuple[str, ...]], picture: Path) -> None:
    """Error against coordinates, a panel for every arm, the largest of the usual motions."""
    cases = list(dict.fromkeys(row[0] for row in rows))
    figure, panels = plt.subplots(
        -(-len(cases) // 2),
        2,
        figsize=(11, 3.2 * -(-len(cases) // 2)),
        squeeze=False,
        constrained_layout=True,
    )
    for panel, case in zip(panels.flat, cases, strict=False):
        for kind, (colour, marker) in LOOKS.items():
            chosen = [row for row in rows if row[0] == case and kind in row[1]]
            errors = [max(map(float, row[3 : 3 + len(USUAL)])) for row in chosen]
            panel.plot(
                [int(row[2]) for row in chosen],
                errors,
                marker,
                color=colour,
                linestyle="-",
                label=kind,
            )
        panel.set(yscale="log", xlabel="coordinates", ylabel="largest tip error [mm]", title=case)
        panel.grid(alpha=0.3)
    panels.flat[0].legend()
    write_picture(figure, picture, dpi=110)


if __name__ == "__main__":
    main()
