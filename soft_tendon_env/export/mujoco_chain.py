"""Export of a scene to MuJoCo: the arm as a chain of rigid links in MJCF, and the distance of its
tip from that of the rod.

The rod is cut into elements of one length l, with joints in the middle that have the stiffness and
the Kelvin-Voigt damping of the element: hinges for torsion and bending, slides for stretch and
shear. Links are the stress-free rod between joints. Errors fall with l^2.

At a joint a tendon runs along its tangent in two branches of half its tension: from the joint to an
element ahead, and from an element behind to the joint. A branch across the joint would lose l a^2 /
8 to a kink of angle a, and buckle the chain. These two lose nothing, and what either makes of
bending and twisting together cancels. For the same end the joints' axes are reversed from link to
link.
"""

import copy
import itertools
import math
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Comment, Element, ElementTree, SubElement, indent

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.accuracy.input_motions import HOLD, motion_tensions
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose, skew
from soft_tendon_env.envs.observation import stress_free_strain
from soft_tendon_env.model.grid import disc_inertia, screw_matrices
from soft_tendon_env.model.simulation import simulate
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.scene import (
    Scene,
    disc_rows,
    rod_length,
    rod_radius,
    segment_borders,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.types import Array

KEPT = {
    "gravity": {"acceleration"},
    "tip_load": {"mass", "inertia"},
}  # effects, and what of them, that a chain has
LONGEST_STEP = 2e-3  # [s], MuJoCo's own, which its contacts are made for
SETS, LONGEST_MOTION, MOST_STEPS = (
    20,
    2.0,
    20_000,
)  # that are compared: sets of tensions at rest; [s] and steps after a step of tensions
SLOW = 1e3  # [s], damping by stiffness to come to rest
SETTLED, MOST_TURNS = (
    1e-7,
    50,
    # movement of the tip that counts as rest, as a share of the length, and how often it is looked
    # for
)


class Chain(NamedTuple):
    """Springs and links of a scene, with six strains in the order of STRAINS."""

    stations: Array  # (links + 2,) arc lengths [m] of base, joints and tip
    pose: Array  # (links + 2, 4, 4) of the stress-free rod there, in the world frame
    stiffness: Array  # (links, 6) [N m/rad, N/m]
    damping: Array  # (links, 6) [N m s/rad, N s/m]
    # (links + 1, 6, 6) [kg m^2, kg m, kg] of base and links at their stations, of the last one with
    # the payload
    inertia: Array


def exportable(scene: Scene) -> tuple[Scene, list[str]]:
    """The scene with what a chain in MuJoCo can have, and names of what is left out."""
    effects, load = scene.effects.chosen(), scene.effects.tip_load
    tables = {
        name: effects[name].model_dump(include=keys)
        for name, keys in KEPT.items()
        if name in effects
    }
    left = [name for name in effects if name not in KEPT] + ["force and moment of tip_load"] * bool(
        load and load.acts
    )
    left += ["quasi_static"] * scene.integrator.quasi_static
    return scene.replace({"effects": tables, "integrator.quasi_static": False}), left


def rest_poses(scene: Scene, arc_length: Array) -> Array:
    """Poses (m, 4, 4) of the stress-free rod in the world frame at arc lengths (m,) [m]."""
    places = np.unique([0.0, *arc_length, *segment_borders(scene)])
    twists = np.diff(places)[:, None] * stress_free_strain(scene, 0.5 * (places[1:] + places[:-1]))
    poses = itertools.accumulate(twists, moved_pose, initial=scene.base.pose)
    return np.array([*poses])[np.searchsorted(places, arc_length)]


def make_chain(scene: Scene, links: int) -> Chain:
    """Chain of at least two links; the compliances of an element are in series, by midpoints of at
    least sixteen parts of each."""
    borders = rod_length(scene) * np.linspace(0.0, 1.0, links + 1)
    stations = np.array([0.0, *0.5 * (borders[1:] + borders[:-1]), borders[-1]])
    cuts = np.unique([*np.linspace(0.0, borders[-1], 16 * links + 1), *segment_borders(scene)])
    arc, length = 0.5 * (cuts[1:] + cuts[:-1]), np.diff(cuts)[:, None]
    elasticity, viscosity, density = screw_matrices(scene, arc)
    element = np.searchsorted(borders[1:-1], arc) == np.arange(links)[:, None]
    stiffness = 1.0 / (element @ (length / elasticity))
    damping = stiffness**2 * (element @ (length * viscosity / elasticity**2))
    discs = disc_rows(scene)
    places, lumps = (
        np.array([*arc, *discs[:, 0], borders[-1]]),
        np.vstack([length * density, disc_inertia(discs), scene.effects.payload]),
    )
    link = np.searchsorted(stations[1:-1], places) == np.arange(links + 1)[:, None]
    pose, to_lump = (
        rest_poses(scene, stations),
        np.array([adjoint(inverse_pose(here)) for here in rest_poses(scene, places)]),
    )
    inertia = np.einsum(
        "lp,pki,pk,pkj->lij", link.astype(float), to_lump, lumps, to_lump, optimize=True
    )
    to_world = np.array([adjoint(here) for here in pose[:-1]])
    return Chain(
        stations,
        pose,
        stiffness,
        damping,
        np.einsum("lki,lkm,lmj->lij", to_world, inertia, to_world),
    )


def time_step(scene: Scene, chain: Chain) -> float:
    """Time step [s], a whole part of HOLD: MuJoCo takes damping implicitly and springs explicitly,
    so that an oscillator of inertia m, stiffness k and damping t k is stable up to t + sqrt(t^2 + 4
    m / k)."""
    ratio, own = chain.damping / chain.stiffness, np.diagonal(chain.inertia[1:], axis1=1, axis2=2)
    limit = ratio + np.hypot(
        ratio, np.sqrt(own / chain.stiffness)
    )  # a joint between two links has half of their inertia
    stable = limit[:, [strain in scene.strain.free for strain in STRAINS]].min()
    return HOLD / math.ceil(HOLD / min(LONGEST_STEP, scene.integrator.step / 10.0, 0.5 * stable))


def mujoco_chain(scene: Scene, links: int) -> "ElementTree[Element]":
    """Arm of a scene in MJCF, as a chain of at least two links; see `exportable` for what is left
    out.

    Bodies and geoms `base`, `link_0` ...; joints `torsion_0`, `bend_y_0` ...; site `tip`; spatial
    tendons `tendon_0` ..., with motors `tension_0` ... for tensions [N] within their limits, which
    pull where positive. Geoms do not touch each other.
    """
    scene, left = exportable(scene)
    chain, root, gravity = (
        make_chain(scene, links),
        Element("mujoco", model=scene.name),
        scene.effects.gravity,
    )
    why = (
        f"timestep: at most {LONGEST_STEP:g} s, a tenth of the scene's, half of that at which the"
        " stiffest joint is stable"
    )
    root.append(Comment(f" {why}; left out: {', '.join(left) or 'nothing'} ".replace("--", "- -")))
    down, step = (
        text(gravity.acceleration if gravity else np.zeros(3)),
        text(time_step(scene, chain)),
    )
    SubElement(root, "option", timestep=step, integrator="implicitfast", gravity=down)
    world, tendons, motors = (
        SubElement(root, name) for name in ("worldbody", "tendon", "actuator")
    )
    bodies = [add_body(world, scene, chain, 0)]
    for i in range(1, links + 1):
        bodies.append(add_body(bodies[-1], scene, chain, i))
    SubElement(
        bodies[-1], "site", {"name": "tip", **placed(inverse_pose(chain.pose[-2]) @ chain.pose[-1])}
    )
    for k, tendon in enumerate(scene.tendons):
        path = SubElement(
            tendons, "spatial", name=f"tendon_{k}", width=text(rod_radius(scene, 0.0)[0] / 20.0)
        )
        add_branches(bodies, path, scene, chain, k)
        limits = text(tendon.tension_limits)
        SubElement(
            motors,
            "motor",
            name=f"tension_{k}",
            tendon=f"tendon_{k}",
            gear="-1",
            ctrllimited="true",
            ctrlrange=limits,
        )
    indent(root)
    return ElementTree(root)


def text(numbers: ArrayLike) -> str:
    """Numbers as an attribute."""
    return " ".join(map(repr, np.atleast_1d(np.asarray(numbers, dtype=float)).tolist()))


def placed(pose: Array) -> dict[str, str]:
    """Attributes of a pose (4, 4)."""
    return {
        "pos": text(pose[:3, 3]),
        "quat": text(Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True, scalar_first=True)),
    }


