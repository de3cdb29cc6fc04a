"""Control of simulated robots that differ from their drawing: with the drawing, with the identified
scene, and with their own.

    python benchmarks/identified_control.py [--robots 10] [--agents] [--workers 1] [--quick]
    [--out out]

Each robot is another hanging arm with three tendons: stiffness and damping within 25 and 50 % of
the drawing's, friction of the tendons, a base that is turned by about 3 degrees and shifted by
about 5 mm, and commands that arrive 10 to 50 ms late, of which the drawing knows nothing. It plays
random steps under `RobotEnv`, whose logs `identify` reads, with 0.5 mm of noise in the tip's
position. Then policies follow poses that the robot can hold. With `--agents` an agent learns on the
drawing, randomised as its configuration says, and one for each robot on the identified scene,
randomised by the intervals.
"""

import argparse
import functools
import tempfile
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture, write_tables
from tqdm import tqdm

from soft_tendon_env import register
from soft_tendon_env.envs.targets import PoseCourse, Target, pose_samples
from soft_tendon_env.evaluation.metrics import root_mean_square
from soft_tendon_env.evaluation.summaries import bootstrap_interval
from soft_tendon_env.identification import Estimate, Marker, MarkerSet, identify
from soft_tendon_env.identification.identify import randomize
from soft_tendon_env.identification.parameters import DELAY, read_parameters
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.robots import RobotEnv, SimulatedRobot, rehearse, run_policy
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene, rod_length, scene_to_dict
from soft_tendon_env.tools.parallel import run_all

DRAWING = load_scene("three_tendon").replace({"effects.gravity.acceleration": [9.81, 0.0, 0.0]})
FRICTION = "effects.tendon_friction.coefficient"
LATE = "effects.actuators.delay"
BEGINS = DRAWING.replace(
    {FRICTION: 0.1, LATE: 0.02}
)  # with usual numbers of what the drawing does not know
TIP = MarkerSet(markers={"tip": Marker(arc_length=rod_length(DRAWING))})
ASKED = ("segments.*.young_modulus", "segments.*.damping", FRICTION, "base", DELAY)
TRUE = "fine"  # fidelity of the robots
BELIEVED = "standard"  # fidelity of the models that are fitted and controlled with
NOISE = 5e-4  # [m]
MOTIONS = 2  # logs
STEPS = 8  # of each, of 0.3 to 0.8 s
LARGEST = 0.6  # share of the tensions' range
STILL = 0.5  # [s] in which a robot that hangs still already is held
SKIP = 1.0  # [s] that do not count
TASK = "TipPose"
CONTROLLER = "filtered:predictive"
MODELS = ("drawing", "identified", "own")
HEADER = (
    "policy",
    "model",
    "position [mm], mean of the robots",
    "95 % interval",
    "worst",
    "of the drawing's",
    "95 % interval",
)


class TipCourse(PoseCourse):
    """The motion of a target's tip alone."""

    def __init__(self, env: gym.Env) -> None:
        self._env = env

    def sample(self, times):
        own = self._env.unwrapped.target_at(times)
        return pose_samples(own.tip_pose, own.tip_twist)


@register("target", "holdable")
class Holdable(Target):
    """Random poses that a robot can hold. scene: its own; seed: of the motion."""

    type: Literal["holdable"] = "holdable"
    scene: dict[str, Any]
    seed: int

    def draw(self, generator, setting):
        env = gym.make(
            f"TendonRod-{TASK}-v0",
            scene=self.scene,
            fidelity=TRUE,
            target={"type": "random", "fraction": 0.4},
        )
        env.reset(seed=self.seed)
        return TipCourse(env)


