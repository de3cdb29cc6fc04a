"""Coordinates from strain sensors: exact where nothing is noisy, the least cost where it is, bounded where sensors are few."""

import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, Decision, Entry, Estimate, Measurement, SensorNoise, StrainEstimator
from soft_tendon_env.control.estimation import ACCELERATION, AMPLITUDE, LEAST_NOISE, RATE
from soft_tendon_env.envs import ReachEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.policies.controller_policy import make_policy, observation_options

PERIOD = 0.02
EXACT = SensorNoise(curvature=1e-6, stretch=1e-8, curvature_rate=1e-5, stretch_rate=1e-7)
NOISE = SensorNoise(curvature=0.05, stretch=5e-4, curvature_rate=0.5, stretch_rate=5e-3)
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
CURVED = {"segments.0.curvature": [0.5, -2.0, 3.0]}
ARMS = {  # name, changes, sensors: enough of them
    "paper": ("paper", {}, 6),
    "paper_16dof": ("paper_16dof", {}, 8),
    "paper_48dof": ("paper_48dof", {}, 16),
    "four_tendon": ("four_tendon", {}, 4),
    "two_segment_six": ("two_segment_six", {}, 4),
    "curved": ("three_tendon", CURVED, 4),
}


def of_sensors(strain, rate):
    return Measurement(np.eye(4), np.empty((0, 1)), 0.0, strain=strain, strain_rate=rate)


def middles(model, count):
    return model.length * (np.arange(count) + 0.5) / count


def sensed(model, places, q, q_dot):
    """Strains less those of the stress-free rod, and their rates from differences of strains."""
    free = STRAIGHT + np.array([*model.scene.segments[0].curvature, 0.0, 0.0, 0.0])
    ahead, behind = (model.strain_at(q + h * q_dot, places)[0] for h in (1e-5, -1e-5))
    return model.strain_at(q, places)[0] - free, (ahead - behind) / 2e-5


def noisy(rng, strain, rate, noise=NOISE):
    strain = strain + rng.normal(size=strain.shape) * noise.of_strains(1)
    return strain, rate + rng.normal(size=rate.shape) * noise.of_strain_rates(1)


def covariances(model, places, q, noise):
    """Of least squares alone, linearised at q: of the scaled coordinates and of their rates."""
    H = model.strain_at(q, places)[1].reshape(-1, q.size) * model.coordinate_scale()
    weighted = [H / deviation[:, None] for deviation in (noise.of_strains(len(places)), noise.of_strain_rates(len(places)))]
    return [np.linalg.inv(each.T @ each) for each in weighted]


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.cases("seed", range(4))
def test_without_noise_the_state_is_found(arm, seed, build, random_state):
    name, changes, count = ARMS[arm]
    model = build(name, changes)
    (q, q_dot), places, scale = random_state(model, seed), middles(model, count), model.coordinate_scale()
    strain, rate = sensed(model, places, q, q_dot)
    estimator = StrainEstimator(model, places, PERIOD, EXACT)
    elsewhere = Estimate(*random_state(model, seed + 100))
    assert np.abs((elsewhere.q - q) / scale).max() > 0.05
    for last in (None, elsewhere, Estimate(q, q_dot)):
        found = estimator.estimate(of_sensors(strain, rate), last)
        np.testing.assert_allclose(found.q / scale, q / scale, atol=1e-7)
        np.testing.assert_allclose(found.q_dot / scale, q_dot / scale, atol=1e-5 * np.abs(q_dot / scale).max())


@pytest.mark.parametrize("arm", ARMS)
def test_the_estimate_costs_least(arm, build, random_state):
    """The weighted sum of squares of the docstring, written out again; every state around costs more."""
    name, changes, _ = ARMS[arm]
    model, rng = build(name, changes), np.random.default_rng(0)
    (q, q_dot), last = random_state(model, 1), Estimate(*random_state(model, 2))
    places, scale = middles(model, 3), model.coordinate_scale()
    strain, rate = noisy(rng, *sensed(model, places, q, q_dot))
    found = StrainEstimator(model, places, PERIOD, NOISE).estimate(of_sensors(strain, rate), last)
    free, H = model.strain_at(0 * q, places)[0], model.strain_at(found.q, places)[1]

    def size(values, deviation):
        return ((values / deviation) ** 2).sum()

    def cost(x):
        missed = model.strain_at(x, places)[0] - free - strain
        moved = x - last.q - PERIOD * last.q_dot
        prior = size(moved / scale, ACCELERATION * PERIOD**2) + size(x / scale, AMPLITUDE)
        return size(missed, NOISE.of_strains(1)) + prior

    def rate_cost(v):
        prior = size((v - last.q_dot) / scale, ACCELERATION * PERIOD) + size(v / scale, RATE)
        return size(H @ v - rate, NOISE.of_strain_rates(1)) + prior

    for value, of in ((found.q, cost), (found.q_dot, rate_cost)):
        least, step = of(value), 0.05 * scale
        assert np.isfinite(least) and least > 0
        assert all(of(value + step * rng.normal(size=q.size)) > least for _ in range(200))
        assert all(of(value + sign * each) > least for sign in (-1, 1) for each in np.diag(step))


