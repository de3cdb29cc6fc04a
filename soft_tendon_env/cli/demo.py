"""`soft-tendon demo`: controllers and agents that ship, side by side on the paper's arm."""

from pathlib import Path

from pydantic import Field

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.demo.demo import ARM, NOTES, TASK, DemoExperiment, Demonstration, describe_policy
from soft_tendon_env.evaluation.comparison import opening_hint
from soft_tendon_env.evaluation.pages import Page, agent_sources
from soft_tendon_env.policies.agent_files import is_agent
from soft_tendon_env.policies.trained_by import trained_by
from soft_tendon_env.tools.parallel import check_cluster


class Demo(Demonstration):
    """Print the errors of controllers and agents, and write a picture and a recording for the Rerun viewer."""

    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- demo --> and <!-- /demo -->")
    out: str = Field(default="out", description="folder of the picture, the recording and the episodes that were played")


def run(settings: Demo) -> None:
    """Run all policies, print and write."""
    out = Path(settings.out)
    with mistakes():
        require("agents", "pictures", "recording")
        demo = DemoExperiment(settings, out / "cells")
        page = Page(settings.write_docs, ["demo"], ARM["fidelity"], agent_sources([settings.agent]))
        check_cluster(settings.cluster)
        file = recording.RerunFile(writable_folder(out) / "demo.rrd")
    names = settings.policies
    print("\n".join(f"{name:<24} {describe_policy(policy)}" for policy, name in names.items()), "\n")
    tables = demo.run(file, out / "demo.png")
    print(f"{tables}\n\n{NOTES}\n")
    agents = "; ".join(f"{name}: {trained_by(policy, TASK)}" for policy, name in names.items() if is_agent(policy))
    page.write("demo", f"Episodes of {settings.seconds:g} s. {agents}.\n\n{tables}\n\n{NOTES}")
    print(opening_hint(out / "demo.rrd"))
