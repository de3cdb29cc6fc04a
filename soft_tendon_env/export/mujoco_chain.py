"""Export of a scene to MuJoCo: the arm as a chain of rigid links in MJCF.

It also measures the distance of its tip from that of the rod.

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
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Comment, Element, ElementTree, SubElement, indent

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.accuracy.input_motions import HOLD, motion_tensions
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose, skew
from soft_tendon_env.envs.observation import stress_free_strain
from soft_tendon_env.model.grid import disc_inertia, screw_matrices
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import simulate
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.scene import (
    Scene,
    Tendon,
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
}
"""Effects, and what of them, that a chain has."""
PARTS = 16  # of an element, at least, whose compliances are in series
LONGEST_STEP = 2e-3  # [s], MuJoCo's own, which its contacts are made for
SETS = 20  # sets of tensions at rest that are compared
LONGEST_MOTION = 2.0  # [s] that are compared after a step of tensions
MOST_STEPS = 20_000  # of MuJoCo, that are compared after a step of tensions
SLOW = 1e3  # [s], damping by stiffness to come to rest
SETTLING_STEP = 0.2 * SLOW  # [s], a fifth of the way to balance
SETTLED = 1e-7  # movement of the tip that counts as rest, as a share of the length
MOST_TURNS = 50  # how often rest is looked for
STEPS_OF_TURN = 20  # between two looks
LEAST_SHARE = 1e-9  # of an element: parts below it are round-off of borders
JOINT_ORDER = (3, 4, 5, 0, 1, 2)  # of a link's joints, by places in STRAINS


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
    tables = {}
    left = []
    for name, effect in scene.effects.chosen().items():
        if name in KEPT:
            tables[name] = effect.model_dump(include=KEPT[name])
        else:
            left.append(name)
    load = scene.effects.tip_load
    if load is not None and load.acts:
        left.append("force and moment of tip_load")
    if scene.integrator.quasi_static:
        left.append("quasi_static")
    changes = {"effects": tables, "integrator.quasi_static": False}
    return scene.replace(changes), left


def rest_poses(scene: Scene, arc_length: Array) -> Array:
    """Poses (m, 4, 4) of the stress-free rod in the world frame at arc lengths (m,) [m]."""
    borders = segment_borders(scene)
    all_places = [0.0, *arc_length, *borders]
    places = np.unique(all_places)
    lengths = np.diff(places)
    strains = stress_free_strain(scene, _middles(places))
    twists = lengths[:, None] * strains
    # from place to place by the exponential of the twist between them
    poses = itertools.accumulate(twists, moved_pose, initial=scene.base.pose)
    every_pose = np.array([*poses])
    indices = np.searchsorted(places, arc_length)
    return every_pose[indices]


def _middles(borders: Array) -> Array:
    """Middles (m,) between borders (m + 1,)."""
    return 0.5 * (borders[1:] + borders[:-1])


def _membership(borders: Array, places: Array) -> NDArray[np.bool_]:
    """Whether places (p,) are between borders (m + 1,), (m, p); those beyond are of the last."""
    inner_borders = borders[1:-1]
    indices = np.searchsorted(inner_borders, places)
    parts = np.arange(len(borders) - 1)
    return indices == parts[:, None]


def make_chain(scene: Scene, links: int) -> Chain:
    """Chain of at least two links.

    The compliances of an element are in series, by midpoints of at least sixteen parts of each.
    """
    tip = rod_length(scene)
    shares = np.linspace(0.0, 1.0, links + 1)
    borders = tip * shares
    joints = _middles(borders)
    stations = np.array([0.0, *joints, tip])
    pose = rest_poses(scene, stations)
    # parts of the elements, cut at the borders of segments too
    count = PARTS * links + 1
    part_borders = np.linspace(0.0, tip, count)
    all_borders = [*part_borders, *segment_borders(scene)]
    cuts = np.unique(all_borders)
    arc = _middles(cuts)
    length = np.diff(cuts)[:, None]
    elasticity, viscosity, density = screw_matrices(scene, arc)
    is_of_element = _membership(borders, arc)
    part_compliance = length / elasticity
    compliance = is_of_element @ part_compliance
    stiffness = 1.0 / compliance
    # under the same load the parts lose power in proportion to viscosity / elasticity^2
    part_loss = length * viscosity / elasticity**2
    loss = is_of_element @ part_loss
    damping = stiffness**2 * loss
    # masses of the parts, of discs and of the payload
    discs = disc_rows(scene)
    disc_places = discs[:, 0]
    all_places = [*arc, *disc_places, tip]
    places = np.array(all_places)
    rod_inertia = length * density
    payload = scene.effects.payload
    all_lumps = [rod_inertia, disc_inertia(discs), payload]
    lumps = np.vstack(all_lumps)
    inertia = _link_inertia(scene, stations, pose, places, lumps)
    return Chain(stations, pose, stiffness, damping, inertia)


def _link_inertia(scene: Scene, stations: Array, pose: Array, places: Array, lumps: Array) -> Array:
    """Inertia (links + 1, 6, 6) of base and links about their stations.

    Args:
        scene: of the arm.
        stations: (links + 2,) [m], see Chain.
        pose: (links + 2, 4, 4) at the stations.
        places: (p,) arc lengths [m] of what has mass.
        lumps: (p, 6) diagonals of their inertia.
    """
    is_of_link = _membership(stations, places).astype(float)
    lump_poses = rest_poses(scene, places)
    to_lump = _adjoints(inverse_pose(lump_pose) for lump_pose in lump_poses)
    # in the world frame, where those of a link add up
    about_world = np.einsum(
        "lp,pki,pk,pkj->lij", is_of_link, to_lump, lumps, to_lump, optimize=True
    )
    to_world = _adjoints(pose[:-1])
    return np.einsum("lki,lkm,lmj->lij", to_world, about_world, to_world)


def _adjoints(poses: Iterable[Array]) -> Array:
    """Adjoint matrices (m, 6, 6) of m poses (4, 4)."""
    return np.array([adjoint(pose) for pose in poses])


def time_step(scene: Scene, chain: Chain) -> float:
    """Time step of MuJoCo [s], a whole part of HOLD, at which all joints are stable.

    MuJoCo takes damping implicitly and springs explicitly, so that an oscillator of inertia m,
    stiffness k and damping t k is stable up to t + sqrt(t^2 + 4 m / k).
    """
    ratio = chain.damping / chain.stiffness
    link_matrices = chain.inertia[1:]
    link_inertia = np.diagonal(link_matrices, axis1=1, axis2=2)
    # a joint between two links has half of their inertia
    period = np.sqrt(link_inertia / chain.stiffness)
    limit = ratio + np.hypot(ratio, period)
    is_free = [strain in scene.strain.free for strain in STRAINS]
    free_limits = limit[:, is_free]
    half = 0.5 * free_limits.min()
    tenth = scene.integrator.step / 10.0
    longest = min(LONGEST_STEP, tenth, half)
    steps = math.ceil(HOLD / longest)
    return HOLD / steps


def mujoco_chain(scene: Scene, links: int) -> "ElementTree[Element]":
    """Exports the arm of a scene to MJCF, as a chain of rigid links.

    Bodies and geoms `base`, `link_0` ...; joints `torsion_0`, `bend_y_0` ...; site `tip`; spatial
    tendons `tendon_0` ..., with motors `tension_0` ... for tensions [N] within their limits, which
    pull where positive. Geoms do not touch each other. See `exportable` for what is left out.

    Args:
        scene: of the arm.
        links: number of links, at least two.

    Returns:
        The model's XML.
    """
    scene, left = exportable(scene)
    chain = make_chain(scene, links)
    root = Element("mujoco", model=scene.name)
    root.append(Comment(_comment(left)))
    acceleration = np.zeros(3)
    if scene.effects.gravity is not None:
        acceleration = scene.effects.gravity.acceleration
    SubElement(
        root,
        "option",
        timestep=text(time_step(scene, chain)),
        integrator="implicitfast",
        gravity=text(acceleration),
    )
    world = SubElement(root, "worldbody")
    tendons = SubElement(root, "tendon")
    motors = SubElement(root, "actuator")
    base = add_body(world, scene, chain, 0)
    bodies = [base]
    for i in range(1, links + 1):
        parent = bodies[-1]
        body = add_body(parent, scene, chain, i)
        bodies.append(body)
    # in the frame of the last link
    from_last = inverse_pose(chain.pose[-2])
    tip = from_last @ chain.pose[-1]
    attributes = {"name": "tip", **placed(tip)}
    SubElement(bodies[-1], "site", attributes)
    base_radius = rod_radius(scene, 0.0)[0]
    width = text(base_radius / 20.0)
    for k, tendon in enumerate(scene.tendons):
        path = SubElement(tendons, "spatial", name=f"tendon_{k}", width=width)
        add_branches(bodies, path, scene, chain, k)
        SubElement(
            motors,
            "motor",
            name=f"tension_{k}",
            tendon=f"tendon_{k}",
            gear="-1",
            ctrllimited="true",
            ctrlrange=text(tendon.tension_limits),
        )
    indent(root)
    return ElementTree(root)


def _comment(left: list[str]) -> str:
    """Comment on the time step and on what is left out."""
    why = (
        f"timestep: at most {LONGEST_STEP:g} s, a tenth of the scene's, half of that at which the"
        " stiffest joint is stable"
    )
    left_out = ", ".join(left) or "nothing"
    words = f" {why}; left out: {left_out} "
    return words.replace("--", "- -")  # which ends comments of XML


def text(numbers: ArrayLike) -> str:
    """Numbers as an attribute."""
    array = np.asarray(numbers, dtype=float)
    values = np.atleast_1d(array)
    return " ".join(map(repr, values.tolist()))


def placed(pose: Array) -> dict[str, str]:
    """Attributes of a pose (4, 4)."""
    matrix = pose[:3, :3]
    rotation = Rotation.from_matrix(matrix)
    quaternion = rotation.as_quat(canonical=True, scalar_first=True)
    position = text(pose[:3, 3])
    return {"pos": position, "quat": text(quaternion)}


def add_body(parent: Element, scene: Scene, chain: Chain, i: int) -> Element:
    """Body of the base, i = 0, or of link i - 1, with inertia, capsule and joints."""
    pose = chain.pose[i]
    name = "base"
    in_parent = pose
    if i > 0:
        name = f"link_{i - 1}"
        into_parent = inverse_pose(chain.pose[i - 1])
        in_parent = into_parent @ pose
    attributes = {"name": name, **placed(in_parent)}
    body = SubElement(parent, "body", attributes)
    _add_inertia(body, chain.inertia[i])
    ends = chain.stations[i : i + 2]
    middle = ends.mean()
    next_pose = chain.pose[i + 1]
    to_end = inverse_pose(pose) @ next_pose
    SubElement(
        body,
        "geom",
        name=name,
        type="capsule",
        size=text(rod_radius(scene, middle)[0]),
        fromto=text([0.0, 0.0, 0.0, *to_end[:3, 3]]),
        contype="0",
    )
    if i > 0:
        _add_joints(body, scene, chain, i)
    return body


def _add_inertia(body: Element, inertia: Array) -> None:
    """Mass, centre and moments of inertia of a body, of its spatial inertia (6, 6)."""
    # [[J, m c~], [-m c~, m]]
    mass = inertia[5, 5]
    first_moments = inertia[[2, 0, 1], [4, 5, 3]]
    centre = first_moments / mass
    offset = mass * skew(centre) @ skew(centre)
    about_centre = inertia[:3, :3] + offset
    # xx, yy, zz, xy, xz, yz
    places = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    entries = about_centre[places]
    SubElement(
        body,
        "inertial",
        pos=text(centre),
        mass=text(mass),
        fullinertia=text(entries),
    )


def _add_joints(body: Element, scene: Scene, chain: Chain, i: int) -> None:
    """Joints of link i - 1, a spring and a damper for every strain that is free."""
    order = list(JOINT_ORDER)
    is_odd = i % 2 == 1
    if is_odd:
        order.reverse()  # the axes are reversed from link to link
    for j in order:
        strain = STRAINS[j]
        if strain not in scene.strain.free:
            continue
        SubElement(
            body,
            "joint",
            name=f"{strain}_{i - 1}",
            type="hinge" if j < 3 else "slide",
            axis=text(np.eye(3)[j % 3]),
            stiffness=text(chain.stiffness[i - 1, j]),
            damping=text(chain.damping[i - 1, j]),
        )


class _Passage(NamedTuple):
    """A part of an element that a tendon passes."""

    place: float  # arc length [m] of its middle
    length: float  # [m]
    share: float  # of the element's angle by which the joint bends under the tendon here


def add_branches(bodies: list[Element], path: Element, scene: Scene, chain: Chain, k: int) -> None:
    """Path of tendon k over sites of the bodies.

    For the part of an element that it passes, and for those on either side of a segment's border,
    the joint gets as much of the tension as bends it by the same angle.
    """
    tendon = scene.tendons[k]
    links = len(bodies) - 1
    for i in range(links):
        # in the frame of the body before it
        into_link = inverse_pose(chain.pose[i])
        next_pose = chain.pose[i + 1]
        joint = into_link @ next_pose
        rotation = joint[:3, :3]
        position = joint[:3, 3]
        for passage in _passages(scene, tendon, i, links):
            site, ahead = _branch(scene, tendon, passage)
            branches = []
            # none beyond base and tip
            if i + 1 < links:
                branches.append((site, site + ahead))
            if i > 0:
                branches.append((site - ahead, site))
            # a pulley divides the tension among the branches
            count = len(branches)
            for start, end in branches:
                if len(path) or count != passage.share:
                    divisor = text(count / passage.share)
                    SubElement(path, "pulley", divisor=divisor)
                in_body_before = rotation @ start + position
                _add_site(bodies[i], path, in_body_before)
                _add_site(bodies[i + 1], path, end)


def _branch(scene: Scene, tendon: Tendon, passage: _Passage) -> tuple[Array, Array]:
    """Position (3,) [m] of a tendon in the frame of the rod, and the way [m] along its tangent."""
    place = np.array([passage.place])
    offsets, slopes = tendon_offset(scene, tendon, place)
    strain = stress_free_strain(scene, place)[0]
    curvature = strain[:3]
    stretch = strain[3:]
    first_site = [0.0, *offsets[0]]
    site = np.array(first_site)
    first_slope = [0.0, *slopes[0]]
    slope = np.array(first_slope)
    # derivative of the tendon's position by arc length, in the frame of the rod
    rotation = np.cross(curvature, site)
    tangent = rotation + stretch + slope
    length = passage.length / passage.share
    return site, length * tangent


def _passages(scene: Scene, tendon: Tendon, element: int, elements: int) -> list[_Passage]:
    """Parts of an element that a tendon passes, cut at the borders of segments."""
    start, end = tendon_ends(scene, tendon)
    length = rod_length(scene) / elements
    first = element * length
    last = (element + 1) * length
    borders = [start, end, *segment_borders(scene)]
    clipped = np.clip(borders, first, last)
    cuts = np.unique(clipped)
    parts = np.diff(cuts)
    places = _middles(cuts)
    elasticity, _, _ = screw_matrices(scene, places)
    # angles under the same moment
    bending = parts / elasticity[:, 1]
    shares = bending / bending.sum()
    passages = []
    for place, part, share in zip(places, parts, shares, strict=True):
        is_passed = start < place < end
        if is_passed and share >= LEAST_SHARE:
            passages.append(_Passage(place, part, share))
    return passages


def _add_site(body: Element, path: Element, position: Array) -> None:
    """Site of a body at a position (3,) [m], as the next one of a tendon's path."""
    name = f"{path.attrib['name']}_site_{len(path)}"
    SubElement(
        body,
        "site",
        name=name,
        pos=text(position),
        size=path.attrib["width"],
        group="4",
    )
    SubElement(path, "site", site=name)