class Tried(NamedTuple):
    """What came of a robot: what is told of it, errors [m] by policy and model, estimates (k,) and
    their intervals."""

    told: str
    errors: dict[tuple[str, str], float]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each run")
    parser.add_argument(
        "--agents", action="store_true", help="train agents too, a minute for each robot"
    )
    parser.add_argument(
        "--steps", type=int, default=8_000, help="of the teacher, from which an agent learns"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--quick", action="store_true", help="two robots, short runs")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.robots = 2
        arguments.seconds = 1.2
    print(f"{machine()}; {arguments.robots} robots\n")
    arguments.out.mkdir(parents=True, exist_ok=True)
    general = (
        trained(DRAWING, {}, arguments.out / "agents" / "drawing", arguments.steps)
        if arguments.agents
        else None
    )
    each = functools.partial(
        tried, seconds=arguments.seconds, general=general, steps=arguments.steps
    )
    found = run_all(
        each, range(arguments.robots), arguments.workers, "robots", unit="robot", done=tell
    )
    errors = {key: [own.errors[key] for own in found] for key in found[0].errors}
    rows = table_of(errors)
    tables = [
        markdown_table(("parameter", "off at most", "truth in the interval"), recovery(found)),
        markdown_table(HEADER, rows),
    ]
    write_tables(arguments.out / "identified_control.md", "\n\n".join(tables))
    write_csv(arguments.out / "identified_control.csv", HEADER, rows)
    draw(errors, arguments.out / "identified_control.png")


def tell(seed: int, own: Tried) -> None:
    """Says what came of a robot."""
    tqdm.write(f"robot {seed}: {own.told}")


def tried(seed: int, seconds: float, general: Path | None, steps: int) -> Tried:
    """A robot identified, and followed with every policy and model."""
    robot = robot_of(seed)
    started = time.process_time()
    estimate = identified(robot, seed)
    spent = time.process_time() - started
    players = [
        (CONTROLLER, model, CONTROLLER, scene)
        for model, scene in zip(MODELS, (DRAWING, estimate.scene, robot), strict=True)
    ]
    if general is not None:
        scene, table = agent_arm(estimate)
        special = trained(scene, table, general.parents[1] / f"robot_{seed}", steps)
        players += [
            ("agent", "drawing", str(general), DRAWING),
            ("agent", "identified", str(special), scene),
        ]
    errors = {
        (policy, model): error_of(name, robot, scene, seed, seconds)
        for policy, model, name, scene in players
    }
    told = (
        f"{1e3 * estimate.errors[0]:.2f} mm of fit, identified in {spent:.0f} s of CPU;"
        f" {' '.join(estimate.findings)}"
    )
    return Tried(told, errors, estimate.value, estimate.intervals.low, estimate.intervals.high)


def robot_of(seed: int) -> Scene:
    """Scene of a robot, which differs from its drawing."""
    random = np.random.default_rng(seed)
    segment = DRAWING.segments[0]
    changes = {
        "base.rotation": random.normal(scale=3.0 / np.sqrt(3.0), size=3).tolist(),
        "base.position": random.normal(scale=5e-3 / np.sqrt(3.0), size=3).tolist(),
        "segments.0.young_modulus": segment.young_modulus * random.uniform(0.75, 1.25),
        "segments.0.damping": segment.damping * random.uniform(0.5, 1.5),
        FRICTION: random.uniform(0.05, 0.3),
        LATE: random.uniform(0.01, 0.05),
    }
    return DRAWING.replace(changes)


def identified(robot: Scene, seed: int) -> Estimate:
    """The arm as its logs show it."""
    random = np.random.default_rng([seed, 1])
    with tempfile.TemporaryDirectory() as folder:
        logs = [Path(folder) / f"steps{i}.csv" for i in range(MOTIONS)]
        for i, log in enumerate(logs):
            arm = SimulatedRobot(
                i,
                real_time=False,
                scene=robot,
                fidelity=TRUE,
                randomize={"noise": {"position": NOISE}},
            )
            env = gym.make(
                "TendonRod-Reach-v0",
                scene=DRAWING,
                fidelity=BELIEVED,
                action="tension",
                observation=["tip_position"],
            )
            real = RobotEnv(env, arm, settle=STILL, log=log)
            real.reset(seed=0)
            for action in random.uniform(-1.0, 2.0 * LARGEST - 1.0, (STEPS, 3)):
                for _ in range(random.integers(15, 40)):
                    real.step(action)
            real.close()
        return identify(BEGINS, logs, TIP, ASKED, fidelity=BELIEVED, held_out=0, noise=NOISE)


def error_of(policy: str, robot: Scene, scene: Scene, seed: int, seconds: float) -> float:
    """Root mean square error [m] of the tip's position. scene: what is believed of the robot."""
    target = {"type": "holdable", "scene": scene_to_dict(robot), "seed": seed}
    options = {
        **policy_options(policy, TASK, {"scene": scene, "fidelity": BELIEVED}),
        "target": target,
    }
    env = gym.make(f"TendonRod-{TASK}-v0", **options)
    player = load_policy(policy, env)
    rehearse(player, env)
    arm = SimulatedRobot(
        real_time=False, scene=robot, fidelity=TRUE, sensors=options.get("sensors", 0)
    )
    report = run_policy(player, RobotEnv(env, arm, settle=STILL), seconds)
    assert report.finished, report.stop.cause
    return root_mean_square(
        report.errors["position_error"][round(SKIP / env.unwrapped.episodes.period) :]
    )


def agent_arm(estimate: Estimate) -> tuple[Scene, dict[str, Any]]:
    """Scene and randomisation of an agent's training: the delay is drawn in place of the scene's,
    since a teacher knows it only so."""
    at = next(i for i, own in enumerate(estimate.parameters) if own.name == DELAY)
    late = [float(estimate.intervals.low[at]), float(estimate.intervals.high[at])]
    return estimate.scene.replace({"effects.actuators": None}), {
        **randomize(estimate),
        "latency": late,
    }


def trained(scene: Scene, table: dict[str, Any], folder: Path, steps: int) -> Path:
    """Folder of an agent that has learned on a scene, randomised as the configuration says but for
    a table."""
    from soft_tendon_env.learning.config import find_config, read_training
    from soft_tendon_env.learning.train import train

    if not (folder / "last").exists():
        own = [f"steps={steps}", f"evaluation.every={steps}", "evaluation.episodes=8"]
        training = read_training(find_config("dagger_tip_pose"), own)
        usual = training.options["randomize"]
        drawn = {"noise": usual["noise"], **table} if table else usual
        train(
            training.model_copy(
                update={
                    "options": {
                        **training.options,
                        "scene": scene_to_dict(scene),
                        "randomize": drawn,
                    }
                }
            ),
            folder,
        )
    return folder / "last"


def recovery(found: list[Tried]) -> list[tuple[str, str, str]]:
    """How far off the estimates are, and how often their intervals hold the truth."""
    rows = []
    for i, own in enumerate(read_parameters(ASKED, BEGINS, TIP)):
        truth = np.array([truth_of(robot_of(seed), own.name) for seed in range(len(found))])
        value, low, high = (
            np.array([getattr(each, name)[i] for each in found])
            for name in ("value", "low", "high")
        )
        off = (
            f"{100 * np.abs(value / truth - 1.0).max():.1f} %"
            if own.is_factor
            else f"{np.abs(value - truth).max():.2g}"
        )
        rows.append((own.name, off, f"{((low <= truth) & (truth <= high)).sum()} of {len(found)}"))
    return rows


def truth_of(robot: Scene, name: str) -> float:
    """A robot's own number."""
    match name.split("."):
        case ["base", kind, axis]:
            return getattr(robot.base, kind)[int(axis)]
        case ["commands", "delay"]:
            return robot.effects.actuators.delay
        case ["effects", *_]:
            return robot.effects.tendon_friction.coefficient
    return getattr(robot.segments[0], name.rsplit(".", 1)[1])


def table_of(errors: dict[tuple[str, str], list[float]]) -> list[tuple[str, ...]]:
    """A row for each policy and model; the ratio to the drawing is the geometric mean over
    robots."""
    rows = []
    for (policy, model), values in errors.items():
        found = 1e3 * np.array(values)
        ratio = np.log(np.array(values) / errors[policy, "drawing"])
        low, high = bootstrap_interval(found, statistic=np.mean)
        least, most = np.exp(bootstrap_interval(ratio, statistic=np.mean))
        row = policy, model, f"{found.mean():.2f}", f"{low:.2f} to {high:.2f}", f"{found.max():.2f}"
        rows.append(
            (
                *row,
                f"{np.exp(ratio.mean()):.2f}",
                "-" if model == "drawing" else f"{least:.2f} to {most:.2f}",
            )
        )
    return rows


def draw(errors: dict[tuple[str, str], list[float]], path: Path) -> None:
    """A point for each robot, a line for each policy and model."""
    figure, axes = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
    for place, values in enumerate(errors.values()):
        axes.plot(1e3 * np.array(values), np.full(len(values), place), "o", alpha=0.6)
    axes.set_yticks(
        range(len(errors)), [f"{policy}, {model}" for policy, model in errors], fontsize=8
    )
    axes.set(xlabel="position error [mm]", xscale="log")
    axes.invert_yaxis()
    write_picture(figure, path)


if __name__ == "__main__":
    main()
