"""A moving picture (GIF) of the arm in a task: one round of a closed target, which repeats without
a seam.

    python examples/tracking.py [--task TipPose] [--controller predictive] [--fidelity standard]
    [--seed 6] [--out out/tracking.gif]

The picture at the top of the README is
`python examples/tracking.py --out docs/pictures/tracking.gif`; those of the other tasks are
`--task Shape --out docs/pictures/shape.gif` and `--task Reach --out docs/pictures/reach.gif`. Needs
the extra `pictures`.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from _palette import with_palette
from tqdm import tqdm

from soft_tendon_env.policies import make_policy, observation_options

ROUND = 5.0  # [s]: the trail that frames show is as long, so that it closes
# [s] before the pictures begin: the arm has come to the target, and its way there has left the
# trail
LEAD = 6.0
MOTION = {"type": "random", "fraction": 0.5, "knot_period": 1.0, "period": ROUND}
TARGETS = {
    "TipPose": MOTION,
    "Shape": MOTION,
    "Reach": {"type": "steps", "fraction": 0.25, "duration": 1.0, "count": round(ROUND)},
}
STEPS_PER_FRAME = 2


def main() -> None:
    arguments = parse_arguments()
    env = gym.make(
        f"TendonRod-{arguments.task}-v0",
        render_mode="rgb_array",
        target=TARGETS[arguments.task],
        fidelity=arguments.fidelity,
        max_episode_steps=-1,  # no limit
        **observation_options(arguments.controller, arguments.task),
    )
    name = env.unwrapped.task.errors[0].name
    frames, error = one_round(env, arguments.controller, arguments.seed, name)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    save(frames, STEPS_PER_FRAME / env.unwrapped.metadata["render_fps"], arguments.out)
    size = arguments.out.stat().st_size / 1e6
    print(
        f"root mean square {name.replace('_', ' ')} {1e3 * error:.3g} mm\nwritten: {arguments.out},"
        f" {size:.2f} MB"
    )


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=TARGETS, default="TipPose")
    parser.add_argument("--controller", default="predictive", help="of the catalogue of the task")
    parser.add_argument("--fidelity", choices=("fast", "standard", "fine"), default="standard")
    parser.add_argument("--seed", type=int, default=6, help="of the target")
    parser.add_argument("--out", type=Path, default=Path("out/tracking.gif"))
    return parser.parse_args()


def one_round(
    env: gym.Env, controller: str, seed: int, name: str
) -> tuple[list[np.ndarray], float]:
    """Frames of a round of the target, and the root mean square in it of the error of that name
    [m]."""
    policy = make_policy(controller, env)
    state = None
    observation, _ = env.reset(seed=seed)
    lead, steps = (round(time * env.unwrapped.metadata["render_fps"]) for time in (LEAD, ROUND))
    frames = []
    errors = []
    for step in tqdm(range(lead + steps), desc="lead and round", unit="step"):
        action, state = policy.predict(observation, state)
        observation, *_, info = env.step(action)
        if step >= lead:
            errors.append(info[name])
            if step % STEPS_PER_FRAME == 0:
                frames.append(env.render())
    return frames, float(np.sqrt(np.mean(np.square(errors))))


def save(frames: list[np.ndarray], period: float, path: Path) -> None:
    """Write a GIF that repeats for ever, `period` [s] between frames."""
    first, *others = with_palette(frames)
    first.save(path, save_all=True, append_images=others, duration=round(1e3 * period), loop=0)


if __name__ == "__main__":
    main()
