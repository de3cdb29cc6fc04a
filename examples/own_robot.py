"""A robot of your own: a class with two names and three methods. This one talks to a
microcontroller in lines of text over a socket.

python examples/own_robot.py runs a controller on it; a simulated arm answers at the other end. On
yours, from this folder: soft-tendon run filtered:tracking --task Reach --scene three_tendon --robot
    own_robot:LineArm --set "observation=['tip_position','tip_rotation','tendon_lengths']"
"""

import socket
import socketserver
import threading

import gymnasium as gym
import numpy as np

from soft_tendon_env.policies import load_policy
from soft_tendon_env.robots import Measurement, RobotEnv, SimulatedRobot, rehearse, run_policy

ARM = {"scene": "three_tendon", "fidelity": "fast"}
OBSERVED = ("tip_position", "tip_rotation", "tendon_lengths", "last_action", "command")


class LineArm:
    """Three tendons: "?" is answered by a line of the motors' time, lengths, the tracker's time and
    the tip's pose, row by row; three tensions [N] are a command.

    The tracker's time is that of its frame: one that has lost sight goes on giving its last pose.
    """

    command_unit = "N"
    senses = ("tip_pose", "tendon_length")

    def __init__(self, host: str = "127.0.0.1", port: int = 5005, timeout: float = 0.1) -> None:
        self._socket = socket.create_connection((host, port), timeout=timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # lines are sent at once
        self._lines = self._socket.makefile("rw")

    def read(self) -> Measurement:
        print("?", file=self._lines, flush=True)
        numbers = np.array(self._lines.readline().split(), dtype=float)
        return Measurement(
            numbers[0],
            tendon_length=numbers[1:4],
            tip_time=numbers[4],
            tip_pose=numbers[5:].reshape(4, 4),
        )

    def write(self, command: np.ndarray) -> np.ndarray:
        print(*command, file=self._lines, flush=True)
        return command

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


class StandIn(socketserver.StreamRequestHandler):
    """The other end, for want of one."""

    disable_nagle_algorithm = True
    arm: SimulatedRobot

    def handle(self) -> None:
        for line in self.rfile:
            if line == b"?\n":
                measured = self.arm.read()
                times = (measured.time, measured.time_of_pose)
                numbers = [times[0], *measured.tendon_length, times[1], *measured.tip_pose.ravel()]
                self.wfile.write(" ".join(map(repr, map(float, numbers))).encode() + b"\n")
            else:
                self.arm.write(np.array(line.split(), dtype=float))


def main() -> None:
    StandIn.arm = SimulatedRobot(**ARM, randomize={"stiffness": 0.9})
    server = socketserver.TCPServer(("127.0.0.1", 0), StandIn)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    env = gym.make("TendonRod-Reach-v0", **ARM, action="tension", observation=OBSERVED)
    policy = load_policy("filtered:tracking", env)
    rehearse(policy, env)
    # A computer that plays both parts may be late; leave these two out for a robot.
    arm = LineArm(port=server.server_address[1], timeout=60.0)
    robot = RobotEnv(env, arm, settle=0.5, patience=3000)
    report = run_policy(policy, robot, seconds=2.0)
    print(f"{1e3 * report.errors['position_error'][-1]:.2f} mm from the goal; {report.timing}")
    server.shutdown()


if __name__ == "__main__":
    main()
