"""Arms as chains in MuJoCo: what is in the file, and with MuJoCo how near its tip comes to that of
the rod."""

from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from soft_tendon_env.export import mujoco_chain as chain
from soft_tendon_env.model.grid import screw_matrices
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import disc_rows, rod_length, segment_borders

WEIGHT = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.01}
TAPER = {
    "segments.0.radius": {"type": "linear", "base": 0.014, "tip": 0.006},
    "tendons.*.tension_limits": [0.0, 2.0],
    "tendons.0.start": 0.07,
    "tendons.1.end": 0.113,
    "segments.0.discs": {"number": 5, "mass": 0.003, "radius": 0.03},
}
CURVED = {
    "segments.1.curvature": [2.0, 5.0, 1.0],
    "tendons.*.tension_limits": [-1.0, 4.0],
    "base": {"position": [0.1, -0.2, 0.3], "quaternion": [0.5, 0.5, -0.5, 0.5]},
}
ARMS = [
    ("three_tendon", WEIGHT),
    ("three_tendon", TAPER),
    ("helical", {}),
    ("two_segment_six", CURVED),
]


def sites_of(body, pose):
    """Positions of the sites of a body, at a pose in the world, and of those that it carries."""
    found = {
        site.attrib["name"]: pose[:3, :3] @ numbers(site, "pos") + pose[:3, 3]
        for site in body.findall("site")
    }
    for part in body.findall("body"):
        placed = np.eye(4)
        placed[:3, :3] = Rotation.from_quat(numbers(part, "quat"), scalar_first=True).as_matrix()
        placed[:3, 3] = numbers(part, "pos")
        found |= sites_of(part, pose @ placed)
    return found


def numbers(element, name):
    return np.array(element.attrib[name].split(), dtype=float)


@pytest.mark.parametrize(("name", "changes"), ARMS)
def test_the_file_has_masses_tendons_and_limits_of_the_arm(build, tmp_path, name, changes):
    scene = load_scene(name).replace(changes)
    model = build(name, changes)
    chain.mujoco_chain(scene, 15).write(tmp_path / "arm.xml")
    root = ElementTree.parse(tmp_path / "arm.xml").getroot()

    def line_mass(s):
        _, _, inertia = screw_matrices(scene, np.array([s]))
        return inertia[0, 3]

    borders = segment_borders(scene)
    mass = quad(line_mass, 0.0, borders[-1], points=borders[1:-1])[0] + scene.effects.payload[3]
    mass += disc_rows(scene)[:, 1].sum()
    assert sum(float(part.attrib["mass"]) for part in root.iter("inertial")) == pytest.approx(
        mass, rel=1e-5
    )
    sites = sites_of(root.find("worldbody"), np.eye(4))
    np.testing.assert_allclose(
        sites["tip"],
        model.tip_pose(np.zeros(model.coordinate_count))[:3, 3],
        atol=1e-4 * rod_length(scene),
    )
    for path, length in zip(root.iter("spatial"), model.discretisation.tendon_length, strict=True):
        divisor = 1.0
        at = []
        total = 0.0
        for part in path:
            divisor = float(part.attrib.get("divisor", divisor))
            if part.tag == "site":
                at.append(sites[part.attrib["site"]])
            total += (
                np.linalg.norm(at[-1] - at[-2]) / divisor
                if part.tag == "site" and len(at) % 2 == 0
                else 0.0
            )
        assert total == pytest.approx(length, rel=1e-3)
    for motor, tendon in zip(root.iter("motor"), scene.tendons, strict=True):
        assert tuple(numbers(motor, "ctrlrange")) == tendon.tension_limits
        assert motor.attrib["gear"] == "-1"


def test_what_a_chain_cannot_have_is_named_and_rigid_strains_have_no_joint():
    loads = {
        "effects.tip_load": {"mass": 0.1, "force": [1.0, 0.0, 0.0]},
        "effects.tendon_friction.coefficient": 0.1,
    }
    scene = load_scene("underwater").replace(
        {**loads, "strain.strains": ["bend_y", "stretch"], "integrator.quasi_static": True}
    )
    kept, left = chain.exportable(scene)
    assert left == ["fluid", "tendon_friction", "force and moment of tip_load", "quasi_static"]
    assert {*kept.effects.chosen()} == {"gravity", "tip_load"}
    assert not kept.effects.tip_load.acts
    assert kept.effects.payload[3] == 0.1
    joints = [joint.attrib["name"] for joint in chain.mujoco_chain(scene, 2).iter("joint")]
    assert sorted(joints) == ["bend_y_0", "bend_y_1", "stretch_0", "stretch_1"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes"), ARMS)
def test_tips_converge_with_the_square_of_the_number_of_links(tmp_path, monkeypatch, name, changes):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(chain, "SETS", 6)
    scene = load_scene(name).replace(changes)
    found = []
    for links in (10, 20):
        chain.mujoco_chain(scene, links).write(tmp_path / "arm.xml")
        rest, motion, _ = chain.compare(tmp_path / "arm.xml", scene)
        found.append((rest.mean(), motion))
    (coarse, _), (fine, motion) = found
    assert fine < coarse / 2.5
    assert max(fine, motion) < 0.01 * rod_length(scene)