def test_with_noise_it_is_better_than_least_squares_alone(build, random_state):
    """Mean square errors over many draws."""
    model, rng = build("paper"), np.random.default_rng(0)
    (q, q_dot), places, scale = random_state(model, 0), middles(model, 4), model.coordinate_scale()
    strain, rate = sensed(model, places, q, q_dot)
    noise = SensorNoise(**{name: 4 * value for name, value in NOISE})
    estimator = StrainEstimator(model, places, PERIOD, noise)
    alone = [np.trace(covariance) for covariance in covariances(model, places, q, noise)]
    errors = []
    for _ in range(200):
        found = estimator.estimate(of_sensors(*noisy(rng, strain, rate, noise)), Estimate(q - PERIOD * q_dot, q_dot))
        errors.append([(((found.q - q) / scale) ** 2).sum(), (((found.q_dot - q_dot) / scale) ** 2).sum()])
    of_q, of_q_dot = np.mean(errors, axis=0) / alone
    assert 0.01 < of_q < 0.5 and 0.01 < of_q_dot < 0.95


@pytest.mark.parametrize("places", [[0.95], [0.2], [0.3, 0.9]])
def test_few_sensors_stay_bounded(places, build, random_state):
    """What the sensors cannot tell stays bounded and comes to rest, whatever was believed; what they can is kept."""
    model, rng = build("paper_16dof"), np.random.default_rng(0)
    (q, q_dot), scale = random_state(model, 0), model.coordinate_scale()
    strain, _ = sensed(model, places, q, 0 * q_dot)
    free = model.strain_at(0 * q, places)[0]
    estimator = StrainEstimator(model, places, PERIOD, NOISE)
    found = Estimate(q + 5 * scale, 20 * scale)
    for k in range(400):
        found = estimator.estimate(of_sensors(*noisy(rng, strain, 0 * strain)), found)
        assert np.abs(found.q / scale).max() < 2 * AMPLITUDE and np.abs(found.q_dot / scale).max() < 2 * RATE, k
    assert np.abs(found.q_dot / scale).max() < 0.5 * RATE
    missed = model.strain_at(found.q, places)[0] - free - strain
    assert np.sqrt(np.mean((missed / NOISE.of_strains(1)) ** 2)) < 1.5


@pytest.mark.parametrize("arm", ["paper_16dof", "paper_48dof"])
@pytest.mark.parametrize("size", [1e1, 1e3, 1e8, 1e155, 1e307])
def test_absurd_measurements_give_coordinates_that_a_model_can_take(arm, size, build, random_state):
    model, rng = build(arm), np.random.default_rng(0)
    last, places = Estimate(*random_state(model, 0)), middles(model, 6)
    estimator = StrainEstimator(model, places, PERIOD)
    for before in (None, last, Estimate(1e9 * last.q, last.q_dot)):
        for sign in (rng.choice([-1.0, 1.0], size=(6, 6)), 1.0, -1.0):
            found = estimator.estimate(of_sensors(np.full((6, 6), size) * sign, np.full((6, 6), size) * sign), before)
            assert np.isfinite(found.q).all() and np.isfinite(found.q_dot).all()
            model.tip_pose(found.q)


