"""`soft-tendon demo`: controllers and agents that ship, side by side on the paper's arm."""

from pathlib import Path

from pydantic import Field

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import comparison, demo
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.evaluation.settings import Workers
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.tools.parallel import check_cluster
from soft_tendon_env.tools.types import Positive


class Demo(Workers):
    """Print the errors of controllers and agents, and write a picture and a recording for the Rerun viewer."""

    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1, le=len(EVALUATION_SEEDS), description="number of random targets")
    seconds: Positive = Field(default=10.0, description="length of an episode [s]")
    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- demo --> and <!-- /demo -->")
    out: str = Field(default="out", description="folder of the picture, the recording and the episodes that were played")


def run(settings: Demo) -> None:
    """Run all policies, print and write."""
    out = Path(settings.out)
    with mistakes():
        require("agents", "pictures", "recording")
        page = Page(settings.write_docs, ["demo"])
        check_cluster(settings.cluster)
        file = recording.RerunFile(writable_folder(out) / "demo.rrd")
        known = CONTROLLERS[demo.TASK]
        configs = {name: Agent(policy, demo.TASK).config for policy, name in demo.SHOWN.items() if policy not in known}
        agents = {name: f"{config.algorithm}, {config.steps_done:,} steps" for name, config in configs.items()}
    described = {name: agents.get(name) or known[policy].description for policy, name in demo.SHOWN.items()}
    print("\n".join(f"{name:<24} {text}" for name, text in described.items()), "\n")
    shown = demo.run_demo(settings.episodes, settings.seconds, settings, file, out)
    print(f"{shown}\n\n{demo.NOTES}\n")
    trained = "; ".join(f"{name}: {text}" for name, text in agents.items())
    page.write("demo", f"Episodes of {settings.seconds:g} s. {trained}.\n\n{shown}\n\n{demo.NOTES}")
    print(comparison.opening_hint(out / "demo.rrd"))
