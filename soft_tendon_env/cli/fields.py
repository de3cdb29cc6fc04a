"""`soft-tendon fields`: an arm's own passive strain fields, from snapshots of full physics (proper orthogonal decomposition)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from soft_tendon_env.accuracy.calibration import own_fields
from soft_tendon_env.accuracy.proper_orthogonal_fields import fields_path, make_passive_fields
from soft_tendon_env.accuracy.test_inputs import USUAL
from soft_tendon_env.cli.arms import ArmSettings
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.cli.scenes import coordinate_count
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.scene.passive_fields import SUFFIX, PassiveFields, read_fields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import MOST_SNAPSHOT_FIELDS
from soft_tendon_env.tools.types import GivenLength, length_text

STOPPED = "stopped: nothing was written"


class Fields(ArmSettings):
    """Make the passive strain fields of an arm's own from simulated motions (POD), and report how accurate the arm is with them.

    The loads of the scene, and smaller ones in all directions, act on half of the motions each.

    Attributes:
        out: the file to write, beside the scene say; by default in the user's cache, where every scene with this arm finds it.
        anew: make it again where there is one for this arm, these limits and loads.
        coordinates: number of coordinates that the arm is to have, actuation included, to report on.
        within: error of the tip to stay within on motions of the usual kinds, such as 1mm, to report on the fewest fields that do.
    """

    out: str | None = None
    anew: bool = False
    coordinates: int | None = Field(default=None, ge=1)
    within: GivenLength | None = None

    def file(self, scene: Scene) -> Path:
        """Path of --out, or the usual one. Raises ValueError where it does not end like a JSON file."""
        if self.out is not None and not self.out.endswith(".json"):
            raise ValueError(f"--out is {self.out}: it should be the path of a .json file, such as {Path(self.scene).stem}{SUFFIX}")
        return fields_path(scene) if self.out is None else Path(self.out)

    def present(self, scene: Scene) -> PassiveFields | None:
        """Fields made for this very arm, its limits and loads, in the file of --out or anywhere; None if there are none."""
        if self.anew:
            return None
        found = own_fields(scene) if self.out is None else read_fields(Path(self.out)) if Path(self.out).exists() else None
        return found if found is not None and found.fits(scene) and not found.misfit(scene) else None

    def entry(self) -> str:
        """End of a scene's entry, which names the file of --out if there is one."""
        return "" if self.out is None else f', file = "{Path(self.out).name}"'


def run(arguments: Sequence[str]) -> None:
    """Make them or find them, and report."""
    parser = Parser("fields", Fields)
    settings = parser.read(arguments)
    with parser.mistakes():
        scene = settings.changed_scene()
        bare = {"type": "statics_based", "strains": list(scene.strain.free), "borders": list(scene.strain.borders)}
        own = coordinate_count(scene.replace({"strain": bare}))
        if settings.coordinates is not None and not own <= settings.coordinates <= own + MOST_SNAPSHOT_FIELDS:
            most = own + MOST_SNAPSHOT_FIELDS
            raise ValueError(f"--coordinates is {settings.coordinates}: the arm has {own} without passive fields, {most} with all")
        path = settings.file(scene)
        fields = settings.present(scene)
    if fields is None:
        fields = make_passive_fields(scene)
        fields.save(path)
        print(f"written: {path}\n")
    print(report(scene, fields, own))
    count = None if settings.coordinates is None else settings.coordinates - own
    if settings.within is not None:
        count = fields.needed(settings.within, USUAL)
        if count is None:
            most = len(fields.coefficients)
            print(f"\nNot even {most} fields keep the tip within {length_text(settings.within)} on all of those motions.")
    if count:
        print(f"\nIn the scene's file, for {own + count} coordinates:\n\n[strain]")
        print(f'passive = {{ type = "snapshots", fields = {count}{settings.entry()} }}')


def report(scene: Scene, fields: PassiveFields, own: int) -> str:
    """Table of the errors by number of fields."""
    counts = np.array(fields.errors["fields"], dtype=int)
    rows = []
    for i, count in enumerate(counts):
        errors = [number(1e3 * fields.errors[kind][i]) for kind in USUAL]
        rest = "-" if not count else f"{fields.singular_values[count - 1]:.2g}"
        rows.append((str(own + count), str(count), rest, *errors))
    header = ("coordinates", "fields", "singular value", *(f"{kind} [mm]" for kind in USUAL))
    intro = (
        f"{scene.name}, {1e3 * fields.borders[-1]:.4g} mm long, digest {fields.digest}. Errors: largest distance of the tip from full "
        "physics\non motions that the fields were not made from, converged in time. Singular value: of the last field, in parts of the "
        "first's."
    )
    return f"{intro}\n\n{markdown_table(header, rows)}"
