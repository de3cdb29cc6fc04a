"""`soft-tendon export`: a trained agent as one ONNX file, or the arm of a scene as a chain in
MuJoCo, checked against the original."""

import json
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import numpy as np
from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.cli.options import TASK, EnvironmentArguments
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import provenance, tables
from soft_tendon_env.evaluation.settings import TaskName
from soft_tendon_env.policies.agent import find_agent, is_agent, load_agent, read_config, shipped
from soft_tendon_env.policies.weights import WEIGHTS
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.tools.files import digest
from soft_tendon_env.tools.messages import UserError, describe

WHAT = (
    "folder of an agent; or agent, ppo, sac, dagger or apg, of those that ship; with --mjcf a"
    " shipped scene's name, or a TOML file"
)

TIP_POSE = "TipPose"
"""Task of an agent, by default."""
LINKS = 20
"""Links of a chain, by default: twice as many divide the distance to the rod's tip by four."""


class Export(EnvironmentArguments):
    """Write a trained agent as one ONNX file, or with --mjcf the arm of a scene for MuJoCo, and
    compare it with the original."""

    agent_or_scene: Positional[str] = Field(description=WHAT)
    task: TaskName | None = Field(default=None, description=f"{TASK}; by default {TIP_POSE}")
    mjcf: bool = Field(
        default=False, description="write the arm of a scene as a chain of rigid links in MJCF"
    )
    links: int | None = Field(
        default=None, ge=2, le=200, description=f"links of the chain, by default {LINKS}"
    )
    out: str | None = Field(
        default=None, description="file; by default out/agent.onnx, or out/SCENE.xml"
    )


def run(settings: Export) -> None:
    """Export, check, print and write. Raises UserError where the file is another policy than the
    agent."""
    with mistakes():
        _check_options(settings)
    if settings.mjcf:
        export_arm(settings)
    else:
        export_policy(settings)


def _check_options(settings: Export) -> None:
    """Raises ValueError for options of the other kind of export, and for what is no agent."""
    name = settings.agent_or_scene
    wrong = []
    if settings.mjcf and settings.task is not None:
        wrong.append("--task")
    if settings.mjcf and settings.options:
        wrong.append("--scene, --fidelity, --target or --set")
    if wrong:
        raise ValueError(f"{' and '.join(wrong)} cannot be given with --mjcf")
    if not settings.mjcf and settings.links is not None:
        raise ValueError("--links cannot be given without --mjcf")
    if not settings.mjcf and not is_agent(name):
        raise ValueError(
            f"{name} should be the folder of an agent, or {', '.join(shipped())}, which ship;"
            " for a scene give --mjcf"
        )


def export_arm(settings: Export) -> None:
    """Write the arm for MuJoCo, and compare the tips where that is installed."""
    from soft_tendon_env.export.mujoco_chain import compare, exportable, mujoco_chain

    with mistakes():
        scene = load_scene(settings.agent_or_scene)
        name = Path(settings.agent_or_scene).stem
        path = Path(settings.out or f"out/{name}.xml")
        writable_folder(path.parent)
    if settings.links is None:
        links = LINKS
    else:
        links = settings.links
    mujoco_chain(scene, links).write(path, encoding="utf-8")
    names = exportable(scene)[1]
    left_out = ", ".join(names) or "nothing"
    print(f"written: {path} ({links} links)\nleft out: {left_out}\n")
    if find_spec("mujoco") is None:
        print('to compare the tips, MuJoCo must be there: pip install "soft_tendon_env[mujoco]"')
        return
    try:
        rest, motion, seconds = compare(path, scene)
    # of MuJoCo, whose least inertia is greater than that of some thin rods; or there is no rest
    except ValueError as error:
        raise UserError(f"{path} cannot be compared: {describe(error)}") from error
    # NaN where one of the two has no rest.
    known = rest[np.isfinite(rest)]
    tensions = f"at rest under {known.size} of {rest.size} sets of tensions"
    distances = {
        f"{tensions}, mean": known.mean() if known.size else np.nan,
        f"{tensions}, largest": known.max() if known.size else np.nan,
        f"in {seconds:g} s after a step of tensions, largest": motion,
    }
    rows = []
    for name, distance in distances.items():
        percent = 100.0 * distance / rod_length(scene)
        millimetres = tables.number(1e3 * distance)
        share = tables.number(percent, 2)
        rows.append((name, millimetres, share))
    header = ("distance of the tip in MuJoCo from the rod's", "[mm]", "[% of the length]")
    print(tables.markdown_table(header, rows))


def export_policy(settings: Export) -> None:
    """Write the agent as ONNX and compare it with the original. Raises UserError where the file is
    another policy."""
    name = settings.agent_or_scene
    if settings.task is None:
        task = TIP_POSE
    else:
        task = settings.task
    path = Path(settings.out or "out/agent.onnx")
    with mistakes():
        require("export")
        from soft_tendon_env.export.agent import ALLOWED, compare, export_agent

        folder = find_agent(name, task)
        options = {**read_config(folder).options, **settings.options}
        env = gym.make(IDS[task], **options)
        policy = load_agent(name, env)
        about = {"name": name, "weights_sha256": digest(folder / WEIGHTS)}
        model = export_agent(policy, env, {"agent": about, "record": provenance.origin()})
        writable_folder(path.parent)
    path.write_bytes(model.SerializeToString())
    megabytes = path.stat().st_size / 1e6
    print(f"written: {path} ({megabytes:.2f} MB)\n")
    observations, difference, of_range = compare(path, policy, env)
    metadata = json.loads(model.metadata_props[0].value)
    inputs = []
    for group, properties in metadata["inputs"].items():
        shape = str(tuple(properties["shape"]))
        inputs.append((group, shape, properties["unit"]))
    print(tables.markdown_table(("input", "shape", "unit"), inputs))

    unit = metadata["command"]["unit"]
    tendon_count = len(metadata["command"]["limits"])
    rate = 1.0 / metadata["control_period_s"]
    print(f"\nOutput: the command [{unit}] of {tendon_count} tendons, {rate:g} times a second.")
    print(
        f"Largest difference of commands on {observations:,} observations:"
        f" {tables.number(difference)} {unit}."
    )
    if of_range > ALLOWED:
        raise UserError(
            f"{path}: commands differ from the original's by more than {ALLOWED:g} of their range"
        )
