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

    needs = ("tendon_length",)
    history = 1

    def __init__(self, model, setting, share=0.3):
        self.simulation = ste.Simulation(model)
        self.period = setting.period
        self.share = share
        rest = np.zeros(model.coordinate_count)
        terms = model.terms(rest, rest)
        self.straight = model.tendon_lengths(rest)
        # K^-1 B, and what tendons are pulled in by it
        softness = np.linalg.solve(terms.stiffness, terms.actuation)
        self.pull = terms.actuation.T
        self.bend = softness @ np.linalg.inv(self.pull @ softness)

    def estimate(self, measured, last):
        longer = measured.tendon_length - self.straight
        q = -self.bend @ longer
        q_dot = np.zeros(len(self.bend))
        if last is not None:
            self.simulation.reset(last.q, last.q_dot)
            self.simulation.step(measured.sent[-1], self.period)
            q = self.simulation.state.q
            q_dot = self.simulation.state.q_dot
        predicted = -self.pull @ q
        missed = self.bend @ (predicted - longer)
        correction = self.share * missed
        rate_correction = self.share**2 / self.period * missed
        return Estimate(q + correction, q_dot + rate_correction)


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
