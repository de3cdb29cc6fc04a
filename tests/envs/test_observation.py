"""The observation's layout: groups side by side in the order of the table, each the thing it names
over its unit, clipped and cast."""

import numpy as np
import pytest
from scipy.linalg import expm, logm

from soft_tendon_env.envs import ReachEnv, ShapeEnv, TipPoseEnv
from soft_tendon_env.envs.kernels import scale_and_clip
from soft_tendon_env.envs.observation import GROUPS

SMALL = {"scene": "three_tendon", "fidelity": "standard"}  # 3 tendons, 12 coordinates or fewer
KINDS = {"TipPose": TipPoseEnv, "Shape": ShapeEnv, "Reach": ReachEnv}
HISTORY = {
    "observation": ["tip_position", "target_error", "tendon_lengths", "last_action", "command"],
    "history": 3,
}
NOISY = {
    "noise": {"position": 1e-3, "rotation": 0.01, "length": 5e-4},
    "latency": 0.03,
    "tension_gain": [0.9, 1.1],
}


@pytest.mark.parametrize("task", KINDS)
def test_groups_are_those_of_the_docstring_side_by_side(task):
    env = KINDS[task](**SMALL, preview=[0.1, 0.2, 0.4])
    slices = env.episodes.layout.slices
    assert ", ".join(slices) in " ".join(type(env).__doc__.split())
    ends = [where.stop for where in slices.values()]
    assert [where.start for where in slices.values()] == [
        0,
        *ends[:-1],
    ]
    assert env.episodes.layout.space.shape == (ends[-1],)
    space = env.observation_space
    assert (
        space.dtype == np.float32
        if task != "Reach"
        else set(space.spaces) == {"observation", "achieved_goal", "desired_goal"}
    )


def log(g):
    x = np.real(logm(g))
    return np.array([x[2, 1], x[0, 2], x[1, 0], *x[:3, 3]])


def test_groups_are_what_they_say(arm):
    sensors = [0.0, 0.1, 0.3]
    env = ShapeEnv(
        **{**arm, "fidelity": "fine"},
        action="tension",
        observation=[*GROUPS],
        sensors=sensors,
        preview=[0.1],
    )
    env.reset(seed=0)
    action = np.array([0.4, -0.9, 0.1])
    for _ in range(12):
        observation, *_ = env.step(action)
    assert env.observation_space.contains(observation)
    episodes = env.episodes
    model = episodes.model
    rows = episodes.arms.rows
    L = episodes.model.length
    q = rows.q[0].copy()
    q_dot = rows.q_dot[0].copy()
    terms = model.terms(q, q_dot)
    rest = episodes.starts.q
    wanted = episodes.target
    target = wanted.tip_pose[0, 0]
    ahead = wanted.tip_pose[0, 1]
    target_q = wanted.q[0]
    unit = units(model)
    error = np.repeat([0.5, 0.1 * L], 3)
    twist = np.repeat([5.0, 5.0 * L], 3)
    expected = {
        "coordinates": q / unit,
        "rates": q_dot / (10.0 * unit),
        "tip_position": terms.tip_pose[:3, 3] / L,
        "tip_rotation": terms.tip_pose[:3, :2].T.ravel(),
        "tip_twist": terms.tip_jacobian @ q_dot / twist,
        "tendon_lengths": (model.tendon_lengths(q) - model.tendon_lengths(rest)) / (0.1 * L),
        "target_error": log(np.linalg.solve(terms.tip_pose, target)) / error,
        "target_twist": wanted.tip_twist[0, 0] / twist,
        "preview": log(np.linalg.solve(terms.tip_pose, ahead)) / error,
        "command": 0.5 * (action + 1.0),
        "target_coordinates": (target_q[0] - q) / unit,
        "coordinate_preview": (target_q[1] - q) / unit,
        "strain_rate": (model.strain_at(q, sensors)[1] @ q_dot).ravel()
        / np.tile(np.repeat([10 / L, 1.0], 3), 3),
        "wanted_coordinates": (target_q / unit).ravel(),
        "target_lengths": (model.tendon_lengths(target_q[0]) - model.tendon_lengths(q)) / (0.1 * L),
        "last_action": action,
    }
    for name, value in expected.items():
        found = observation[episodes.layout.slices[name]]
        np.testing.assert_allclose(
            found, np.clip(value, -10, 10), rtol=1e-5, atol=2e-6, err_msg=name
        )
    strain = observation[episodes.layout.slices["strain"]].reshape(3, 6)
    h = 1e-5
    for place, seen in zip(sensors, strain, strict=True):
        a, b = np.clip([place - h, place + h], 0.0, L)
        before, after = model.backbone_at(q, [a, b])
        xi = log(np.linalg.solve(before, after)) / (b - a)
        np.testing.assert_allclose(
            seen * np.repeat([1 / L, 0.1], 3),
            xi - [0, 0, 0, 1, 0, 0],
            atol=2e-2,
            err_msg=f"strain at {place}",
        )


def units(model):
    """Coordinates that bend the arm by about a radian each: half their stiffness is the energy of
    that."""
    segment = model.scene.segments[0]
    bending = segment.young_modulus * np.pi * segment.radius**4 / 4
    n = model.coordinate_count
    return np.sqrt(
        bending / model.length / np.diag(model.terms(np.zeros(n), np.zeros(n)).stiffness)
    )


