"""The arm in MuJoCo: a chain of rigid bodies with springs, dampers and spatial tendons.

The rod is cut into elements of equal length; the strain of each is gathered at its middle, as three slide joints (stretch, shear) and
three hinges (torsion, bending) with the stiffness and the Kelvin-Voigt damping of the element, so that bodies reach from middle to
middle, each with the mass and inertia of its own piece of the taper. Second order in the length of the elements: the half element at the
base is fixed, that at the tip is the last body.

Each tendon passes two sites on every body, one for the joint before it and one for the joint behind. Between the sites on either side of
a joint runs the tendon's tangent at the middle of the element, so that helices lose nothing to chords; between the two sites on a body
nothing moves. A motor on the tendon holds the tension. Three choices beyond the obvious, each of which makes the chain better:

- between two sites a kink of angle a shortens the chord of an element of length l by l a^2 / 8, which the smooth rod does not do. The
  joints' bending stiffness is therefore raised by a quarter of l times the tensions that pass, which makes 20 bodies better at rest than
  80 without it;
- the order of the three hinges, which matters to second order in their angles, is reversed from joint to joint;
- the integrator is "implicitfast"; "discrete", which has the stiffness implicit too, is measured beside it.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.model.grid import screw_matrices
from soft_tendon_env.scene.scene import Scene, rod_length, tendon_ends, tendon_offset

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "MuJoCo"
DISTRIBUTION = "mujoco"
SECONDS = 2.0
AXES = np.eye(3)
ORDERS = ((3, 4, 5, 0, 1, 2), (3, 4, 5, 2, 1, 0))
"""Strains of the joints of a body, slides first; even and odd bodies."""
SAG = 0.25
"""Bending stiffness that a joint needs on top of the rod's, for each tension, as a share of the element's length."""
WARNINGS: list[str] = []
"""What MuJoCo has warned of since the list was emptied; a list of the module, since MuJoCo has one handler of warnings."""
INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
}


@dataclass(frozen=True)
class Setting:
    """Number of bodies, time step [s], MuJoCo's name of the integrator."""

    bodies: int
    step: float
    integrator: str = "implicitfast"

    @property
    def label(self) -> str:
        return f"{self.bodies} bodies, {1e3 * self.step:g} ms, {self.integrator}"


BODIES = (10, 20, 40)  # even, for the tendons that end half way
STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)
QUICK = (Setting(10, 0.01), Setting(10, 0.005))
HARD = (Setting(20, 0.01), Setting(40, 0.001))


def settings() -> list[Setting]:
    steps = [Setting(bodies, step) for bodies in BODIES for step in STEPS]
    return [*steps, Setting(20, 0.01, "discrete"), Setting(20, 0.001, "discrete")]


def prepare(scene: Scene, setting: Setting) -> Run:
    model = chain(scene, setting).compile()
    hinges = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_axis[:, 0] == 0.0)
    bending = np.flatnonzero(hinges)
    length = rod_length(scene) / setting.bodies
    middles = length * (model.jnt_bodyid[bending] - 0.5)  # body 0 is the world
    passes = np.array([passes_at(scene, k, middles) for k in range(len(scene.tendons))]).T
    return Chain(model, mujoco.MjData(model), bending, model.jnt_stiffness[bending].copy(), SAG * length * passes)


def passes_at(scene: Scene, index: int, arc_length: Array) -> NDArray[np.bool_]:
    """Whether tendon `index` of the scene acts at the arc lengths [m]."""
    start, end = tendon_ends(scene, scene.tendons[index])
    return (start < arc_length) & (arc_length < end)


