"""A measured arm identified from its authors' files:
`python examples/tentacle.py FOLDER [--out out/tentacle]`

FOLDER has the CSV files of motion capture that the SoRoMoX authors published
(github.com/tud-phi/soromox, paper_results/ secVa_system_identification/data, MIT licence): one file
a still hold, a line a frame, and behind number and time the positions of five markers in an order
that differs from file to file. Writes holds.csv, tentacle.toml and markers.toml as
`soft-tendon identify` takes them, fits Young's modulus and density, then base and markers too, and
prints the errors on held-out holds.
"""

import argparse
import csv
import itertools
from pathlib import Path

import numpy as np

from soft_tendon_env.identification import identify
from soft_tendon_env.identification.identify import save_estimate
from soft_tendon_env.scene.file import load_scene

PULLEY = 0.0325  # [m], radius: tension is motor torque / radius
ONE = {"005": 0.05, "01": 0.1, "012": 0.12, "015": 0.15, "018": 0.18, "02": 0.2, "025": 0.25}
TORQUES = {  # [N m] of both motors, by the names of the files
    **{f"m1_u{text}": (torque, 0.0) for text, torque in ONE.items()},
    **{f"m2_u{text}": (0.0, torque) for text, torque in ONE.items()},
    **{
        "m12_u00100005": (0.1, 0.05),
        "m12_u001": (0.1, 0.1),
        "m12_u001002": (0.1, 0.2),
        "m12_u002001": (0.2, 0.1),
    },
    **{"m12_u0015002": (0.15, 0.2), "m12_u002": (0.2, 0.2)},
}
FIRST_FIT = ("m1_u01", "m1_u015", "m1_u02", "m1_u025", "m2_u01", "m2_u015", "m2_u02", "m2_u025")
"""Holds that the authors fitted to; the others judge."""
BASE = (0.03, 0.0, -0.013)  # [m], the marker on the mount, in the frame of the data
LINKS = (0.118, 0.092, 0.072, 0.085)  # [m], roughly from each marker to the next, from the mount on
STEPS = {"E and density": (), "with base and markers": ("base", "markers.*.offset")}

SEGMENT = """
[[segments]]
length = {length}
young_modulus = 505e3
poisson_ratio = 0.45
density = 1500.0
damping = 10e3
radius = {{ type = "linear", base = {base}, tip = {tip} }}
"""
TENDON = """
[[tendons]]
end = 0.305
tension_limits = [0.0, 10.0]
routing = {{ type = "converging", start_offset = [{y0}, 0.0057], end_offset = [{y1}, 0.00120125] }}
"""
SCENE = "".join(
    [
        (
            'name = "tentacle"\ndescription = "Solid silicone tentacle of 0.36 m with two'
            ' converging tendons, hanging"\n'
        ),
        "effects.gravity.acceleration = [9.81, 0.0, 0.0]\n",
        SEGMENT.format(length=0.305, base=0.01541, tip=0.00642),
        SEGMENT.format(length=0.055, base=0.00642, tip=0.0048),
        TENDON.format(
            y0=0.00987269, y1=0.00208063
        ),  # at 30 degrees: 0.0114 - 0.0295 s off the axis
        TENDON.format(y0=-0.00987269, y1=-0.00208063),  # at 150 degrees
    ]
)
MARKERS = """# the data have z up, the scene x along the arm
frame.quaternion = [0.7071067811865476, 0.0, -0.7071067811865476, 0.0]
[markers]
p1 = { arc_length = 0.1291, offset = [0.0, 0.0, 0.025] }
p2 = { arc_length = 0.2195, offset = [0.0, 0.0, -0.021] }
p3 = { arc_length = 0.280, offset = [0.0, 0.0, 0.020] }
p4 = { arc_length = 0.360, offset = [0.008, 0.0, 0.0] }
"""


def read_hold(path: Path) -> np.ndarray:
    """Mean positions (4, 3) [m] of the markers p1 to p4 in one file, z up, from the arm's base."""
    points = np.loadtxt(path, delimiter=",")[:, 2:].mean(axis=0).reshape(5, 3)
    mount = int(np.argmin(points[:, 1]))  # the highest: y points down
    away = points - points[mount]
    inside = np.column_stack([away[:, 0], away[:, 2], -away[:, 1]]) + BASE
    others = np.delete(inside, mount, axis=0)

    def stray(order: tuple[int, ...]) -> float:
        """How far the distances along the chain are from those between the markers, squared."""
        points_in_order = others[list(order)]
        chain = np.diff(np.vstack([BASE, points_in_order]), axis=0)
        distances = np.linalg.norm(chain, axis=1)
        return float(((distances - LINKS) ** 2).sum())

    best = min(itertools.permutations(range(4)), key=stray)
    return others[list(best)]


def write_inputs(folder: Path, out: Path) -> int:
    """Write holds.csv, tentacle.toml and markers.toml; returns the number of holds. Raises
    ValueError where the folder has none."""
    names = [name for name in TORQUES if (folder / f"{name}.csv").is_file()]
    if not any(name in FIRST_FIT for name in names):
        raise ValueError(
            f"{folder} has none of the files that are fitted to:"
            f" {', '.join(f'{name}.csv' for name in FIRST_FIT)}"
        )
    out.mkdir(parents=True, exist_ok=True)
    (out / "tentacle.toml").write_text(SCENE)
    (out / "markers.toml").write_text(MARKERS)
    with (out / "holds.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        places = [f"p{i}_{axis}" for i in range(1, 5) for axis in "xyz"]
        writer.writerow(["hold", "tension_0", "tension_1", *places, "held_out"])
        for name in names:
            tension = np.array(TORQUES[name]) / PULLEY
            positions = read_hold(folder / f"{name}.csv")
            writer.writerow([name, *tension, *positions.ravel(), int(name not in FIRST_FIT)])
    return len(names)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/tentacle"))
    arguments = parser.parse_args()
    out = arguments.out
    print(f"{write_inputs(arguments.folder, out)} holds")
    for name, more in STEPS.items():
        asked = ["segments.*.young_modulus", "segments.*.density", *more]
        found = identify(
            load_scene(out / "tentacle.toml"),
            out / "holds.csv",
            out / "markers.toml",
            asked,
            held_out="held_out",
        )
        fitted, held_out = (1e3 * error for error in found.errors)
        print(
            f"{name}: markers are off by {fitted:.1f} mm on the holds of the fit, {held_out:.1f} mm"
            " on the others"
        )
        save_estimate(found, out / name.replace(" ", "_"))
