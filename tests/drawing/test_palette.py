import pytest

from soft_tendon_env.drawing.palette import style, styles


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
