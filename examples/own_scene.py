"""A scene of your own: a tapered finger with two tendons, written in Python, kept as TOML,
simulated. `python examples/own_scene.py`"""

import tempfile
from pathlib import Path

import gymnasium as gym

import soft_tendon_env as ste

SCENE = ste.Scene(
    name="finger",
    description="Tapered silicone finger of 0.12 m, bent to either side by two tendons",
    segments=[
        {
            "length": 0.12,  # [m]
            "young_modulus": 2e6,  # [Pa]
            "poisson_ratio": 0.5,
            "density": 1070.0,  # [kg/m^3]
            "damping": 1e4,  # [Pa s]
            "radius": {"type": "linear", "base": 0.01, "tip": 0.006},  # [m]
        }
    ],
    tendons=[
        {"routing": {"type": "straight", "offset": [y, 0.0]}, "tension_limits": [0.0, 10.0]}
        for y in (0.004, -0.004)
    ],
)

if __name__ == "__main__":
    file = Path(tempfile.mkdtemp()) / "finger.toml"
    ste.save_scene(SCENE, file)
    rest = ste.static_equilibrium(ste.build_model(ste.load_scene(file), "scene"), [8.0, 0.0])
    print("under 8 N the tip rests at", rest.tip_pose[:3, 3].round(4), "m")
    env = gym.make(
        "TendonRod-Reach-v0", scene=file
    )  # a path, a Scene, or the name of one that ships
    env.reset(seed=0)
    print(
        "the goal is",
        round(1e3 * env.step(env.action_space.sample())[4]["position_error"], 1),
        "mm away",
    )
