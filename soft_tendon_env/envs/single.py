"""The environments, one arm each. Their docstrings are their documentation."""

from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.checks import checked_array
from soft_tendon_env.envs.divergence import DivergenceLog
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.rendering import ArmRenderer, Picture
from soft_tendon_env.envs.tasks import REACH, SHAPE, TIP_POSE, Task, goal_reward
from soft_tendon_env.scene import Array
from soft_tendon_env.simulation import SimulationDiverged
