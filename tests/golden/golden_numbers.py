"""Numbers that a change of the code is compared with: motions, equilibria, linearisations,
gradients, controllers and rewards, by name."""

from collections.abc import Callable, Mapping

import gymnasium as gym
import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.accuracy.candidates import known_fields, snapshots
from soft_tendon_env.accuracy.fidelity import PRESETS as PARTS_OF
from soft_tendon_env.accuracy.input_motions import USUAL as USUAL_MOTIONS
from soft_tendon_env.envs import IDS
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.scene.scene import rod_length

Numbers = Mapping[str, np.ndarray]
USUAL = "fast", "standard", "fine"
PRESETS = {"paper": USUAL, "three_tendon": USUAL, "helical": USUAL, "paper_48dof": ("scene",)}
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
LOADS = {
    "bare": {},
    "gravity_payload": {**GRAVITY, "effects.tip_load.mass": 0.005},
    "water": {"effects.fluid": {"density": 1000.0}},
    "disturbance": {
        "effects.disturbance.loads": [
            {"at": 0.2, "force": [0.0, 0.05, 0.0], "signal": {"type": "sine", "frequency": 2.0}}
        ]
    },
    "moving_base": {
        "effects.moving_base": {
            "amplitude": [0.0, 0.01, 0.0],
            "angular_amplitude": 0.1,
            "frequency": 1.0,
        }
    },
    "sphere": {
        "effects.contact.obstacles": [
            {"type": "sphere", "position": [0.2, 0.0, -0.06], "radius": 0.04}
        ]
    },
}
RESTS = {
    "paper hangs": ("paper", LOADS["gravity_payload"]),
    "three_tendon hangs": ("three_tendon", LOADS["gravity_payload"]),
    "three_tendon stands": (
        "three_tendon",
        {"effects.gravity.acceleration": [-9.81, 0.0, 0.0], "effects.tip_load.mass": 0.03},
    ),
    "paper against a sphere": ("paper", LOADS["sphere"]),
}
DIFFERENTIATED = (
    ("TipPose", "paper", "bare"),
    ("Shape", "three_tendon", "gravity_payload"),
    ("TipPose", "helical", "water"),
    ("TipPose", "three_tendon", "moving_base"),
)
NO_POTENTIAL = ("disturbance", "moving_base")
PERIOD = 0.02
PERIODS = 100
EVERY = 5
EPISODE = 40
SEEDS = (0, 1, 2)
REWARDED = range(5)
LIMIT = {"paper": 6.0, "paper_48dof": 6.0, "three_tendon": 2.0, "helical": 2.0}
"""Tension [N] up to which the tendons of a scene are pulled here."""


def loaded(scene: str, changes: Mapping, preset: str) -> ste.Scene:
    """A scene with changes, at the numbers of a preset without a trial: with the shipped fields
    that are nearest to its loads."""
    changed = ste.load_scene(scene).replace(changes)
    if preset == "scene":
        return changed
    asked = PARTS_OF[preset]
    fields = known_fields(changed)
    length = rod_length(changed)
    count = fields.needed(asked.fields * length, USUAL_MOTIONS) or len(fields.coefficients)
    quadrature = {"tolerance": asked.quadrature, "least": asked.least}
    numbers = {
        "strain": snapshots(changed, fields, count),
        "quadrature": quadrature,
        "integrator": {"tolerance": asked.tolerance * length},
    }
    return changed.replace(numbers)


def arm(scene: str, changes: Mapping, preset: str) -> ste.Model:
    """The model of it."""
    return ste.build_model(loaded(scene, changes, preset), fidelity="scene")


