"""The quick start of the README: load a scene, change it, let it come to rest, let it move."""

import numpy as np

import soft_tendon_env as ste

scene = ste.load_scene("paper")  # a shipped scene, or the path of a TOML file
scene = scene.replace(
    {"segments.0.damping": 1.1e4}
)  # any entry by its dotted name, with the same checks
model = ste.build_model(
    scene, fidelity="standard"
)  # as gym.make has it; left out: "scene", as the file says

tension = np.zeros(10)  # [N], one per tendon
tension[0] = 5.0

rest = ste.static_equilibrium(model, tension)
print("at rest the tip is at", rest.tip_pose[:3, 3].round(4), "m")

trajectory = ste.simulate(model, tension, duration=1.0, sample_period=0.01)
print("one second after the pull begins it is at", trajectory.tip_pose[-1, :3, 3].round(4), "m")
