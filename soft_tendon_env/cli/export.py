"""`soft-tendon export`: a trained agent as one ONNX file, from measurements in SI units to commands, checked against the original."""

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.cli.options import TASK
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import provenance, tables
from soft_tendon_env.evaluation.settings import TaskName
from soft_tendon_env.policies.agent import AgentName, find_agent, load_agent, read_config
from soft_tendon_env.policies.network import WEIGHTS
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.files import digest
from soft_tendon_env.tools.messages import UserError


class Export(Configuration):
    """Write a trained agent as one ONNX file, and compare it with the original on what it observes in an environment."""

    agent: AgentName = Field(description="folder of an agent; or agent, ppo, sac, dagger or apg, of those that ship")
    task: TaskName = Field(default="TipPose", description=TASK)
    options: dict[str, Any] = Field(default={})
    out: str = Field(default="out/agent.onnx", description="file of the agent")


def run(settings: Export) -> None:
    """Export, check, print and write. Raises UserError where the file is another policy than the agent."""
    path = Path(settings.out)
    with mistakes():
        require("export")
        from soft_tendon_env.export.agent import ALLOWED, compare, export_agent

        folder = find_agent(settings.agent, settings.task)
        env = gym.make(IDS[settings.task], **{**read_config(folder).options, **settings.options})
        policy = load_agent(settings.agent, env)
        about = {"name": settings.agent, "weights_sha256": digest(folder / WEIGHTS)}
        model = export_agent(policy, env, {"agent": about, "record": provenance.origin()})
        writable_folder(path.parent)
    path.write_bytes(model.SerializeToString())
    print(f"written: {path} ({path.stat().st_size / 1e6:.2f} MB)\n")
    (observations, difference, of_range), metadata = compare(path, policy, env), json.loads(model.metadata_props[0].value)
    inputs = [(name, str(tuple(of["shape"])), of["unit"]) for name, of in metadata["inputs"].items()]
    print(tables.markdown_table(("input", "shape", "unit"), inputs))
    unit, rate = metadata["command"]["unit"], 1.0 / metadata["control_period_s"]
    print(f"\nOutput: the command [{unit}] of {len(metadata['command']['limits'])} tendons, {rate:g} times a second.")
    print(f"Largest difference of commands on {observations:,} observations: {tables.number(difference)} {unit}.")
    if of_range > ALLOWED:
        raise UserError(f"{path}: commands differ from the original's by more than {ALLOWED:g} of their range")