class _MujocoArm:
    """An exported arm in MuJoCo, without contact."""

    def __init__(self, path: Path, length: float) -> None:
        """length: of the rod [m]."""
        import mujoco

        self._engine = mujoco
        self._length = length
        model = mujoco.MjModel.from_xml_path(str(path))
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # the step begins without tension, also where limits do not allow it
        model.actuator_ctrllimited[:] = 0
        self._model = model
        # the same arm with so much damping that it comes to rest
        calm = copy.copy(model)
        calm.dof_damping[:] = SLOW * calm.jnt_stiffness
        calm.opt.timestep = SETTLING_STEP
        self._calm = calm
        self._data = mujoco.MjData(model)
        self.tip = self._data.site("tip").xpos
        self.time_step: float = model.opt.timestep

    def settle(self, tension: ArrayLike) -> Array:
        """Tip (3,) [m] at rest under tensions (n_a,) [N], NaN where it does not come to rest."""
        self._engine.mj_resetData(self._model, self._data)
        self._data.ctrl[:] = tension
        settled = SETTLED * self._length
        for _ in range(MOST_TURNS):
            before = self.tip.copy()
            self._engine.mj_step(self._calm, self._data, nstep=STEPS_OF_TURN)
            movement = math.dist(self.tip, before)
            if movement < settled:
                return before
        return np.full(3, np.nan)

    def hold(self, tension: ArrayLike) -> None:
        """Moves on by HOLD under tensions (n_a,) [N]."""
        self._data.ctrl[:] = tension
        steps = round(HOLD / self.time_step)
        self._engine.mj_step(self._model, self._data, nstep=steps)
        self._engine.mj_kinematics(self._model, self._data)