def tensions(scene: str, periods: int) -> np.ndarray:
    """Tensions (periods, n_a) [N] that are drawn anew every 0.2 s."""
    count = len(ste.load_scene(scene).tendons)
    return np.repeat(
        np.random.default_rng(7).uniform(0.0, LIMIT[scene], (periods // 10, count)), 10, axis=0
    )


def motions(*scenes: str) -> Numbers:
    """Tips of 2 s at 50 Hz, and coordinates and energies at 10 Hz, of these scenes or of all."""
    found = {}
    for scene, presets in PRESETS.items():
        if scenes and scene not in scenes:
            continue
        for load, changes in LOADS.items():
            for preset in presets:
                model = arm(scene, changes, preset)
                motion = ste.simulate(model, tensions(scene, PERIODS), PERIODS * PERIOD, PERIOD)
                found[f"{scene} {load} {preset} tip"] = motion.tip_pose[:, :3, 3]
                found[f"{scene} {load} {preset} q"] = motion.q[::EVERY]
                if load not in NO_POTENTIAL:
                    samples = zip(motion.q[::EVERY], motion.q_dot[::EVERY], strict=True)
                    found[f"{scene} {load} {preset} energy"] = np.array(
                        [model.energy(q, rate) for q, rate in samples]
                    )
    return found


def equilibria() -> Numbers:
    """Tip poses, coordinates and stability of forty equilibria; where all tendons pull alike, some
    of the arm that stands buckle."""
    found = {}
    for name, (scene, changes) in RESTS.items():
        model = arm(scene, changes, "fast")
        generator = np.random.default_rng(3)
        pulls = generator.uniform(0.0, LIMIT[scene], (10, model.tendon_count))
        pulls[5:] = pulls[5:, :1] * 1e-3
        rests = [ste.static_equilibrium(model, pull) for pull in pulls]
        found[f"{name} tip"], found[f"{name} q"] = (
            np.array([getattr(rest, part) for rest in rests]) for part in ("tip_pose", "q")
        )
        found[f"{name} stable"] = np.array(
            [[rest.stable, rest.converged, rest.load] for rest in rests], dtype=float
        )
    return found


def jacobians() -> Numbers:
    """Linearised periods of twelve arms, as controllers and filters have them, and the Jacobian of
    the tip."""
    found = {}
    for scene in ("paper", "three_tendon"):
        for load, changes in LOADS.items():
            simulation = ste.Simulation(arm(scene, changes, "fast"))
            table = tensions(scene, 20)
            simulation.step(table[0], 0.2)
            plan = simulation.rollout(table[10:12], PERIOD)
            found[f"{scene} {load} state"] = plan.by_state
            found[f"{scene} {load} tension"] = plan.by_tension
            found[f"{scene} {load} tip"] = plan.tip_jacobian
    return found


def gradients() -> Numbers:
    """Gradients of a rollout's error by its actions, through the adjoint of the simulation."""
    import torch

    from soft_tendon_env.differentiable import rollout

    found = {}
    for task, scene, load in DIFFERENTIATED:
        options = {
            "scene": loaded(scene, LOADS[load], "fast"),
            "fidelity": "scene",
            "action": "tension",
        }
        envs = gym.make_vec(IDS[task], num_envs=2, threads=1, max_episode_steps=None, **options)
        envs.reset(seed=0)
        steps = 8
        played = []
        actions = torch.tensor(
            np.random.default_rng(1).uniform(-1.0, -0.6, (steps, *envs.action_space.shape)),
            requires_grad=True,
        )

        def policy(_, actions=actions, played=played):
            played.append(None)
            return actions[len(played) - 1]

        run = rollout(envs, policy, steps)
        (
            run.position_error.square().sum()
            + run.backbone_error.square().sum()
            + 1e-3 * run.tip_twist.square().sum()
        ).backward()
        assert actions.grad is not None
        found[f"{task} {scene} {load} gradient"] = actions.grad.numpy()
    return found


def controllers() -> Numbers:
    """Tips under predictive control, and behind an extended Kalman filter with noise, over three
    seeds."""
    found = {}
    for name, noise in (
        ("predictive", {}),
        ("filtered:predictive@fast", {"noise": {"position": 1e-3, "rotation": 0.01}}),
    ):
        options = policy_options(name, "TipPose", {"fidelity": "fast", "randomize": noise})
        env = gym.make(IDS["TipPose"], **options)
        policy = load_policy(name, env)
        for seed in SEEDS:
            observation, _ = env.reset(seed=seed)
            state = None
            tips = []
            for step in range(EPISODE):
                action, state = policy.predict(
                    observation, state, np.array([step == 0]), deterministic=True
                )
                observation, *_, info = env.step(action)
                tips.append([info["position_error"], info["angle_error"]])
            found[f"{name} {seed}"] = np.array(tips)
    return found


PLAIN_REWARDS = {
    "Reach": "sparse",
    "Shape": {"backbone": 1.0, "effort": 0.05, "smoothness": 0.05},
    "TipPose": {"position": 1.0, "angle": 0.5, "effort": 0.05, "smoothness": 0.05},
}
"""Rewards of one scale per error, by task."""


def rewards() -> Numbers:
    """Rewards of five episodes of every task under drawn actions, with everything drawn that
    episodes may draw of the arm."""
    drawn = {
        "stiffness": [0.8, 1.2],
        "damping": [0.5, 2.0],
        "payload": [0.0, 0.02],
        "latency": [0.0, 0.03],
    }
    found = {}
    for task, name in IDS.items():
        if task not in ("TipPose", "Shape", "Reach"):
            continue
        env = gym.make(
            name, fidelity="fast", action="tension", reward=PLAIN_REWARDS[task], randomize=drawn
        )
        for seed in REWARDED:
            env.reset(seed=seed)
            actions = (
                np.random.default_rng(seed)
                .uniform(-1.0, -0.5, (EPISODE, *env.action_space.shape))
                .astype(np.float32)
            )
            found[f"{task} {seed}"] = np.array([env.step(action)[1] for action in actions])
    return found


PARTS: Mapping[str, Callable[..., Numbers]] = {
    "motions": motions,
    "equilibria": equilibria,
    "jacobians": jacobians,
    "gradients": gradients,
    "controllers": controllers,
    "rewards": rewards,
}
