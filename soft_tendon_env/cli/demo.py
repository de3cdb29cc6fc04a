"""`soft-tendon demo`: controllers and agents that ship, side by side on the paper's arm."""

from pathlib import Path

from pydantic import Field

from soft_tendon_env import recording
from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import demo
from soft_tendon_env.evaluation.comparison import opening_hint
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.policies.names import Agent
from soft_tendon_env.tools.parallel import check_cluster


class Demo(demo.Demonstration):
    """Print the errors of controllers and agents, and write a picture and a recording for the Rerun viewer."""

    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- demo --> and <!-- /demo -->")
    out: str = Field(default="out", description="folder of the picture, the recording and the episodes that were played")


def run_demo(settings: Demo) -> None:
    """Run all policies, print and write."""
    out = Path(settings.out)
    with mistakes():
        require("agents", "pictures", "recording")
        page = Page(settings.write_docs, ["demo"])
        check_cluster(settings.cluster)
        file = recording.RerunFile(writable_folder(out) / "demo.rrd")
        known = CONTROLLERS[demo.TASK]
        agents = {name: Agent(policy, demo.TASK).training for policy, name in settings.policies.items() if policy not in known}
    described = {name: agents.get(name) or known[policy].description for policy, name in settings.policies.items()}
    print("\n".join(f"{name:<24} {text}" for name, text in described.items()), "\n")
    tables = demo.run_demo(settings, file, out)
    print(f"{tables}\n\n{demo.NOTES}\n")
    trained = "; ".join(f"{name}: {text}" for name, text in agents.items())
    page.write("demo", f"Episodes of {settings.seconds:g} s. {trained}.\n\n{tables}\n\n{demo.NOTES}")
    print(opening_hint(out / "demo.rrd"))
