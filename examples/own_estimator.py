"""A state estimator of your own: a Luenberger observer from tendon lengths alone, found by its
name. `python examples/own_estimator.py`"""

import gymnasium as gym
import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.control import Estimate
from soft_tendon_env.evaluation import evaluate
from soft_tendon_env.policies import load_policy, policy_options


@ste.register("estimator", "lengths")
class LengthObserver:
    """The model's own motion, which is moved by a share of K^-1 B (B^T K^-1 B)^-1 e: the least
    bending for an error e of tendon lengths."""

    needs, history = ("tendon_length",), 1

    def __init__(self, model, setting, share=0.3):
        self.simulation, self.period, self.share = ste.Simulation(model), setting.period, share
        terms = model.terms(*np.zeros((2, model.coordinate_count)))
        self.straight = model.tendon_lengths(np.zeros(model.coordinate_count))
        softness = np.linalg.solve(terms.stiffness, terms.actuation)
        self.pull, self.bend = (
            terms.actuation.T,
            softness @ np.linalg.inv(terms.actuation.T @ softness),
        )

    def estimate(self, measured, last):
        longer = measured.tendon_length - self.straight
        q, q_dot = -self.bend @ longer, np.zeros(len(self.bend))
        if last is not None:
            self.simulation.reset(last.q, last.q_dot)
            self.simulation.step(measured.sent[-1], self.period)
            q, q_dot = self.simulation.state.q, self.simulation.state.q_dot
        missed = -self.bend @ (longer + self.pull @ q)
        return Estimate(q + self.share * missed, q_dot + self.share**2 / self.period * missed)


if __name__ == "__main__":
    options = policy_options(
        "lengths:tracking", "TipPose", {"scene": "three_tendon", "fidelity": "fast"}
    )
    env = gym.make("TendonRod-TipPose-v0", max_episode_steps=150, **options)
    (score,) = evaluate(load_policy("lengths:tracking", env), env, seeds=[0])
    print(
        f"by tendon lengths and the tip's pose: {1e3 * score.errors['position_error'].rms:.2f} mm"
        " root mean square"
    )
