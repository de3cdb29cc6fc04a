"""Rollouts with known numbers, and environments of two rows that only pretend to simulate."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soft_tendon_env.drawing.shapes import backbones
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.recording.rollout import Rollout

LENGTH = 5
PERIOD = 0.02


def strain_of(model, bend):
    """Strains (samples, points, 6) that bend (samples,) [1/m] about y and z."""
    strain = np.tile(model.grid.unpacked(model.arm.rod.reference_strain), (len(bend), 1, 1))
    strain[..., 1] += bend[:, None]
    strain[..., 2] += 0.5 * bend[:, None]
    return strain


def tips_of(model, strain):
    return backbones(model, strain, model.grid.breakpoints[-1:])[:, 0]


@pytest.fixture(scope="session")
def model(build):
    return build("three_tendon")


@pytest.fixture
def rollout(model):
    """rollout(samples, seed): a bending arm with random tensions, a target, errors and rewards."""

    def make(samples=7, seed=0):
        rng = np.random.default_rng(seed)
        strain = strain_of(model, np.linspace(0.0, 3.0, samples))
        tip = tips_of(model, strain)
        return Rollout(
            model,
            PERIOD,
            strain,
            tension=rng.uniform(0.0, 20.0, (samples, model.tendon_count)),
            tip_pose=tip,
            target_pose=np.tile(tip[-1], (samples, 1, 1)),
            target_backbone=np.tile(backbones(model, strain[-1:], model.grid.breakpoints)[..., :3, 3], (samples, 1, 1)),
            action=rng.uniform(-1.0, 1.0, (samples, 2)),
            scalars={"position_error": rng.random(samples), "reward": rng.random(samples), "substeps": np.arange(float(samples))},
            title=f"episode {seed}",
        )

    return make


class FakeEpisodes(Episodes):
    """Rows whose first tension counts steps, whose second counts resets and whose third is the row; the bend grows with the steps."""

    target_pose = target_backbone = None  # in place of the properties

    def __init__(self, model, rows):
        self.task, self.options, self.model, self.period, self.resets = TASKS["TipPose"], Options(), model, PERIOD, np.full(rows, -1)
        self.step_count = np.zeros(rows, dtype=np.int64)
        motions = SimpleNamespace(xi=np.empty((rows, model.arm.rod.reference_strain.size)))
        reading = SimpleNamespace(tip_pose=np.empty((rows, 4, 4)))
        self.arms = SimpleNamespace(rows=motions, reading=reading, effects_of=lambda row: model.scene.effects)
        self.tension = np.empty((rows, 3))
        self.target_pose = np.tile(np.eye(4), (rows, 1, 1))
        self.target_backbone = np.empty((rows, 0, 3))
        self.last = None

    def reset(self, row):
        self.resets[row] += 1
        self.step_count[row] = 0
        self.update(row)

    def step(self, row):
        self.step_count[row] += 1
        self.update(row)

    def update(self, row):
        strain = strain_of(self.model, 0.1 * self.step_count[row : row + 1])
        self.arms.rows.xi[row], self.arms.reading.tip_pose[row] = self.model.grid.packed(strain)[0], tips_of(self.model, strain)[0]
        self.tension[row] = self.step_count[row], self.resets[row], row

    def copy(self):
        """As `last` has it."""
        fields = {name: getattr(self, name).copy() for name in ("tension", "target_pose", "target_backbone")}
        return SimpleNamespace(strain=self.arms.rows.xi.copy(), tip_pose=self.arms.reading.tip_pose.copy(), **fields)


class FakeEnv(gym.Env):
    """Episodes of LENGTH steps; the reward and the error are the number of the step."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (1,))
    action_space = gym.spaces.Box(-1.0, 1.0, (2,))

    def __init__(self, model):
        self.episodes = FakeEpisodes(model, 1)

    def _info(self):
        return {"position_error": float(self.episodes.step_count[0]), "diverged": False, "cause": "none"}

    def reset(self, *, seed=None, options=None):
        self.episodes.reset(0)
        return np.zeros(1), self._info()

    def step(self, action):
        self.episodes.step(0)
        return np.zeros(1), self.episodes.step_count[0], False, bool(self.episodes.step_count[0] == LENGTH), self._info()


class FakeVectorEnv(gym.vector.VectorEnv):
    """Two rows, the second with episodes one step longer, in any mode of autoreset."""

    single_observation_space = gym.spaces.Box(-1.0, 1.0, (1,))
    single_action_space = gym.spaces.Box(-1.0, 1.0, (2,))
    num_envs = 2

    def __init__(self, model, mode, keeps_last=True):
        self.metadata = {"autoreset_mode": mode}
        self.episodes, self._mode, self._keeps_last = FakeEpisodes(model, 2), mode, keeps_last
        self._ended = np.zeros(2, dtype=bool)

    def _infos(self):
        even = self.episodes.step_count % 2 == 0
        return {"position_error": self.episodes.step_count.astype(float), "even": even.astype(float), "_even": even}

    def reset(self, *, seed=None, options=None):
        for row in np.flatnonzero((options or {}).get("reset_mask", [True, True])):
            self.episodes.reset(row)
            self._ended[row] = False
        return np.zeros((2, 1)), self._infos()

    def step(self, actions):
        before = self._ended & (self._mode == AutoresetMode.NEXT_STEP)
        for row in range(2):
            if before[row]:
                self.episodes.reset(row)
            elif not self._ended[row]:
                self.episodes.step(row)
        rewards = np.where(before, 0.0, self.episodes.step_count)
        self._ended = ~before & (self.episodes.step_count == [LENGTH, LENGTH + 1])
        ended, final = self._ended.copy(), {}
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            final = {"final_info": self._infos(), "_final_info": ended}
            self.episodes.last = self.episodes.copy() if self._keeps_last else None
            for row in np.flatnonzero(ended):
                self.episodes.reset(row)
            self._ended[:] = False
        return np.zeros((2, 1)), rewards, np.zeros(2, dtype=bool), ended, self._infos() | final


@pytest.fixture
def build_env(model):
    return lambda: FakeEnv(model)


@pytest.fixture
def env(build_env):
    return build_env()


@pytest.fixture
def vector_env(model):
    return lambda mode, keeps_last=True: FakeVectorEnv(model, mode, keeps_last)


@pytest.fixture
def bent(model):
    """bent(bend): strain fields of bends (samples,) [1/m]."""
    return lambda bend: strain_of(model, bend)
