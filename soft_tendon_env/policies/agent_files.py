"""Files of a trained agent: a folder of three, or the .zip file of Stable-Baselines3.

`weights.pt`: the tensors of the policy network; `statistics.npz`: the running mean and variance by which it sees observations, absent
where it sees them as they are; `config.json`: the configuration that it was trained with, which says all else, see `AgentConfig`.
"""

import re
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from pydantic import AfterValidator, ConfigDict, Field, field_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.policies.network import WEIGHTS, algorithm_names
from soft_tendon_env.policies.normalization import STATISTICS
from soft_tendon_env.tools.configuration import Configuration, not_among, read_toml
from soft_tendon_env.tools.files import configs_folder, read_json, shipped_folder
from soft_tendon_env.tools.types import Positive

CONFIG = "config.json"
AGENT = "agent"
"""Name of the best agent that ships for a task, as agents.toml in the folder of them all has it."""
SHIPPED = (AGENT, "ppo", "sac", "dagger", "apg")
"""Names of agents that ship: all but "agent" are those of their algorithms."""
SHIPPED_NAMES = f"{', '.join(SHIPPED[:-1])} or {SHIPPED[-1]}, which ship"
"""These names in words."""
ARM = ("scene", "fidelity", "control_period", "tension_limits")
"""Options that define the arm."""
INTERFACE = ("observation", "preview", "history", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""


EnvironmentOptions = Annotated[dict[str, Any], AfterValidator(lambda options: Options.parse(options, "options") and options)]
"""Options of an environment as plain tables."""


class AgentConfig(Configuration):
    """Configuration of a trained agent, config.json, as far as it acts.

    Attributes:
        task: name of the task that it was trained on; None: not known.
        algorithm: name of the algorithm that trained it; needed where the weights are in weights.pt.
        hyperparameters: arguments of the algorithm; `policy_kwargs` and `use_sde` say what the network is like.
        options: options of the environment that it was trained in; None: not known.
        layout: groups of its observation in their order, with their sizes; None: not known.
        strain: strain parametrisation that its arm had, which says what coordinates are; None: that of its options today.
        integral_time: [s] of integral action around it, see integral.py; None: none.
        normalise: {"observations": false} where it sees observations as they are.
        steps_done: of its training; None: not known.
        files: SHA-256 of the files that belong together, by name.
    """

    model_config = ConfigDict(extra="ignore")

    task: str | None = None
    algorithm: str | None = None
    hyperparameters: dict[str, Any] = Field(default={})
    options: EnvironmentOptions | None = None
    layout: dict[str, int] | None = None
    strain: dict[str, Any] | None = None
    integral_time: Positive | None = None
    normalise: dict[str, Any] = Field(default={})
    steps_done: int | None = Field(default=None, ge=0)
    files: dict[str, str] = Field(default={})

    @property
    def policy_arguments(self) -> dict[str, Any]:
        """Arguments of its policy network, with plain values."""
        sde = {"use_sde": True} if self.hyperparameters.get("use_sde") else {}
        return {**(self.hyperparameters.get("policy_kwargs") or {}), **sde}

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str | None) -> str | None:
        if algorithm is not None and algorithm not in algorithm_names():
            raise ValueError(f"should be an algorithm: {not_among(algorithm, algorithm_names())}")
        return algorithm


class AgentFiles(NamedTuple):
    """Paths of an agent: its folder or .zip file, the folder of its other files, and these."""

    path: Path
    folder: Path
    weights: Path
    config: Path
    statistics: Path

    @classmethod
    def of(cls, path: Path) -> Self:
        """The files of a folder, or of a .zip file with others beside it."""
        is_zip = path.suffix == ".zip"
        folder = path.parent if is_zip else path
        return cls(path, folder, path if is_zip else path / WEIGHTS, folder / CONFIG, folder / STATISTICS)

    @property
    def is_zip(self) -> bool:
        return self.path == self.weights


def is_shipped(name: str) -> bool:
    """True for the name of an agent that ships, unless there is a folder or a file of that name."""
    return name in SHIPPED and not Path(name).exists()


def is_run(folder: Path) -> bool:
    """True for the folder of a training, with its best agent in it."""
    return (folder / "best").is_dir() and not (folder / WEIGHTS).is_file()


def is_agent(name: str) -> bool:
    """True for the name of an agent: of one that ships, the folder of one, or a .zip file."""
    folder = Path(name)
    return is_shipped(name) or name.endswith(".zip") or any((folder / file).is_file() for file in (WEIGHTS, CONFIG)) and not is_run(folder)


def _checked_agent(name: str) -> str:
    if not is_agent(name):
        raise ValueError(f"should be the folder or the .zip file of an agent, or {SHIPPED_NAMES}")
    return name


AgentName = Annotated[str, AfterValidator(_checked_agent)]
"""Name of an agent, see `find_agent`."""


def trained_folder() -> Path:
    """Folder of the agents that ship, NAME/TASK."""
    return shipped_folder("policies/trained", "agents/trained")


def shipped_for(task: str) -> tuple[str, ...]:
    """Names of the agents that ship for a task, but "agent"."""
    return tuple(name for name in SHIPPED if (trained_folder() / name / task / WEIGHTS).is_file())


def shipped_as(name: str, task: str) -> str:
    """Name by its algorithm of an agent that ships for a task: what "agent" stands for. Raises ValueError, FileNotFoundError for none."""
    found = read_toml(trained_folder() / "agents.toml").get(task) if name == AGENT else name
    if found in (there := shipped_for(task)):
        return str(found)
    training = f"{name}_{re.sub('(?<!^)(?=[A-Z])', '_', task).lower()}"
    command = f"; `soft-tendon train {training}` trains one" if (configs_folder() / f"{training}.toml").is_file() else ""
    raise FileNotFoundError(f"the agent {name!r} does not ship for {task}; what does: {', '.join(there) or 'none'}{command}")


def find_agent(name: str, task: str) -> AgentFiles:
    """Files of an agent by its name: one of `SHIPPED` for the task, a folder or a .zip file. Raises ValueError, FileNotFoundError."""
    files = AgentFiles.of(trained_folder() / shipped_as(name, task) / task if is_shipped(name) else Path(name))
    if not files.weights.is_file():
        raise FileNotFoundError(f"{name}: there is no file {files.weights}")
    return files


def read_config(files: AgentFiles) -> AgentConfig:
    """Configuration of an agent, an empty one for a .zip file that has none beside it. Raises ValueError, FileNotFoundError."""
    if files.is_zip and not files.config.exists():
        return AgentConfig()
    return AgentConfig.parse(read_json(files.config), str(files.config))
