"""The arm in MuJoCo: the chain of bodies with springs, dampers and spatial tendons that
`soft-tendon export --mjcf` writes.

Its integrator is "implicitfast"; "discrete", which has the stiffness implicit too, is measured
beside it.
"""

from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np

from soft_tendon_env.export.mujoco_chain import mujoco_chain
from soft_tendon_env.scene.scene import Scene

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "MuJoCo"
DISTRIBUTION = "mujoco"
SECONDS = 2.0
WARNINGS: list[str] = []
"""What MuJoCo has warned of since the list was emptied; a list of the module, since MuJoCo has one
handler of warnings."""
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


BODIES = (10, 20, 30, 40)
STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)
QUICK = (Setting(10, 0.01), Setting(10, 0.005))
HARD = (Setting(40, 0.01), Setting(80, 0.001))


def settings() -> list[Setting]:
    steps = [Setting(bodies, step) for bodies in BODIES for step in STEPS]
    return [*steps, Setting(20, 0.01, "discrete"), Setting(20, 0.001, "discrete")]


def prepare(scene: Scene, setting: Setting) -> Run:
    """Nothing is computed that the other simulators do not have: no contact and other constraints,
    no limits of tensions."""
    root = mujoco_chain(scene, setting.bodies).getroot()
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    model.opt.timestep = setting.step
    model.opt.integrator = INTEGRATORS[setting.integrator]
    model.opt.disableflags = (
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    )
    model.actuator_ctrllimited[:] = 0
    return lambda tensions: simulate(model, tensions)


def simulate(model: mujoco.MjModel, tensions: Array) -> Motion:
    """The motion from rest; MuJoCo's warnings are caught in place of the line that it writes to its
    log."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    WARNINGS.clear()
    mujoco.set_mju_user_warning(WARNINGS.append)
    steps = round(HOLD / model.opt.timestep)
    tip = data.site("tip")
    tips = np.empty((len(tensions) + 1, 3))
    tips[0] = tip.xpos
    times = np.zeros(len(tensions) + 1)

    def step() -> None:
        for row, tension in enumerate(tensions, start=1):
            data.ctrl[:] = tension
            mujoco.mj_step(model, data, nstep=steps)
            mujoco.mj_kinematics(model, data)
            tips[row] = tip.xpos
            times[row] = data.time

    cpu = cpu_time(step)
    mujoco.set_mju_user_warning(None)
    return Motion(
        tips,
        cpu / (HOLD * len(tensions)),
        "; ".join(dict.fromkeys(WARNINGS)),
        bool((np.diff(times) < 0.5 * HOLD).any()),
    )