def add_body(parent: Element, scene: Scene, chain: Chain, i: int) -> Element:
    """Body of the base, i = 0, or of link i - 1, with inertia, capsule and joints."""
    name, pose, inertia = (
        f"link_{i - 1}" if i else "base",
        chain.pose[i],
        chain.inertia[i],
    )  # [[J, m c~], [-m c~, m]]
    body = SubElement(
        parent,
        "body",
        {"name": name, **placed(inverse_pose(chain.pose[i - 1]) @ pose if i else pose)},
    )
    mass, centre = inertia[5, 5], inertia[[2, 0, 1], [4, 5, 3]] / inertia[5, 5]
    about = (inertia[:3, :3] + mass * skew(centre) @ skew(centre))[
        [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    ]
    SubElement(body, "inertial", pos=text(centre), mass=text(mass), fullinertia=text(about))
    radius, end = (
        rod_radius(scene, chain.stations[i : i + 2].mean())[0],
        (inverse_pose(pose) @ chain.pose[i + 1])[:3, 3],
    )
    SubElement(
        body,
        "geom",
        name=name,
        type="capsule",
        size=text(radius),
        fromto=text([0.0, 0.0, 0.0, *end]),
        contype="0",
    )
    for j in (3, 4, 5, 0, 1, 2)[:: (-1) ** i] if i else ():
        if STRAINS[j] in scene.strain.free:
            joint = SubElement(
                body,
                "joint",
                name=f"{STRAINS[j]}_{i - 1}",
                type="hinge" if j < 3 else "slide",
                axis=text(np.eye(3)[j % 3]),
            )
            joint.attrib |= {
                "stiffness": text(chain.stiffness[i - 1, j]),
                "damping": text(chain.damping[i - 1, j]),
            }
    return body


def add_branches(bodies: list[Element], path: Element, scene: Scene, chain: Chain, k: int) -> None:
    """Path of tendon k over sites of the bodies. For the part of an element that it passes, and for
    those on either side of a segment's border, the joint gets as much of the tension as bends it by
    the same angle."""
    (start, end), length = (
        tendon_ends(scene, scene.tendons[k]),
        rod_length(scene) / (len(bodies) - 1),
    )
    for i, (before, behind) in enumerate(itertools.pairwise(bodies)):
        joint = (
            inverse_pose(chain.pose[i]) @ chain.pose[i + 1]
        )  # in the frame of the body before it
        cuts = np.unique(
            np.clip([start, end, *segment_borders(scene)], i * length, (i + 1) * length)
        )
        parts, places = np.diff(cuts), 0.5 * (cuts[1:] + cuts[:-1])
        shares = parts / screw_matrices(scene, places)[0][:, 1]
        for place, part, share in zip(places, parts, shares / shares.sum(), strict=True):
            if not start < place < end or share < 1e-9:  # by round-off
                continue
            (offset,), (slope,) = tendon_offset(scene, scene.tendons[k], place)
            at, (strain,) = np.array([0.0, *offset]), stress_free_strain(scene, np.array([place]))
            ahead = part / share * (np.cross(strain[:3], at) + strain[3:] + [0.0, *slope])
            branches = [(at, at + ahead)] * (behind is not bodies[-1]) + [(at - ahead, at)] * (
                i > 0
            )  # none beyond base and tip
            for pair in branches:
                if len(path) or len(branches) != share:
                    SubElement(path, "pulley", divisor=text(len(branches) / share))
                for body, site in (
                    (before, joint[:3, :3] @ pair[0] + joint[:3, 3]),
                    (behind, pair[1]),
                ):
                    name = f"{path.attrib['name']}_site_{len(path)}"
                    SubElement(
                        body,
                        "site",
                        name=name,
                        pos=text(site),
                        size=path.attrib["width"],
                        group="4",
                    )
                    SubElement(path, "site", site=name)


def compare(path: Path, scene: Scene) -> tuple[Array, float, float]:
    """Distances [m] of the tip of an exported scene in MuJoCo, without contact, from that of its
    rod at the preset "fine": at rest under sets of tensions within limits (SETS,), NaN where either
    has no rest; the largest after a step of tensions, and how long [s] that is."""
    import mujoco

    chain, (scene, _) = mujoco.MjModel.from_xml_path(str(path)), exportable(scene)
    chain.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    )
    chain.actuator_ctrllimited[:] = (
        0  # the step begins without tension, also where limits do not allow it
    )
    calm, data, rod = copy.copy(chain), mujoco.MjData(chain), build_model(scene, "fine")
    calm.dof_damping[:], calm.opt.timestep = (
        SLOW * calm.jnt_stiffness,
        0.2 * SLOW,
    )  # a fifth of the way to balance in each step
    tip = data.site("tip").xpos

    def settle(tension: ArrayLike) -> Array:
        mujoco.mj_resetData(chain, data)
        data.ctrl[:] = tension
        for _ in range(MOST_TURNS):
            before = tip.copy()
            mujoco.mj_step(calm, data, nstep=20)
            if math.dist(tip, before) < SETTLED * rod.length:
                return before
        return np.full(3, np.nan)

    least, greatest = np.array([tendon.tension_limits for tendon in scene.tendons]).T
    sets = np.random.default_rng(0).uniform(least, greatest, (SETS, len(least)))
    found = [static_equilibrium(rod, tension) for tension in sets]
    rest = [
        math.dist(settle(u), arm.tip_pose[:3, 3]) if arm.converged else math.nan
        for u, arm in zip(sets, found, strict=True)
    ]
    rows = max(1, int(min(LONGEST_MOTION, MOST_STEPS * chain.opt.timestep) / HOLD))
    tensions, distances = motion_tensions(scene, "step", 0, HOLD * rows), list[float]()
    settle(0.0)
    for tension, pose in zip(
        tensions, simulate(rod, tensions, HOLD * rows, HOLD).tip_pose[1:], strict=True
    ):
        data.ctrl[:] = tension
        mujoco.mj_step(chain, data, nstep=round(HOLD / chain.opt.timestep))
        mujoco.mj_kinematics(chain, data)
        distances.append(math.dist(tip, pose[:3, 3]))
    return np.array(rest), float(np.max(distances)), HOLD * rows
