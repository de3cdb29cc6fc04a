"""What every controller of the catalogue keeps to, on arms with few and many tendons; controllers
from outside by name."""

import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, ControllerInput, Reference, controllers_of
from soft_tendon_env.control.catalogue import PRESETS
from soft_tendon_env.control.feedforward import StaticFeedforward
from soft_tendon_env.control.paper_laws import PaperShape
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.control.shape_tracking import ShapeFeedforward

PERIOD = 0.02
ENTRIES = [pytest.param(entry, id=key.replace("/", "-")) for key, entry in CONTROLLERS.items()]
SCENES = ["four_tendon", "three_tendon", "catheter", "paper"]


def controller_input(model, random_state, seed):
    """A lively arm, measured somewhat off its model, and a moving target anywhere around."""
    rng = np.random.default_rng(seed)
    q, q_dot = random_state(model, seed)
    goals = np.stack([random_state(model, 1000 + 2 * seed + i)[0] for i in range(2)])
    poses = np.stack(
        [
            moved_pose(
                model.tip_pose(goal), rng.normal(size=6) * np.repeat([0.2, 0.05 * model.length], 3)
            )
            for goal in goals
        ]
    )
    measured = moved_pose(
        model.tip_pose(q), rng.normal(size=6) * np.repeat([0.02, 0.01 * model.length], 3)
    )
    target = Reference(np.array([0.0, 0.15]), poses, poses[:, :3, 3], goals)
    return ControllerInput(q, q_dot, measured, rng.random(model.tendon_count), target)


def assert_sound(decision, limits):
    least, greatest = limits.T
    assert np.isfinite(decision.tension).all()
    assert (decision.tension >= least).all()
    assert (decision.tension <= greatest).all()
    assert all(0.0 <= decision.report[name] <= 1.0 for name in ("limited", "singular"))


def same(a, b):
    return a.tension.tobytes() == b.tension.tobytes() and a.report == b.report


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("entry", ENTRIES)
def test_tensions_stay_within_limits_whatever_happens(build, random_state, limits_of, entry, scene):
    """Inputs that jump from one to another, with the memory of the last; every controller does
    something in them."""
    model = build(scene)
    limits = limits_of(model)
    memory = None
    asked = []
    controller = entry.make(model, limits, PERIOD)
    for seed in range(6):
        now = controller_input(model, random_state, seed)
        for _ in range(5):
            decision = controller.act(now, memory)
            assert_sound(decision, limits)
            now = now._replace(tension=decision.tension)
            memory = decision.memory
            asked.append(decision.tension)
    assert np.ptp(asked, axis=0).max() > 0.1


@pytest.mark.parametrize("entry", ENTRIES)
def test_memory_is_explicit(build, random_state, limits_of, entry):
    """One controller for two arms decides for each what it would alone, bit for bit."""
    model = build("three_tendon")
    limits = limits_of(model)
    shared, alone = (
        entry.make(model, limits, PERIOD),
        [entry.make(model, limits, PERIOD) for _ in range(2)],
    )
    memories = [(None, None)] * 2
    last = [None] * 2
    for step in range(4):
        for arm in range(2):
            now = controller_input(model, random_state, 10 * arm + step)
            last[arm], decision = (
                shared.act(now, memories[arm][0]),
                alone[arm].act(now, memories[arm][1]),
            )
            assert same(last[arm], decision)
            memories[arm] = last[arm].memory, decision.memory
    assert not same(*last)


@pytest.mark.parametrize("entry", ENTRIES)
def test_models_that_cannot_follow_hold_the_last_tensions(build, random_state, limits_of, entry):
    """Coordinates for which there is no strain. Feedforward does not look at them, (37) takes them
    as they are."""
    model = build("three_tendon")
    controller = entry.make(model, limits_of(model), PERIOD)
    now = controller_input(model, random_state, 0)
    lost = now._replace(q=np.full_like(now.q, 1e4), tension=np.array([1.0, 2.0, 7.0]))
    before = controller.act(now)
    decision = controller.act(lost, before.memory)
    assert_sound(decision, limits_of(model))
    if isinstance(controller, StaticFeedforward | ShapeFeedforward | PaperShape):
        assert decision.report["singular"] == 0.0
    else:
        np.testing.assert_array_equal(decision.tension, [1.0, 2.0, 5.0])
        assert decision.report["singular"] == 1.0
    assert_sound(controller.act(now, decision.memory), limits_of(model))


@pytest.mark.parametrize(
    ("name", "ahead"), [("predictive", 13), ("long_horizon_predictive", 25), ("feedforward", 2)]
)
def test_plans_look_as_far_ahead_as_their_horizon(name, ahead):
    """Six intervals of one period, twelve of two, and the period that begins."""
    entry = controllers_of("TipPose")[name]
    assert entry.looks_ahead == ahead
    if name == "predictive":
        longer = entry.with_parameters({"horizon": 3, "hold": 4})
        assert longer.looks_ahead == 13
        assert longer.parameters == {**entry.parameters, "horizon": 3, "hold": 4}


def test_controllers_have_their_numbers_as_parameters():
    parameters = controllers_of("TipPose")["tracking"].parameters
    assert parameters == {"settling_time": 0.2, "damping": 1.0, "integral_time": 0.5}
    shapes = controllers_of("Shape")["tracking"].parameters
    assert shapes == {"settling_time": 0.4, "damping": 10.0}
    assert controllers_of("Shape")["feedforward"].parameters == {}


def test_presets_are_their_controllers_with_other_numbers():
    entries = controllers_of("TipPose")
    for name, (base, added, numbers) in PRESETS.items():
        preset = entries[name]
        assert preset.parameters == {**entries[base].parameters, **numbers}
        assert preset.description == entries[base].description + added
