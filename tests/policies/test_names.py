"""Names of policies: which of the three each is, and what is refused."""

import pytest

from soft_tendon_env.policies.names import Agent, Controller, PolicyName, UserPolicy

AGENTS = "agent, apg, apg_filtered, apg_obstacles, apg_water, dagger, "
BEHIND = (
    "what stands behind 'filtered:' should be the folder of an agent .*, or a controller of"
    " TipPose; .*valid: .*predictive"
)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with an agent, a run, seeds, and a tuned controller."""
    monkeypatch.chdir(tmp_path)
    for folder in ("agent_1", "run/best", "seeds/seed_0", "ppo/seed_0", "tracking"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("agent_1/weights.npz", "run/config.json", "run/best/weights.npz"):
        (tmp_path / file).touch()
    (tmp_path / "best.toml").write_text(
        'policy = "filtered:predictive@fast"\nparameters = { effort = 0.01, "estimator.force" ='
        " 0.002 }\n"
    )
    (tmp_path / "odd.toml").write_text('policy = "tracking"\nparameters = { effort = 0.01 }\n')


@pytest.mark.parametrize(
    ("text", "kind", "known"),
    [
        ("tracking", Controller, {"name": "tracking", "estimator": None, "belief": None}),
        ("filtered:tracking", Controller, {"name": "tracking", "estimator": "kalman"}),
        ("filtered:tracking@fast", Controller, {"estimator": "kalman", "belief": "fast"}),
        (
            "best.toml",
            Controller,
            {"name": "predictive", "parameters": {"effort": 0.01, "estimator.force": 0.002}},
        ),
        ("agent", Agent, {}),
        ("dagger", Agent, {}),
        ("agent_1", Agent, {}),
        ("run/best", Agent, {"agent": "run/best", "estimator": None}),
        ("filtered:apg", Agent, {"agent": "apg", "estimator": "kalman", "belief": None}),
        ("filtered:run/best@fast", Agent, {"agent": "run/best", "belief": "fast"}),
        ("os.path:join", UserPolicy, {"module": "os.path", "name": "join"}),
    ],
)
def test_every_name_is_one_of_three(here, text, kind, known):
    found = PolicyName.parse(text, "TipPose")
    assert type(found) is kind
    assert found.text == text
    assert vars(found).items() >= known.items()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "run",
            (
                "policy is 'run', no policy: it should be the folder of an agent .of a training:"
                f" run/best., {AGENTS}"
            ),
        ),
        ("nobody", "policy is 'nobody', no policy: .* or a controller of TipPose"),
        (
            "nothing:there",
            "policy is 'nothing:there': it should be module:name of what makes a policy; No module",
        ),
        ("os:nothing", "should be module:name of what makes a policy"),
        ("filtered:predictive@coarse", "stands behind '@' should be 'fast', 'standard', 'fine'"),
        ("filtered:apg@coarse", "stands behind '@' should be 'fast', 'standard', 'fine'"),
        ("apg@fast", "policy is 'apg@fast', no policy"),
        *((f"filtered:{name}", BEHIND) for name in ("run", "seeds", "nobody", "nobody@fast")),
        (
            "run/model.zip",
            (
                r"(?s)policy is 'run/model.zip': a file of .* mine:agent:\s.*\s+def agent.env.:"
                r" return PPO.load.'run/model.zip'"
            ),
        ),
        ("odd.toml", "parameters has 'effort', which tracking has not: valid: damping"),
    ],
)
def test_what_is_no_policy_is_refused(here, text, said):
    with pytest.raises(ValueError, match=said):
        PolicyName.parse(text, "TipPose").options({})
