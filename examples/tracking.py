"""A moving picture (GIF) of the arm tracking a pose: one round of a closed random target, which repeats without a seam.

    python examples/tracking.py [--controller predictive] [--fidelity standard] [--seed 6] [--out out/tracking.gif]

The picture at the top of the README: `python examples/tracking.py --out docs/pictures/tracking.gif`. Needs the extra `pictures`.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from _palette import with_palette
from tqdm import tqdm

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.policies import make_policy, observation_options

TASK = "TipPose"
ROUND = 5.0  # [s]: the trail that frames show is as long, so that it closes
LEAD = 6.0  # [s] before the pictures begin: the arm has come to the target, and its way there has left the trail
TARGET = {"type": "random", "fraction": 0.5, "knot_period": 1.0, "period": ROUND}
STEPS_PER_FRAME = 2


def main() -> None:
    arguments = parse_arguments()
    env = gym.make(
        f"TendonRod-{TASK}-v0",
        render_mode="rgb_array",
        target=TARGET,
        fidelity=arguments.fidelity,
        max_episode_steps=-1,  # no limit
        **observation_options(arguments.controller, TASK),
    )
    frames, error = one_round(env, arguments.controller, arguments.seed)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    save(frames, STEPS_PER_FRAME / env.unwrapped.metadata["render_fps"], arguments.out)
    print(f"root mean square position error {1e3 * error:.3g} mm\nwritten: {arguments.out}, {arguments.out.stat().st_size / 1e6:.2f} MB")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--controller", choices=CONTROLLERS[TASK], default="predictive")
    parser.add_argument("--fidelity", choices=("fast", "standard", "fine"), default="standard")
    parser.add_argument("--seed", type=int, default=6, help="of the target")
    parser.add_argument("--out", type=Path, default=Path("out/tracking.gif"))
    return parser.parse_args()


def one_round(env: gym.Env, controller: str, seed: int) -> tuple[list[np.ndarray], float]:
    """Frames of a round of the target, and the root mean square position error in it [m]."""
    policy, state = make_policy(controller, env), None
    observation, _ = env.reset(seed=seed)
    lead, steps = (round(time * env.unwrapped.metadata["render_fps"]) for time in (LEAD, ROUND))
    frames, errors = [], []
    for step in tqdm(range(lead + steps), desc="lead and round", unit="step"):
        action, state = policy.predict(observation, state)
        observation, *_, info = env.step(action)
        if step >= lead:
            errors.append(info["position_error"])
            if step % STEPS_PER_FRAME == 0:
                frames.append(env.render())
    return frames, float(np.sqrt(np.mean(np.square(errors))))


def save(frames: list[np.ndarray], period: float, path: Path) -> None:
    """Write a GIF that repeats for ever, `period` [s] between frames."""
    first, *others = with_palette(frames)
    first.save(path, save_all=True, append_images=others, duration=round(1e3 * period), loop=0)


if __name__ == "__main__":
    main()
