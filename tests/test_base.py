"""An arm with its base elsewhere, in surroundings that move along, does all that it did at the world's origin: rotated twins."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.simulation import simulate
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Base

BASE = Base(position=(0.3, -1.2, 0.7), quaternion=(0.6, -0.48, 0.64, 0.0), rotation=(20.0, -35.0, 50.0))
VECTORS = ("acceleration", "force", "moment", "current", "velocity", "amplitude", "axis")
GRAVITY = {"effects.gravity.acceleration": [2.0, -3.0, -9.0]}
LOADS = {**GRAVITY, "effects.tip_load": {"force": [0.0, 0.03, 0.05], "moment": [0.002, 0.0, 0.003], "mass": 0.005}}
WATER = {**GRAVITY, "effects.fluid": {"density": 1000.0, "current": [0.1, 0.2, -0.1]}}
SHAKEN = {"velocity": [0.1, 0.0, 0.2], "acceleration": [0.0, 0.3, 0.0], "amplitude": [0.0, 0.02, 0.01], "frequency": 1.5}
BAR = {"type": "capsule", "position": [0.2, 0.03, 0.0], "radius": 0.01, "length": 0.2, "axis": [0.0, 0.2, 1.0], "velocity": [0, -0.02, 0]}
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
CASES = {
    "no loads": {},
    "gravity and tip load": LOADS,
    "inside the strain": {**LOADS, "strain.include_loads": True},
    "explicit": {**LOADS, "strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}]}},
    "water": WATER,
    "obstacle": {**GRAVITY, "effects.contact": {"obstacles": [BAR], "friction": 0.3}},
    "moving base": {"effects.moving_base": {**SHAKEN, "axis": [1.0, 2.0, 0.0], "angular_velocity": 1.0, "angular_amplitude": 0.2}},
    "friction": {**GRAVITY, "effects.tendon_friction.coefficient": 0.2},
    "push": {"effects.disturbance.loads": [{"at": 0.2, "force": [0.0, 0.1, 0.1], "moment": [0.01, 0.0, 0.0]}]},
}


def moved(value, key=""):
    """A table of effects in the frame of the moved base."""
    if isinstance(value, dict):
        return {name: moved(entry, name) for name, entry in value.items()}
    if isinstance(value, list | tuple) and value and isinstance(value[0], dict):
        return [moved(entry) for entry in value]
    R, r = BASE.pose[:3, :3], BASE.pose[:3, 3]
    return (R @ value + r).tolist() if key == "position" else (R @ value).tolist() if key in VECTORS else value


def twins(changes=(), name="three_tendon"):
    """A scene, and the same with another base and what is around it moved along."""
    scene = load_scene(name).replace({"quadrature.intervals": 6, **dict(changes)})
    return scene, scene.replace({"base": BASE.model_dump(), "effects": moved(scene.effects.model_dump(exclude_none=True))})


def assert_moved(poses, expected, length, share=1e-9):
    """Poses (..., 4, 4) or positions (..., 3) are those expected, moved along with the base."""
    if poses.shape[-2:] == (4, 4):
        np.testing.assert_allclose(poses, BASE.pose @ expected, rtol=0.0, atol=share * length)
    else:
        np.testing.assert_allclose(poses, expected @ BASE.pose[:3, :3].T + BASE.pose[:3, 3], rtol=0.0, atol=share * length)


@pytest.mark.cases("changes", CASES.values(), ids=CASES)
def test_equilibria_and_motions_move_along(changes):
    here, there = map(ste.model.model.model_on, twins(changes), (6, 6))
    rests = [static_equilibrium(model, [2.0, 0.5, 0.0], settle=True) for model in (here, there)]
    assert rests[0].converged and [rest.stable for rest in rests] == [rests[0].stable] * 2
    assert_moved(rests[1].tip_pose, rests[0].tip_pose, here.length)
    motions = [simulate(model, [1.0, 3.0, 0.0], 0.3, 0.05) for model in (here, there)]
    assert_moved(motions[1].tip_pose, motions[0].tip_pose, here.length)
    assert_moved(*(model.backbone(motion.final.q, 7) for model, motion in ((there, motions[1]), (here, motions[0]))), here.length)
