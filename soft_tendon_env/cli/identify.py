"""`soft-tendon identify`: parameters of an arm from measured marker positions, with intervals, held-out errors and findings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field

from soft_tendon_env.cli.arms import ArmSettings
from soft_tendon_env.cli.errors import writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.identification.identify import FIDELITY, identify
from soft_tendon_env.identification.output import save_estimate, summary
from soft_tendon_env.identification.recordings import SHARE
from soft_tendon_env.tools.types import GivenLength

STOPPED = "stopped: nothing was written"


class Identify(ArmSettings):
    """Identify an arm from measured marker positions: estimate parameters of its scene by least squares, and judge them on held-out data.

    Attributes:
        data: CSV files: a row a hold (columns hold, tension_i or displacement_i, MARKER_x, MARKER_y, MARKER_z) or, with a column
            time, a sample of a motion that begins at rest.
        markers: TOML file with the markers' places on the arm, the frame of the data, and names and units of its columns (by default SI).
        parameters: keys such as segments.*.young_modulus, mount.rotation, markers.*.offset or commands.*.gain; KEY=LOW..HIGH with bounds,
            KEY~SIGMA with a prior's standard deviation (of factors in parts of the value).
        held_out: held-out recordings that judge the fit: a share or a number, stratified by tension; a column that marks them, or 0.
        noise: standard deviation of a marker's coordinate, such as 0.5mm; by default it is estimated.
        fidelity: of the model that is fitted: fast, standard, fine, scene or a length such as 1mm.
        out: folder for scene.toml, markers.toml and estimate.json.
    """

    data: tuple[str, ...] = Field(min_length=1)
    markers: Annotated[str, Field(json_schema_extra={"flag": "--markers"})]
    parameters: Annotated[tuple[str, ...], Field(min_length=1, json_schema_extra={"flag": "--parameters"})]
    held_out: str = SHARE
    noise: GivenLength | None = None
    fidelity: str = FIDELITY
    out: str = "out/identified"


def run(arguments: Sequence[str]) -> None:
    """Identify, print and write."""
    parser = Parser("identify", Identify)
    settings = parser.read(arguments)
    with parser.mistakes():
        scene = settings.changed_scene()
        out = writable_folder(Path(settings.out))
        judged = {"held_out": settings.held_out, "fidelity": settings.fidelity}
        found = identify(scene, settings.data, settings.markers, settings.parameters, noise=settings.noise, **judged)
    print(summary(found))
    for path in save_estimate(found, out):
        print(f"written: {path}")
