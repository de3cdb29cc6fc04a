"""`soft-tendon identify`: parameters of an arm from measured marker positions, with intervals,
held-out errors and findings."""

from pathlib import Path

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, writable_folder
from soft_tendon_env.cli.options import ArmSettings
from soft_tendon_env.identification.clusters import SHARE
from soft_tendon_env.identification.identify import FIDELITY, identify, save_estimate, summary
from soft_tendon_env.tools.types import GivenLength

DATA = (
    "CSV, .mat or .npz files: a row a hold (hold, tension_i or displacement_i, MARKER_x, MARKER_y,"
    " MARKER_z) or,"
    " with time, a sample of a motion"
)
KEYS = "keys such as segments.*.young_modulus or markers.*.offset; KEY=LOW..HIGH with bounds"
HELD_OUT = (
    "held-out recordings that judge the fit: a share, 0 for none, a column that marks them, or a"
    " file"
)


class Identify(ArmSettings):
    """Identify an arm from measured marker positions: parameters of its scene by least squares,
    judged on held-out data."""

    data: Positional[tuple[str, ...]] = Field(min_length=1, description=DATA)
    markers: str = Field(description="TOML file: markers' places on the arm, frame and columns")
    parameters: tuple[str, ...] = Field(min_length=1, description=KEYS)
    held_out: str = Field(default=SHARE, description=HELD_OUT)
    fit_to: int | None = Field(
        default=None,
        ge=1,
        description="greatest number of recordings to fit to, evenly over the data",
    )
    noise: GivenLength | None = Field(
        default=None, description="standard deviation of a marker's coordinate, such as 0.5mm"
    )
    fidelity: str = Field(
        default=FIDELITY,
        description="of the fitted model: fast, standard, fine, scene or a length such as 1mm",
    )
    out: str = Field(
        default="out/identified",
        description="folder for scene.toml, markers.toml and estimate.json",
    )


def run(settings: Identify) -> None:
    """Identify, print and write."""
    with mistakes():
        scene = settings.changed_scene()
        out = writable_folder(Path(settings.out))
        estimate = identify(
            scene,
            settings.data,
            settings.markers,
            settings.parameters,
            held_out=settings.held_out,
            fit_to=settings.fit_to,
            fidelity=settings.fidelity,
            noise=settings.noise,
        )
    print(summary(estimate))
    for path in save_estimate(estimate, out):
        print(f"written: {path}")
