"""`soft-tendon fields`: an arm's own passive strain fields, from snapshots of full physics (proper orthogonal decomposition)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.calibration import own_fields
from soft_tendon_env.accuracy.jump_test import jump_test
from soft_tendon_env.accuracy.proper_orthogonal_fields import KINDS, fields_path, make_passive_fields
from soft_tendon_env.accuracy.test_inputs import USUAL
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.cli.scenes import coordinate_count
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields, read_fields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import MOST_SNAPSHOT_FIELDS, StaticsBased
from soft_tendon_env.tools.configuration import Configuration, parsed_change
from soft_tendon_env.tools.types import length_text, read_length

STOPPED = "stopped: nothing was written"


class Fields(Configuration):
    """Make the passive strain fields of an arm's own from simulated motions (POD), and report how accurate the arm is with them.

    Attributes:
        scene: a shipped scene's name, or the path of a TOML file.
        set: changes of the scene, dotted keys with values as in TOML, such as effects.gravity.acceleration=[0,0,-9.81]; its loads, and
            smaller ones in all directions, act on half of the motions each.
        coordinates: how many the arm is to have, actuation included, to report on.
        within: error of the tip to stay within on motions of the usual kinds, such as 1mm, to report on the fewest fields that do.
        out: the file to write, beside the scene say; by default in the user's cache, where every scene with this arm finds it.
        anew: make them again where there are some for this arm, these limits and loads.
    """

    scene: str
    set: tuple[str, ...] = ()
    coordinates: int | None = Field(default=None, ge=1)
    within: str | None = None
    out: str | None = None
    anew: bool = False


def run(arguments: Sequence[str]) -> None:
    """Make them or find them, and report."""
    parser = Parser("fields", Fields)
    settings = parser.read(arguments)
    with parser.mistakes():
        scene = changed_scene(settings.scene, settings.set)
        tolerance = None if settings.within is None else read_length(settings.within)
        own = coordinate_count(_with_fields(scene, 0, {}))
        if settings.coordinates is not None and not own <= settings.coordinates <= own + MOST_SNAPSHOT_FIELDS:
            most = own + MOST_SNAPSHOT_FIELDS
            raise ValueError(f"--coordinates is {settings.coordinates}: the arm has {own} without passive fields, {most} with all")
        path = fields_path(scene) if settings.out is None else Path(settings.out)
        if not path.name.endswith(".json"):
            raise ValueError(f"--out is {path}: it should be the path of a .json file, such as {Path(settings.scene).stem}{SUFFIX}")
        fields = None if settings.anew else present(scene, path if settings.out else None)
    if fields is None:
        fields = make_passive_fields(scene)
        fields.save(path)
        print(f"written: {path}\n")
    print(report(scene, fields, own))
    count = None if settings.coordinates is None else settings.coordinates - own
    if tolerance is not None:
        count = fields.needed(tolerance, USUAL)
        if count is None:
            print(f"\nNot even {len(fields.coefficients)} fields keep the tip within {length_text(tolerance)} on all of those motions.")
    if count:
        chosen = _with_fields(scene, count, {"file": str(path)} if settings.out else {"digest": fields.digest})
        print(f"\n{hard_cases(chosen)}\n\nIn the scene's file, for {own + count} coordinates:\n\n[strain]")
        named = f', file = "{path.name}"' if settings.out else ""
        print(f'passive = {{ type = "snapshots", fields = {count}{named} }}')


def changed_scene(name: str, changes: Sequence[str]) -> Scene:
    """A scene with changes "key=value". Raises ConfigurationError, ValueError."""
    scene = load_scene(name)
    return scene.replace(dict(parsed_change(change) for change in changes)) if changes else scene


def present(scene: Scene, path: Path | None) -> PassiveFields | None:
    """Fields that were made for this very arm, its limits and loads: those in the file, or any."""
    if path is not None:
        fields = read_fields(path) if path.exists() else None
        return fields if fields is not None and fields.fits(scene) and not fields.misfit(scene) else None
    return own_fields(scene)


def _with_fields(scene: Scene, count: int, which: dict[str, str]) -> Scene:
    passive = {"type": "snapshots", "fields": count, **which} if count else []
    strain: dict[str, Any] = {"type": "statics_based", "strains": list(scene.strain.free), "borders": list(scene.strain.borders)}
    strain["passive"] = passive
    if isinstance(scene.strain, StaticsBased) and scene.strain.include_loads:
        strain |= scene.strain.model_dump(include={"include_loads"}, exclude_none=True)
    return scene.replace({"strain": strain})


def report(scene: Scene, fields: PassiveFields, own: int) -> str:
    """Table of the errors by number of fields."""
    counts = np.array(fields.errors["fields"], dtype=int)
    rows = []
    for i, count in enumerate(counts):
        errors = [number(1e3 * fields.errors[kind][i]) for kind in KINDS]
        rest = "-" if not count else f"{fields.singular_values[count - 1]:.2g}"
        rows.append((str(own + count), str(count), rest, *errors))
    header = ("coordinates", "fields", "singular value", *(f"{kind} [mm]" for kind in KINDS))
    intro = (
        f"{scene.name}, {1e3 * fields.borders[-1]:.4g} mm long, digest {fields.digest}. Errors: largest distance of the tip from full "
        "physics\non motions that the fields were not made from, converged in time. Singular value: of the last field, in parts of the "
        "first's."
    )
    return f"{intro}\n\n{markdown_table(header, rows)}"


def hard_cases(scene: Scene) -> str:
    """Table of abrupt loads."""
    rows = [
        (found.case, "yes" if found.survived else "NO", str(found.rejected), number(found.phantom)) for found in jump_test(scene)
    ]
    return markdown_table(("abrupt load", "survived", "rejected steps", "largest |tension| of the strain / applied"), rows)
