"""A push on an arm of ideal silicone, and on one that stiffens and remembers as rubber does.
`python examples/rubber_arm.py`"""

import numpy as np

import soft_tendon_env as ste

PUSH = {
    "at": 0.2,
    "force": [0.0, 0.2, 0.0],
    "signal": {"type": "pulse", "start": 0.5, "duration": 1.0},
}  # [m], [N], [s]
STIFFENING = {"bending": 5.0}  # curvature [1/m] at which the moment is twice that of the linear law
MEMORY = [
    {"modulus": 0.5, "relaxation_time": 0.3},
    {"modulus": 0.3, "relaxation_time": 3.0},
]  # [-] of the static modulus, [s]
MATERIALS = {
    "ideal": {},
    "stiffening": {"effects.nonlinear_elasticity": STIFFENING},
    "with memory": {"effects.viscoelastic_memory.branches": MEMORY},
    "both": {
        "effects.nonlinear_elasticity": STIFFENING,
        "effects.viscoelastic_memory.branches": MEMORY,
    },
}

if __name__ == "__main__":
    scene = ste.load_scene("three_tendon").replace({"effects.disturbance.loads": [PUSH]})
    for name, changes in MATERIALS.items():
        motion = ste.simulate(
            ste.build_model(scene.replace(changes), fidelity="standard"), np.zeros(3), 4.0, 0.02
        )
        tip = 1e3 * motion.tip_pose[:, 1, 3]
        print(
            f"{name:12} pushed by {tip.max():.0f} mm, and in the last second it still swings"
            f" through {np.ptp(tip[150:]):.0f} mm"
        )