def test_nothing_that_is_given_is_changed_and_nothing_is_remembered(build, random_state):
    model = build("four_tendon")
    (q, q_dot), places = random_state(model, 0), middles(model, 4)
    strain, rate = sensed(model, places, q, q_dot)
    last = Estimate(0.5 * q, 0.5 * q_dot)
    estimator, kept = StrainEstimator(model, places, PERIOD), [values.copy() for values in (strain, rate, last.q, last.q_dot)]
    first = estimator.estimate(of_sensors(strain, rate), last)
    estimator.estimate(of_sensors(2 * strain, rate), None)
    for a, b in zip(first[:2], estimator.estimate(of_sensors(strain, rate), last)[:2], strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(kept, (strain, rate, last.q, last.q_dot), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.cases(
    "changes, error, message",
    [
        ({"model": "paper"}, TypeError, "model should be a Model"),
        ({"sensors": []}, ValueError, "sensors should name at least one"),
        ({"sensors": [0.1, 0.3]}, ValueError, "sensors should lie between 0 and the rod's length, 0.25, not 0.1 to 0.3"),
        ({"sensors": [-0.1]}, ValueError, "sensors should lie between 0"),
        ({"sensors": [np.nan]}, ValueError, "sensors should be finite"),
        ({"sensors": 0.1}, ValueError, r"sensors should have shape \(any,\)"),
        ({"period": 0.0}, ValueError, "period should be a positive number of seconds"),
        ({"noise": SensorNoise(curvature=1.0)}, ValueError, r"noise\.stretch should be a positive number, not 0.0"),
        ({"noise": SensorNoise(curvature=1.0, stretch=1.0, stretch_rate=1.0)}, ValueError, r"noise\.curvature_rate"),
    ],
)
def test_bad_settings_are_refused_by_name(changes, error, message, build):
    good = {"model": build("four_tendon"), "sensors": [0.1, 0.2], "period": PERIOD}
    StrainEstimator(**good)
    with pytest.raises(error, match=message):
        StrainEstimator(**{**good, **changes})


def test_bad_measurements_are_refused_by_name(build):
    estimator, good = StrainEstimator(build("four_tendon"), [0.1, 0.2], PERIOD), np.zeros((2, 6))
    for bad in (np.zeros((3, 6)), np.full((2, 6), np.nan)):
        with pytest.raises(ValueError, match="^strain should"):
            estimator.estimate(of_sensors(bad, good), None)
        with pytest.raises(ValueError, match="^strain_rate should"):
            estimator.estimate(of_sensors(good, bad), None)


class Watcher:
    """A controller that wanders and keeps what it was told."""

    def __init__(self, model, limits, period):
        self.limits, self.told, self.rng = limits, [], np.random.default_rng(0)

    def act(self, now, memory=None):
        self.told.append(now)
        least, greatest = self.limits.T
        return Decision(least + 0.3 * self.rng.random(len(self.limits)) * (greatest - least))


@pytest.fixture
def watched(monkeypatch):
    """watched(kind, **options): an environment and the policy of a watcher that is told strains."""

    def make(kind, **options):
        task = kind.__name__.removesuffix("Env").removesuffix("Vector")
        monkeypatch.setitem(CONTROLLERS, task, {"watcher": Entry("watches", Watcher, looks_ahead=2)})
        env = kind(**{**observation_options("watcher", task, estimator="strain"), "fidelity": "fast", **options})
        return env, make_policy("watcher", env, estimator="strain")

    return make


SCENES = {
    "paper": {"scene": "paper"},
    "redundant": {"scene": "four_tendon", "sensors": 3},
    "curved": {"scene": {"scene": "three_tendon", **CURVED}},
    "heavy": {"scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}},
}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("kind", [TipPoseEnv, ShapeEnv, ReachEnv])
def test_controllers_in_environments_are_told_the_coordinates(scene, kind, watched):
    """From sensors without noise, less than half as far off as the noise that the estimator counts with would put least squares alone."""
    env, policy = watched(kind, **SCENES[scene])
    (observation, _), state, arms = env.reset(seed=0), None, env.episodes.arms
    model, sensors = env.episodes.model, env.episodes.sensors
    scale = model.coordinate_scale()
    for _ in range(12):
        q, q_dot = arms.rows.q[0] / scale, arms.rows.q_dot[0] / scale
        target = env.episodes.target
        action, state = policy.predict(observation, state)
        told = policy.controller.told[-1]
        allowed, rate_allowed = (np.sqrt(np.diag(each)) / 2 for each in covariances(model, sensors, arms.rows.q[0], LEAST_NOISE))
        assert allowed.max() < 0.02 and (np.abs(told.q / scale - q) < allowed).all()
        assert rate_allowed.max() < 0.2 and (np.abs(told.q_dot / scale - q_dot) < rate_allowed).all()
        if kind is ShapeEnv:
            np.testing.assert_allclose(told.reference.q / scale, target.q[0] / scale, atol=1e-5)
        else:
            assert told.reference.q is None
        observation, *_ = env.step(action)
    assert np.abs(q).max() > 0.05 and np.abs(q_dot).max() > 0.1  # it moved


def test_rows_are_estimated_each_by_itself_from_noisy_sensors(watched):
    """Estimates stay within what the noise allows, for every row, through resets of episodes."""
    noise = {"curvature": 0.05, "stretch": 5e-4, "curvature_rate": 0.5, "stretch_rate": 5e-3}
    env, policy = watched(TipPoseVectorEnv, num_envs=3, scene="paper", randomize={"noise": noise})
    (observation, _), state, arms = env.reset(seed=0), None, env.episodes.arms
    scale, errors = env.episodes.model.coordinate_scale(), []
    for _ in range(15):
        action, state = policy.predict(observation, state)
        errors.append([(now.q - q) / scale for now, q in zip(policy.controller.told[-3:], arms.rows.q, strict=True)])
        observation, *_ = env.step(action)
    covariance, _ = covariances(env.episodes.model, env.episodes.sensors, arms.rows.q[0], SensorNoise(**noise))
    size = np.sqrt(np.mean(np.square(errors), axis=0) / np.diag(covariance))
    assert (size < 2.0).all() and size.mean() > 0.1


def test_wrong_models_are_believed(watched, build):
    """The estimator knows what the controller knows: another model gives other coordinates."""
    env, _ = watched(TipPoseEnv, scene="three_tendon", fidelity="scene")
    stiffer = build("three_tendon", {"segments.0.young_modulus": 2 * env.episodes.model.scene.segments[0].young_modulus})
    right, wrong = (make_policy("watcher", env, model, estimator="strain") for model in (None, stiffer))
    observation, _ = env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.array([-0.5, -0.9, -1.0]))
    for policy in (right, wrong):
        policy.predict(observation)
    a, b = (policy.controller.told[-1].q for policy in (right, wrong))
    np.testing.assert_allclose(b, 2 * a, rtol=0.05)