def test_history_is_what_was_observed_before_with_its_noise_and_at_reset_as_if_always_so(arm):
    env = TipPoseEnv(**arm, **HISTORY, randomize=NOISY)
    generator = np.random.default_rng(0)
    slices = env.episodes.layout.slices
    kept = [name for name in HISTORY["observation"] if GROUPS[name].of_arm]
    assert kept == ["tip_position", "tendon_lengths", "last_action", "command"]
    for seed in (0, 1):
        seen = [env.reset(seed=seed)[0]]
        for _ in range(6):
            seen.append(env.step(generator.uniform(-1, 1, env.action_space.shape))[0])
        assert all(env.observation_space.contains(observation) for observation in seen)
        now = np.concatenate([np.array(seen)[:, slices[name]] for name in kept], axis=1)
        assert len(np.unique(now[:, 0])) == len(now)  # of noise at least
        for time, observation in enumerate(seen):
            past = observation[slices["history"]].reshape(3, -1)
            np.testing.assert_array_equal(
                past, (now[np.maximum(time - np.arange(1, 4), 0)] - now[time]) / np.float32(0.1)
            )


@pytest.mark.no_jit
def test_values_are_scaled_then_clipped_then_cast():
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(-3, 3, (7, 5))
    values = sizes * rng.choice([-1.0, 1.0], (7, 5))
    scale = rng.uniform(0.1, 9.0, 5)
    bound = rng.uniform(1, 9, 5)
    values[0] = [np.inf, -np.inf, np.nan, 0.0, -0.0]
    values[1, 1] = np.nan
    values[2] = bound / scale
    result = np.empty((7, 5), dtype=np.float32)
    scale_and_clip(values, scale, bound, result)
    scaled = values * scale
    expected = np.clip(scaled, -bound, bound).astype(np.float32)
    np.testing.assert_array_equal(result, expected)
    assert np.isnan(result[0, 2])
    assert np.isnan(result[1, 1])
    assert np.isfinite(result).sum() == result.size - 2
    assert (np.abs(scaled) > bound).any()
    assert (np.abs(scaled) < bound).any()


def test_targets_from_the_tip_are_continuous_over_half_a_turn():
    """Position and columns of g^-1 g_bar, where the logarithm jumps."""
    names = ["target_error", "target_pose", "preview", "pose_preview"]
    env = TipPoseEnv(**SMALL, observation=names, preview=[0.1, 0.3])
    seen = {}
    for angle in (3.1, 3.2):  # on both sides of half a turn about z
        c = np.cos(angle)
        s = np.sin(angle)
        pose = [[c, -s, 0, 0.2], [s, c, 0, 0.1], [0, 0, 1, 0.05], [0, 0, 0, 1]]
        env.set_target({"type": "hold", "pose": pose})
        observation, _ = env.reset(seed=0)
        seen[angle] = env.episodes.layout.values(observation[None])
        tip = env.episodes.arms.reading.tip_pose[0]
        from_tip = np.linalg.inv(tip) @ pose
        expected = [*from_tip[:3, 3], *from_tip[:3, 0], *from_tip[:3, 1]]
        np.testing.assert_allclose(seen[angle]["target_pose"][0], expected, atol=1e-6)
        np.testing.assert_allclose(
            seen[angle]["pose_preview"][0], [*expected, *expected], atol=1e-6
        )
    change = {name: np.abs(seen[3.1][name] - seen[3.2][name]).max() for name in names}
    assert change["target_pose"] < 0.11
    assert change["pose_preview"] < 0.11
    assert change["target_error"] > 6.0


def test_targets_from_the_tip_are_those_of_the_logarithm():
    env = TipPoseEnv(**SMALL, observation=["target_error", "target_pose"])
    env.reset(seed=2)
    for _ in range(20):
        observation, *_ = env.step(np.ones(3))
    values = env.episodes.layout.values(observation[None])
    wx, wy, wz, vx, vy, vz = values["target_error"][0]
    twist = np.array(
        [
            [0, -wz, wy, vx],
            [wz, 0, -wx, vy],
            [-wy, wx, 0, vz],
            [0, 0, 0, 0],
        ]
    )
    pose = expm(twist)
    position = pose[:3, 3]
    expected = [*position, *pose[:3, 0], *pose[:3, 1]]
    np.testing.assert_allclose(values["target_pose"][0], expected, atol=1e-5)


def test_the_space_bounds_every_group_by_what_it_is():
    """Actions and commands are within the limits, ways to targets ten lengths of the rod; places in
    the world are farther away where the base is. Changes reach from one end to the other."""
    away = 0.9
    scene = {"scene": "three_tendon", "base.position": [0.0, -away, 0.1]}
    env = ShapeEnv(
        scene=scene,
        fidelity="fast",
        observation=[*GROUPS],
        history=2,
        preview=[0.1],
    )
    layout = env.episodes.layout
    high = layout.space.high
    np.testing.assert_array_equal(layout.space.low, -high)
    expected = dict.fromkeys(GROUPS, 10.0)
    for name in ("last_action", "command"):
        expected[name] = 1.0
    for name in ("target_error", "preview", "target_pose", "pose_preview"):
        expected[name] = 100.0
    expected["tip_position"] = 10.0 + away / 0.3
    for name, bound in expected.items():
        bounds = high[layout.slices[name]]
        np.testing.assert_allclose(bounds, bound, rtol=1e-6, err_msg=name)
    kept = []
    for name, group in GROUPS.items():
        if group.of_arm:
            kept.append(high[layout.slices[name]])
    # twice the bound, in tenths of the unit
    changes = 20.0 * np.concatenate(kept)
    bounds = high[layout.slices["history"]]
    expected_bounds = np.tile(changes, 2)
    np.testing.assert_allclose(bounds, expected_bounds, rtol=1e-6)
