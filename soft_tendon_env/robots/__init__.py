"""Robots behind one interface, and the loop that runs policies on them.

They are real arms, and a simulated one in their place.
"""

from soft_tendon_env.robots.clock import Timing
from soft_tendon_env.robots.dynamixel import DynamixelRobot
from soft_tendon_env.robots.environment import Report, RobotEnv, rehearse, run_policy
from soft_tendon_env.robots.process import RobotProcess
from soft_tendon_env.robots.protocol import Measurement, Robot
from soft_tendon_env.robots.safety import MeasurementWarning, RobotStopped
from soft_tendon_env.robots.simulated import SimulatedRobot
from soft_tendon_env.robots.slack import Stop

__all__ = [
    "DynamixelRobot",
    "Measurement",
    "MeasurementWarning",
    "Report",
    "Robot",
    "RobotEnv",
    "RobotProcess",
    "RobotStopped",
    "SimulatedRobot",
    "Stop",
    "Timing",
]
__all__ += ["rehearse", "run_policy"]
