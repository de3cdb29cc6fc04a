"""An effect of your own: viscous drag in proportion to mass, on an arm that is bent and let go.
`python examples/own_effect.py`"""

import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.effects import Effect, Struct, adds_wrench, kernel


class DragParameters(Struct):
    rate: float


@ste.register("effect", "drag")
class Drag(Effect):
    """`[effects.drag]`: the wrench -rate M eta on every slice of the rod, rate [1/s], M its inertia
    and eta its twist."""

    rate: float

    def parameters(self, rod):
        return DragParameters(self.rate)


@adds_wrench(DragParameters)
@kernel
def drag_wrench(drag, nodes):
    for i in range(nodes.wrench.size):  # inertia, twists and wrenches at the nodes have one layout
        nodes.wrench[i] -= drag.rate * nodes.inertia[i] * nodes.twist[i]


if __name__ == "__main__":
    scene = ste.load_scene("three_tendon")
    bent = ste.static_equilibrium(ste.build_model(scene, fidelity="standard"), [3.0, 0.0, 0.0]).q
    for rate in (0.0, 5.0):
        model = ste.build_model(scene.replace({"effects.drag.rate": rate}), fidelity="standard")
        motion = ste.simulate(
            model, np.zeros(3), 0.75, sample_period=0.01, initial=ste.Simulation(model).reset(bent)
        )
        print(
            f"with a drag of {rate:g}/s it swings through"
            f" {1e3 * np.ptp(motion.tip_pose[:, :3, 3], axis=0).max():.0f} mm"
        )
