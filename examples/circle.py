"""The arm's tip along the paper's circle: an episode of TendonRod-TipPose-v0, recorded to Rerun.

    python examples/circle.py [--fidelity standard] [--seconds 8] [--out out]

The controller is the simplest that there is: the tensions that would hold the tip on the circle if
the arm were at rest, from the inverse of the statics at a few places around it. What the arm's
motion adds to that is the error that is left. Open the recording with `rerun out/circle.rrd`, if a
viewer is at hand.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from scipy.interpolate import CubicSpline
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.recording import Rollout, collect
from soft_tendon_env.recording.rerun_file import RerunFile

# [N]; this circle needs tendons that push a little: pulling alone shortens the arm by some
# millimetres
LIMIT = 10.0
PLACES = 24  # around the circle, where the statics are inverted
TURN = 4.0  # [s]
PERIOD = 0.02  # [s] of control
SETTLED = 2.0  # [s] from which on errors count


def main() -> None:
    arguments = parse_arguments()
    arguments.out.mkdir(parents=True, exist_ok=True)
    recording = arguments.out / "circle.rrd"
    env = gym.make(
        "TendonRod-TipPose-v0",
        target={"type": "circle", "period": TURN},
        tension_limits=[-LIMIT, LIMIT],
        fidelity=arguments.fidelity,
        action="tension",
        max_episode_steps=round(arguments.seconds / PERIOD),
        control_period=PERIOD,
    )
    env.reset()
    rollout = collect(
        env, Feedforward(tensions_around(env.unwrapped), env.spec.max_episode_steps), seed=0
    )
    report(rollout)
    with RerunFile(recording) as file:
        file.write(rollout)
    print(f"recording: {recording}")


class Feedforward:
    """Actions from tensions as a function of time, whatever is observed."""

    def __init__(self, tension: CubicSpline, steps: int) -> None:
        self._tension = tension
        self._step = 0
        self._bar = tqdm(total=steps, desc="circle", unit="step")

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        self._step += 1
        self._bar.update()
        return (self._tension(self._step * PERIOD % TURN) / LIMIT).astype(np.float32)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", choices=("fast", "standard", "fine"), default="standard")
    parser.add_argument(
        "--seconds", type=float, default=8.0, help="of simulated time, more than 2 and at most 10"
    )
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the recording")
    arguments = parser.parse_args()
    if not SETTLED < arguments.seconds <= 10.0:
        parser.error("--seconds should be more than 2 and at most 10")
    return arguments


def tensions_around(env) -> CubicSpline:
    """Tensions (10,) [N] that hold the tip on the target, as a function of time within a turn."""
    times = np.linspace(0.0, TURN, PLACES + 1)
    tensions = []
    start = None
    for pose in tqdm(env.target_at(times).tip_pose[:-1], desc="inverse statics", unit="pose"):
        found = ste.tension_for_tip_pose(env.model, pose, start=start)
        tensions.append(found.tension)
        start = found.tension
    return CubicSpline(times, np.stack([*tensions, tensions[0]]), bc_type="periodic")


def report(rollout: Rollout) -> None:
    after = round(SETTLED / PERIOD)
    errors = (rollout.scalars[name][after:] for name in ("position_error", "angle_error"))
    position, angle = (np.sqrt(np.mean(error**2)) for error in errors)
    print(
        f"\nAfter {SETTLED:g} s: root mean square position error {1e3 * position:.1f} mm, angle"
        f" error {np.degrees(angle):.2f} degrees,"
    )
    print(f"mean reward {rollout.scalars['reward'][after:].mean():.3f} (of at most 1).")


if __name__ == "__main__":
    main()