def chain(scene: Scene, setting: Setting) -> mujoco.MjSpec:
    """The model; bodies along x, as the rod."""
    spec = mujoco.MjSpec()
    spec.compiler.autolimits = True
    spec.option.timestep = setting.step
    spec.option.integrator = INTEGRATORS[setting.integrator]
    spec.option.gravity = (0.0, 0.0, 0.0)
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    length = rod_length(scene) / setting.bodies
    middles = length * (np.arange(setting.bodies) + 0.5)
    elasticity, damping, _ = screw_matrices(scene, middles)
    body, border, bodies = spec.worldbody, 0.0, [spec.worldbody]
    for i, middle in enumerate(middles):
        body = body.add_body(name=f"body {i}", pos=(middle - border, 0.0, 0.0))
        border = middle
        end = min(middle + length, rod_length(scene))
        set_inertia(body, scene, middle, end)
        for strain in ORDERS[i % 2]:
            kind = mujoco.mjtJoint.mjJNT_HINGE if strain < 3 else mujoco.mjtJoint.mjJNT_SLIDE
            joint = body.add_joint(type=kind, axis=AXES[strain % 3])
            joint.stiffness[0] = elasticity[i, strain] / length
            joint.damping[0] = damping[i, strain] / length
        bodies.append(body)
    bodies[-1].add_site(name="tip", pos=(rod_length(scene) - middles[-1], 0.0, 0.0))
    for k in range(len(scene.tendons)):
        add_tendon(spec, bodies, scene, k, length)
    return spec


def set_inertia(body: mujoco.MjsBody, scene: Scene, start: float, end: float) -> None:
    """Mass, centre and inertia of the rod between two arc lengths [m], by Gauss quadrature, in the frame at `start`."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    arc = start + 0.5 * (end - start) * (nodes + 1.0)
    _, _, inertia = screw_matrices(scene, arc)
    polar, across, _, mass, _, _ = 0.5 * (end - start) * weights * inertia.T
    centre = mass @ (arc - start) / mass.sum()
    lever = mass @ (arc - start - centre) ** 2
    body.explicitinertial = True
    body.mass, body.ipos = mass.sum(), (centre, 0.0, 0.0)
    body.inertia = (polar.sum(), across.sum() + lever, across.sum() + lever)


def add_tendon(spec: mujoco.MjSpec, bodies: list, scene: Scene, index: int, length: float) -> None:
    """Tendon `index` of the scene over `bodies`, world first, with its motor."""
    tendon = scene.tendons[index]
    path = spec.add_tendon(name=f"tendon {index}")
    for i, (before, behind) in enumerate(zip(bodies[:-1], bodies[1:], strict=True)):
        middle = length * (i + 0.5)
        if not passes_at(scene, index, middle):
            continue
        offset, slope = (values[0] for values in tendon_offset(scene, tendon, middle))
        origin = 0.0 if i == 0 else middle - length  # of the body before the joint
        for body, at, name in ((before, middle - 0.5 * length, "before"), (behind, middle + 0.5 * length, "behind")):
            across = offset + slope * (at - middle)
            place = at - (origin if body is before else middle)
            site = body.add_site(name=f"tendon {index} {name} {i}", pos=(place, *across))
            path.wrap_site(site.name)
    motor = spec.add_actuator(name=f"motor {index}", target=path.name, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    motor.set_to_motor()
    motor.gear[0] = -1.0  # positive tension shortens


@dataclass(frozen=True)
class Chain:
    """The compiled model, and what the tensions add to the stiffness of its bending joints."""

    model: mujoco.MjModel
    data: mujoco.MjData
    bending: Array  # (bending joints,) their numbers
    stiffness: Array  # (bending joints,) [N m/rad] without tension
    per_tension: Array  # (bending joints, n_a) [m/rad]

    def __call__(self, tensions: Array) -> Motion:
        """The motion from rest; MuJoCo's warnings are caught in place of the line that it writes to its log."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        WARNINGS.clear()
        mujoco.set_mju_user_warning(WARNINGS.append)
        steps, tip = round(HOLD / model.opt.timestep), data.site("tip")
        tips = np.empty((len(tensions) + 1, 3))
        tips[0] = tip.xpos
        times = np.zeros(len(tensions) + 1)

        def step() -> None:
            for row, tension in enumerate(tensions, start=1):
                data.ctrl[:] = tension
                model.jnt_stiffness[self.bending] = self.stiffness + self.per_tension @ tension
                mujoco.mj_step(model, data, nstep=steps)
                mujoco.mj_kinematics(model, data)
                tips[row], times[row] = tip.xpos, data.time

        cpu = cpu_time(step)
        mujoco.set_mju_user_warning(None)
        return Motion(tips, cpu / (HOLD * len(tensions)), "; ".join(dict.fromkeys(WARNINGS)), bool((np.diff(times) < 0.5 * HOLD).any()))
