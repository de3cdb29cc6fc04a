"""`soft-tendon fields`: an arm's own passive strain fields, from snapshots of full physics (proper
orthogonal decomposition)."""

from pathlib import Path

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.input_motions import USUAL
from soft_tendon_env.accuracy.proper_orthogonal_fields import (
    fields_path,
    make_passive_fields,
)
from soft_tendon_env.cli.errors import mistakes
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.evaluation.tables import markdown_table, measured_number
from soft_tendon_env.model.coordinates import coordinate_count
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import GivenLength


class Fields(ArmSettings):
    """Make the passive strain fields of an arm's own from simulated motions (POD), and report how
    accurate the arm is with them.

    The loads of the scene, and smaller ones in all directions, act on half of the motions each.
    """

    out: str | None = Field(
        default=None,
        description=(
            "the .json file to write; by default in the user's cache, where every scene finds it"
        ),
    )
    within: GivenLength | None = Field(
        default=None,
        description="tolerance of the tip, such as 1mm, to report the fewest fields for",
    )


def run(settings: Fields) -> None:
    """Make, write and report."""
    with mistakes():
        scene = settings.changed_scene()
        out = settings.out
        if out is not None and not out.endswith(".json"):
            raise ValueError(
                f"--out is {out}: it should be the path of a .json file, such as"
                f" {scene.name}{SUFFIX}"
            )
    fields = make_passive_fields(scene)
    if out is None:
        path = fields_path(scene)
    else:
        path = Path(out)
    fields.save(path)
    without_fields = {
        "type": "statics_based",
        "strains": list(scene.strain.free),
        "borders": list(scene.strain.borders),
    }
    bare_count = coordinate_count(scene.replace({"strain": without_fields}))
    text = report(scene, fields, bare_count)
    print(f"written: {path}\n\n{text}")
    if settings.within is None:
        return

    count = fields.needed(settings.within, USUAL)
    if count is None:
        print("\nno number of fields is enough")
        return
    if out is None:
        file = ""
    else:
        file = f', file = "{path.name}"'
    entry = f'passive = {{ type = "snapshots", fields = {count}{file} }}'
    print(f"\nIn the scene, under [strain]: {entry}")


def report(scene: Scene, fields: PassiveFields, bare: int) -> str:
    """Table of the errors by number of fields; the arm has `bare` coordinates without any."""
    rows = []
    counts = np.array(fields.errors["fields"], dtype=int)
    for i, count in enumerate(counts):
        errors = []
        for kind in USUAL:
            millimetres = 1e3 * fields.errors[kind][i]
            errors.append(measured_number(millimetres))
        if count:
            value = fields.singular_values[count - 1]
            singular_value = f"{value:.2g}"
        else:
            singular_value = "-"
        coordinates = str(bare + count)
        rows.append((coordinates, str(count), singular_value, *errors))
    intro = (
        f"{scene.name}, digest {fields.digest}. Errors: largest distance of the tip from a"
        " converged reference on other motions."
    )
    error_names = (f"{kind} [mm]" for kind in USUAL)
    header = ("coordinates", "fields", "singular value", *error_names)
    return f"{intro}\n\n{markdown_table(header, rows)}"
