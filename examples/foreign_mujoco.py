"""The foreign arm in MuJoCo: a chain of rigid links, with dry friction in its tendons.

From this folder: soft-tendon collect three_tendon --robot foreign_mujoco:MujocoArm ...
"""

from xml.etree import ElementTree

import mujoco
import numpy as np
from foreign_arm import ForeignArm

from soft_tendon_env.export.mujoco_chain import mujoco_chain


class MujocoArm(ForeignArm):
    """A chain of rigid links, with friction in its tendons that no tension adds to."""

    LINKS = 16
    FRICTION = 0.03  # [N] that a tendon resists its motion with

    def __init__(self, seed=0, real_time=False):
        super().__init__(seed, real_time)
        root = mujoco_chain(self.scene, self.LINKS).getroot()
        for tendon in root.iter("spatial"):
            tendon.set("frictionloss", str(self.FRICTION))
        text = ElementTree.tostring(root, encoding="unicode")
        self._model = mujoco.MjModel.from_xml_string(text)
        self._model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.step = self._model.opt.timestep
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)

    def advance(self, tension, steps):
        self._data.ctrl[:] = tension
        mujoco.mj_step(self._model, self._data, nstep=steps)
        mujoco.mj_forward(self._model, self._data)

    def tip_pose(self):
        tip = self._data.site("tip")
        pose = np.eye(4)
        pose[:3, :3] = tip.xmat.reshape(3, 3)
        pose[:3, 3] = tip.xpos
        return pose

    def tendon_length(self):
        return self._data.ten_length.copy()
