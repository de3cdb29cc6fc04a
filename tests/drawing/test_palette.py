import numpy as np
import pytest

from soft_tendon_env.drawing.palette import LEARNED, MODEL_BASED, OTHERS, hues, shades, style, styles


def test_colours_are_told_apart():
    for colours in (OTHERS, [*{*MODEL_BASED.values(), *LEARNED.values()}]):
        apart = np.linalg.norm(np.array(colours, dtype=float)[:, None] - np.array(colours), axis=-1)[np.triu_indices(len(colours), 1)]
        assert apart.min() > 60.0


def test_series_of_an_arm_are_shades_or_hues():
    assert (np.diff(np.array(shades(OTHERS[0], 10)).sum(axis=1)) > 0).all()
    assert len(set(hues(10))) == 10 and min(max(color) - min(color) for color in hues(10)) > 80, "colours, not greys"


@pytest.mark.cases(
    "name, same",
    [
        ("out/runs/ppo_tip_pose/seed_0/best", "ppo"),
        ("predictive@fast", "predictive"),
        ("MPC, Kalman filter", "filtered:predictive"),
        ("printed law", "paper"),
        ("filtered predictive", "filtered:predictive"),
        ("agents/trained/dagger/TipPose", "dagger (5 seeds)"),
    ],
)
def test_a_policy_looks_the_same_by_all_of_its_names(name, same):
    assert style(name) == style(same)


def test_policies_that_are_drawn_together_differ():
    variants = ("filtered:predictive", "adaptive:predictive", "robust_predictive", "long_horizon_predictive")
    names = ["predictive", *variants, "ppo", "ppo_long", "arm", "own"]
    found = styles(names)
    assert len({own.colour for own in found.values()}) == len(names)
    assert found["ppo"].marker == found["ppo_long"].marker == "o" and found["predictive"].marker == "s"
    trainings = styles(["DAgger", "DAgger, loads", "DAgger, water", *(f"ppo_{number}" for number in range(9))])
    assert len({own.colour for own in trainings.values()}) == len(trainings) and {own.marker for own in trainings.values()} == {"o"}
    assert found["predictive"] == style("predictive") and found["ppo"] == style("ppo")
