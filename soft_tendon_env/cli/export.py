"""`soft-tendon export`: a trained agent as one ONNX file, from measurements in SI units to commands, checked against the original."""

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium as gym
from pydantic import Field

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.provenance import machine, origin
from soft_tendon_env.evaluation.settings import TaskName
from soft_tendon_env.evaluation.tables import markdown_table, number
from soft_tendon_env.policies.agent import load_agent
from soft_tendon_env.policies.agent_files import AgentName, find_agent, read_config
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.files import digest
from soft_tendon_env.tools.messages import UserError

STOPPED = "stopped: nothing was written, or it was not checked"


class Export(Configuration):
    """Write a trained agent as one ONNX file, and compare it with the original.

    Attributes:
        agent: the folder or the .zip file of an agent; or agent, ppo, sac, dagger or apg, of those that ship for the task.
        task: name of the task: TipPose, Shape, Reach, or one that was registered.
        options: environment's options where the agent's config.json does not say them, see `soft_tendon_env.envs.Options`; what it observes
            there is recorded for the check.
        out: file of the agent.
    """

    agent: AgentName
    task: TaskName = "TipPose"
    options: dict[str, Any] = Field(default={})
    out: str = "out/agent.onnx"


def run(arguments: Sequence[str]) -> None:
    """Export, check, print and write."""
    parser = Parser("export", Export)
    settings = parser.read(arguments)
    path = Path(settings.out)
    with parser.mistakes():
        require("export")
        from soft_tendon_env.export import export_agent

        if path.suffix != ".onnx":
            raise ValueError(f"--out is {path}: it should be the path of an .onnx file, such as {path.stem}.onnx")
        files = find_agent(settings.agent, settings.task)
        env = gym.make(IDS[settings.task], **{**(read_config(files).options or {}), **settings.options})
        policy = load_agent(settings.agent, env)
        model = export_agent(policy, env, {"agent": {"name": settings.agent, "weights_sha256": digest(files.weights)}, "record": origin()})
        writable_folder(path.parent)
    path.write_bytes(model.SerializeToString())
    print(f"written: {path} ({path.stat().st_size / 1e6:.2f} MB)\n")
    compare_with_original(policy, env, path)


def compare_with_original(policy: Policy, env: gym.Env[Any, Any], path: Path) -> None:
    """Table of what the file takes, and of its difference from the original. Raises UserError where it is another policy."""
    from soft_tendon_env.export.check import ALLOWED, Agent, compare, record

    recorded, agent = record(policy, env), Agent(path)
    found, metadata = compare(agent, recorded), agent.metadata
    inputs = [(name, str(tuple(of["shape"])), of["unit"], of["description"]) for name, of in metadata["inputs"].items()]
    print(markdown_table(("input", "shape", "unit", "description"), inputs))
    unit, rate = metadata["command"]["unit"], 1.0 / metadata["control_period_s"]
    print(f"\nOutput: the command [{unit}] of {len(metadata['command']['least'])} tendons, {rate:g} times a second.")
    print(f"Largest difference of commands on {len(recorded):,} recorded observations, and median time of an action; {machine()}\n")
    header = ("runner", f"difference [{unit}]", "of the range", "of a largest action", "time [ms]")
    exported = ("onnxruntime", *map(number, (found.command, found.of_range, found.of_action, 1e3 * found.seconds)))
    original = ("original", "", "", "", number(1e3 * median(period.seconds for period in recorded)))
    print(markdown_table(header, [exported, original]))
    if found.of_range > ALLOWED:
        raise UserError(f"{path}: commands differ from the original's by more than {ALLOWED:g} of their range")