def compare(path: Path, scene: Scene) -> tuple[Array, float, float]:
    """Distances of the tip of an exported scene in MuJoCo from that of its rod.

    Args:
        path: of the exported scene.
        scene: that was exported; its rod is computed at the preset "fine".

    Returns:
        Distances [m] at rest under sets of tensions within limits (SETS,), NaN where either has no
        rest; the largest [m] after a step of tensions, without contact; and how long [s] that is.
    """
    scene, _ = exportable(scene)
    rod = build_model(scene, "fine")
    arm = _MujocoArm(path, rod.length)
    rest = _distances_at_rest(arm, scene, rod)
    # a whole number of periods of HOLD, at least one
    longest = min(LONGEST_MOTION, MOST_STEPS * arm.time_step)
    periods = max(1, int(longest / HOLD))
    duration = HOLD * periods
    tensions = motion_tensions(scene, "step", 0, duration)
    motion = simulate(rod, tensions, duration, HOLD)
    poses = motion.tip_pose[1:]
    arm.settle(0.0)
    distances = []
    for tension, pose in zip(tensions, poses, strict=True):
        arm.hold(tension)
        position = pose[:3, 3]
        distance = math.dist(arm.tip, position)
        distances.append(distance)
    return rest, float(np.max(distances)), duration


def _distances_at_rest(arm: _MujocoArm, scene: Scene, rod: Model) -> Array:
    """Distances (SETS,) [m] of two tips at rest, NaN where either has no rest."""
    tension_limits = [tendon.tension_limits for tendon in scene.tendons]
    limits = np.array(tension_limits)
    least = limits[:, 0]
    greatest = limits[:, 1]
    random = np.random.default_rng(0)
    shape = (SETS, len(limits))
    sets = random.uniform(least, greatest, shape)
    distances = []
    for tension in sets:
        distance = math.nan
        equilibrium = static_equilibrium(rod, tension)
        if equilibrium.converged:
            tip = arm.settle(tension)
            position = equilibrium.tip_pose[:3, 3]
            distance = math.dist(tip, position)
        distances.append(distance)
    return np.array(distances)
