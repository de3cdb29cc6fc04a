"""`soft-tendon demo`: controllers and agents that ship, side by side on the paper's arm."""

from collections.abc import Sequence
from pathlib import Path

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation.comparison import opening_hint
from soft_tendon_env.evaluation.demo import NOTES, TASK, Demonstration, run_demo
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.tools.parallel import check_cluster

STOPPED = "stopped: the same command goes on, with a new recording"
MARKER = "demo"


class Demo(Demonstration):
    """Print the errors of controllers and agents, and write a picture and a recording for the Rerun viewer.

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
        page = Page(settings.write_docs, [MARKER])
        check_cluster(settings.cluster)
        file = recording.RerunFile(writable_folder(out) / "demo.rrd")
        entries = CONTROLLERS[TASK]
        known = {
            name: entries[policy].description if policy in entries else Agent(policy, TASK).training
            for policy, name in settings.policies.items()
        }
    print("\n".join(f"{name:<24} {text}" for name, text in known.items()), "\n")
    tables = run_demo(settings, file, out)
    print(f"{tables}\n\n{NOTES}\n")
    agents = "; ".join(f"{name}: {text}" for policy, name in settings.policies.items() if policy not in entries for text in (known[name],))
    page.write(MARKER, f"Episodes of {settings.seconds:g} s. {agents}.\n\n{tables}\n\n{NOTES}")
    print(opening_hint(out / "demo.rrd"))
