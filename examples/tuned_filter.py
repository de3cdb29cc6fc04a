"""Model-predictive control with a Kalman filter of your own in the benchmark: tuned for exact sensors. `python examples/tuned_filter.py`

The filter of the controllers expects noise and a model that is off. Where sensors are exact it finds loads and pushes sooner if
it trusts the tip's measured pose and takes forces for less steady: by a short search over 16 episodes, apart from those of the benchmark.
"""

import sys
from pathlib import Path

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.cli.main import main
from soft_tendon_env.control.kalman import USUAL
from soft_tendon_env.policies.controller_policy import make_policy, observation_options
from soft_tendon_env.scene.file import load_scene

TUNED = USUAL._replace(force=4.0 * USUAL.force, offset=3.0 * USUAL.offset, tip=USUAL.tip / 4.0)


def predictive(env):
    """Believes in the arm of the paper at `fast`, as filtered:predictive@fast does."""
    belief = build_model(load_scene("paper"), "fast")
    return make_policy("predictive", env, belief, estimator="kalman", uncertainty=TUNED)


predictive.options = observation_options("predictive", "TipPose", estimator="kalman", regime="state")

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    arguments = sys.argv[1:] or ["--settings", "load", "--difficulties", "medium", "--regimes", "state", "--episodes", "4", "--no-margins"]
    main(["arena", "--policies", "tuned_filter:predictive", "filtered:predictive@fast", "--out", "out/tuned_filter", *arguments])
