"""`soft-tendon demo`: controllers and the agent that ships, side by side on the paper's arm."""

from collections.abc import Sequence
from pathlib import Path

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.demo.demo import ARM, NOTES, SHOWN, TASK, DemoExperiment, Demonstration, describe_policy, name_of
from soft_tendon_env.evaluation.comparison import opening_hint
from soft_tendon_env.evaluation.pages import Page, agent_sources
from soft_tendon_env.policies.trained_by import trained_by
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on, with a new recording"
MARKER = "demo"


class Demo(Demonstration):
    """Print the errors of controllers and an agent, and write a picture and a recording for the Rerun viewer.

    Attributes:
        write_docs: a file in which tables also go between <!-- demo --> and <!-- /demo -->.
        out: folder of the picture, the recording and the episodes that were played.
    """

    write_docs: str | None = None
    out: str = "out"


def run(arguments: Sequence[str]) -> None:
    """Run all policies, print and write."""
    parser = Parser("demo", Demo)
    settings = parser.read(arguments)
    out = Path(settings.out)
    with parser.mistakes():
        require("agents", "pictures", "recording")
        demo = DemoExperiment(settings, out / "cells")
        page = Page(settings.write_docs, [MARKER], ARM["fidelity"], agent_sources([settings.agent]))
        check_cluster(settings.cluster)
        file = recording.RerunFile(writable_folder(out) / "demo.rrd")
    print("\n".join(f"{name_of(policy):<10} {describe_policy(policy)}" for policy in (*SHOWN, settings.agent)), "\n")
    tables = demo.run(file, out / "demo.png")
    print(f"{tables}\n\n{NOTES}\n")
    agent = f"`{name_of(settings.agent)}`: {trained_by(settings.agent, TASK)}"
    page.write(MARKER, f"Episodes of {settings.seconds:g} s. {agent}.\n\n{tables}\n\n{NOTES}")
    print(opening_hint(out / "demo.rrd"))
