"""The arm's tip along the paper's circle: an episode of TendonRod-TipPose-v0, recorded to Rerun, with a picture.

    python examples/circle.py [--fidelity standard] [--seconds 8] [--out out]

The controller is the simplest that there is: the tensions that would hold the tip on the circle if the arm were at rest, from the
inverse of the statics at a few places around it. What the arm's motion adds to that is the error that is left.
Open the recording with `rerun out/circle.rrd`, if a viewer is at hand.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import matplotlib.image
import numpy as np
from scipy.interpolate import CubicSpline
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.recording import RecordRollout

LIMIT = 10.0  # [N]; this circle needs tendons that push a little: pulling alone shortens the arm by some millimetres
PLACES = 24  # around the circle, where the statics are inverted
TURN = 4.0  # [s]
SETTLED = 2.0  # [s] from which on errors count


def main() -> None:
    arguments = parse_arguments()
    arguments.out.mkdir(parents=True, exist_ok=True)
    recording, picture = arguments.out / "circle.rrd", arguments.out / "circle.png"
    target = {"type": "circle", "period": TURN}
    plain = gym.make(
        "TendonRod-TipPose-v0", target=target, tension_limits=[-LIMIT, LIMIT], fidelity=arguments.fidelity, render_mode="rgb_array"
    )
    env = RecordRollout(plain, recording)
    env.reset(seed=0)
    period = env.unwrapped.episodes.period
    tension = tensions_around(env.unwrapped)
    errors = []
    for step in tqdm(range(round(arguments.seconds / period)), desc="circle", unit="step"):
        _, reward, _, _, info = env.step((tension((step + 1) * period % TURN) / LIMIT).astype(np.float32))
        errors.append((info["position_error"], info["angle_error"], reward))
    matplotlib.image.imsave(picture, env.render())
    env.close()
    report(np.array(errors)[round(SETTLED / period) :])
    print(f"recording: {recording}\npicture:   {picture}")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", choices=("fast", "standard", "fine"), default="standard")
    parser.add_argument("--seconds", type=float, default=8.0, help="of simulated time, more than 2 and at most 10")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the recording and the picture")
    arguments = parser.parse_args()
    if not SETTLED < arguments.seconds <= 10.0:
        parser.error("--seconds should be more than 2 and at most 10")
    return arguments


def tensions_around(env) -> CubicSpline:
    """Tensions (10,) [N] that hold the tip on the target, as a function of time within a turn."""
    times = np.linspace(0.0, TURN, PLACES + 1)
    tensions, start = [], None
    for pose in tqdm(env.target_at(times).tip_pose[:-1], desc="inverse statics", unit="pose"):
        found = ste.tension_for_tip_pose(env.model, pose, start=start)
        tensions.append(found.tension)
        start = found.tension
    return CubicSpline(times, np.stack([*tensions, tensions[0]]), bc_type="periodic")


def report(errors: np.ndarray) -> None:
    """Errors (steps, 3): position [m], angle [rad], reward."""
    position, angle = np.sqrt(np.mean(errors[:, :2] ** 2, axis=0))
    print(f"\nAfter {SETTLED:g} s: root mean square position error {1e3 * position:.1f} mm, angle error {np.degrees(angle):.2f} degrees,")
    print(f"mean reward {errors[:, 2].mean():.3f} (of at most 1).")


if __name__ == "__main__":
    main()
