"""A measured arm of three segments identified from its authors' file:
`python examples/three_segment_arm.py FOLDER [--out OUT]`

FOLDER has the CSV files of github.com/ContinuumRoboticsLab/opencr-mujoco, data/sysid/ftdcr_v4 (MIT
licence, Copyright (c) its authors): nine servo displacements [mm] and the tip by motion capture, a
row a hold, in the order of the commands. `soft-tendon identify` reads them by the table [columns]
of markers.toml. Patterns in which eight of the nine cables hang slack are left out of *_train.csv:
what holds the arm there is none of its cables. Their file *_val.csv judges, whole; without it a
quarter of the patterns does. Writes three_segment.toml, markers.toml and holds.csv, fits few
parameters and then more, and prints the tip's errors on held-out holds.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from soft_tendon_env.identification import identify
from soft_tendon_env.identification.identify import save_estimate
from soft_tendon_env.scene.file import load_scene

SERVOS = (4, 3, 9, 5, 2, 8, 6, 1, 7)  # of the cables, three for each segment from the base on
ANGLES = (
    184.0,
    313.0,
    64.0,
    221.0,
    334.0,
    100.0,
    241.0,
    9.0,
    132.0,
)  # [deg], roughly, of the cables around the backbone
LENGTHS = (0.060, 0.0625, 0.064)  # [m] of the segments

SEGMENT = """
[[segments]] # Nitinol wire
length = {length}
radius = 0.0005
young_modulus = 50e9
poisson_ratio = 0.3
density = 6450.0
damping = 1e7
"""
CABLE = """
[[tendons]]
end = {end}
tension_limits = [0.0, 200.0]
routing = {{ type = "surface", fraction = 9.0, angle = {angle} }} # 4.5 mm off the axis
"""
ELASTIC = """
[effects.tendon_elasticity]
stiffness = 7000.0
slack = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
displacement_limits = [-0.013, 0.013]
"""
SCENE = "".join(
    [
        (
            'name = "three_segment"\ndescription = "Nitinol backbone of 0.1865 m, three segments,'
            ' nine cables driven by displacement"\n'
        ),
        # cables bend each segment evenly: constant bending is exact, and there is no torsion
        (
            'strain = { type = "explicit", modes = [{ strains = ["bend_y", "bend_z"], order = 0,'
            ' span = "piece" }] }\n'
        ),
        *(SEGMENT.format(length=length) for length in LENGTHS),
        *(
            CABLE.format(end=round(sum(LENGTHS[: i // 3 + 1]), 4), angle=angle)
            for i, angle in enumerate(ANGLES)
        ),
        ELASTIC,
    ]
)
MARKERS = """frame.quaternion = [0.5, 0.5, 0.5, 0.5] # the data have z along the arm, the scene x
[markers.tip]
arc_length = 0.1865

[columns]
hold = {{ name = "timestamp" }} # a time of its own names each row
group = {{ name = "pattern_label" }} # rows of one motion pattern have errors in common
"tip_*" = {{ unit = "mm" }}
{servos}
"""
SLACKENED = "_tendon"  # in the label of a pattern in which one cable is pulled and no other is taut
STIFFNESS = "effects.tendon_elasticity.stiffness"
SLACK = "effects.tendon_elasticity.slack"
FEW = [
    STIFFNESS,
    "base.rotation.1",
    "base.rotation.2",
    "base.position.0",
    "markers.tip.offset.0",
    f"{SLACK}.3,4,5=-0.002..0.002",
    f"{SLACK}.6,7,8=-0.002..0.002",
]
ANGLES_TOO = [
    *FEW,
    "base.position.1",
    "base.position.2",
    f"{SLACK}.0,1,2=-0.002..0.002",
    *(f"tendons.{i}.routing.angle" for i in range(9)),
]
# the slack of every cable, and the play in which cables stick in their guides
BACKLASH_TOO = [
    STIFFNESS,
    "base",
    "markers.tip.offset.0",
    *(f"{SLACK}.{i}=-0.002..0.002" for i in range(9)),
    "commands.backlash",
]
# parameters, and the greatest number of holds to fit to; where angles are free, a rotation about
# the arm is one of all of them
STEPS = {
    "8 parameters": ([*FEW, "base.rotation.0"], 60),
    "19 parameters": (ANGLES_TOO, 100),
    "18 parameters with backlash": (BACKLASH_TOO, 150),
}


def write_inputs(out: Path) -> None:
    """Write three_segment.toml and markers.toml."""
    out.mkdir(parents=True, exist_ok=True)
    servos = "\n".join(
        f'displacement_{i} = {{ name = "servo_{servo}_mm", unit = "mm" }}'
        for i, servo in enumerate(SERVOS)
    )
    (out / "three_segment.toml").write_text(SCENE)
    (out / "markers.toml").write_text(MARKERS.format(servos=servos))


def file_of(folder: Path, part: str) -> Path | None:
    """The authors' file of a part of the data, "train" or "val". Raises ValueError where there are
    several."""
    found = sorted(folder.rglob(f"*_{part}.csv"))
    if len(found) > 1:
        raise ValueError(f"{folder} has several files *_{part}.csv: {', '.join(map(str, found))}")
    return found[0] if found else None


def write_holds(train: Path, out: Path) -> Path:
    """Write holds.csv, the rows of the training file whose cables are not slack; returns it."""
    header, *rows = train.read_text().splitlines()
    label = header.split(",").index("pattern_label")
    kept = [row for row in rows if SLACKENED not in row.split(",")[label]]
    holds = out / "holds.csv"
    holds.write_text("\n".join([header, *kept]) + "\n")
    return holds


def main(folder: Path, out: Path) -> None:
    if (train := file_of(folder, "train")) is None:
        raise ValueError(f"{folder} has no file *_train.csv")
    judge = file_of(folder, "val")
    write_inputs(out)
    holds = write_holds(train, out)
    scene = load_scene(out / "three_segment.toml")
    print(
        f"judged on {judge.name if judge else 'a quarter of the patterns'}; the tip is off by [mm]"
    )
    for name, (asked, most) in STEPS.items():
        begin = time.process_time()
        estimate = identify(
            scene,
            holds,
            out / "markers.toml",
            asked,
            held_out=judge or 0.25,
            fit_to=most,
            fidelity="scene",
        )
        seconds = time.process_time() - begin
        distance = 1e3 * np.array([*estimate.error_held_out.values()])
        root_mean_square = np.sqrt((distance**2).mean())
        print(
            f"{name} on {len(estimate.error_fit)} holds: mean {distance.mean():.2f}, median"
            f" {np.median(distance):.2f}, root mean square {root_mean_square:.2f} on"
            f" {distance.size} others; {seconds:.1f} s of CPU",
            flush=True,
        )
        for text in estimate.findings:
            print(f"- {text}")
        save_estimate(estimate, out / name.replace(" ", "_"))
    print(
        "the authors' identified model, for comparison: root mean square about 7.7 after alignment"
        " of the means"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/three_segment"))
    arguments = parser.parse_args()
    main(arguments.folder, arguments.out)
