"""Files of a trained agent in its folder: `weights.pt`, the tensors of its network; `statistics.npz`, mean and variance by which it sees
observations, absent where it sees them as they are; `config.json`, which says all else, see `AgentConfig`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, field_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.policies.network import WEIGHTS, algorithm_names
from soft_tendon_env.tools.configuration import Configuration, not_among, read_toml
from soft_tendon_env.tools.files import read_json, shipped_folder
from soft_tendon_env.tools.types import Positive

CONFIG = "config.json"
AGENT = "agent"  # name of the best agent that ships for a task, as agents.toml in the folder of them all has it
SHIPPED = (AGENT, "ppo", "sac", "dagger", "apg")
"""Names of agents that ship: all but "agent" are those of their algorithms."""
ARM = ("scene", "fidelity", "control_period", "tension_limits")  # options that define the arm
INTERFACE = ("observation", "preview", "history", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""
OF_TRAINING = (
    *("arms", "checkpoint_every", "checkpoint_seconds", "engine", "evaluated", "evaluation", "hindsight", "learning_rate", "record"),
    *("runners", "seconds", "seconds_learned", "seed", "start_from", "steps", "threads"),
)
"""Keys of config.json that concern the training alone: an agent acts as it does whatever they say."""

EnvironmentOptions = Annotated[dict[str, Any], AfterValidator(lambda options: Options.parse(options, "options") and options)]
"""Options of an environment as plain tables."""


class AgentConfig(Configuration):
    """Configuration of a trained agent, config.json, as far as it acts; keys of OF_TRAINING are left out. None: not known."""

    algorithm: str  # name of the algorithm that trained it
    hyperparameters: dict[str, Any] = Field(default={})  # of the algorithm; `policy_kwargs` and `use_sde` say what the network is like
    task: str | None = None  # name of the task that it was trained on
    options: EnvironmentOptions = Field(default={})  # of the environment that it was trained in
    layout: dict[str, int] | None = None  # groups of its observation in their order, with their sizes
    strain: dict[str, Any] | None = None  # parametrisation that its arm had, which says what coordinates are; by default that of options
    integral_time: Positive | None = None  # [s] of integral action around it, see integral.py; None: none
    normalise: dict[str, Any] = Field(default={})  # {"observations": true} where it sees observations through its statistics
    steps_done: int | None = Field(default=None, ge=0)  # of its training
    files: dict[str, str] = Field(default={})  # SHA-256 of the files that belong together, by name

    @property
    def policy_arguments(self) -> dict[str, Any]:
        """Arguments of its policy network, with plain values."""
        sde = {"use_sde": True} if self.hyperparameters.get("use_sde") else {}
        return {**(self.hyperparameters.get("policy_kwargs") or {}), **sde}

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """The configuration of a plain table. Raises ConfigurationError, also for keys that it does not know."""
        return super().parse({key: value for key, value in values.items() if key not in OF_TRAINING}, source)

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str) -> str:
        if algorithm not in algorithm_names():
            raise ValueError(f"should be an algorithm: {not_among(algorithm, algorithm_names())}")
        return algorithm


def is_shipped(name: str) -> bool:
    """True for the name of an agent that ships, unless there is a folder or a file of that name."""
    return name in SHIPPED and not Path(name).exists()


def is_agent(name: str) -> bool:
    """True for the name of an agent: of one that ships, or the folder of one."""
    return is_shipped(name) or (Path(name) / WEIGHTS).is_file() or (Path(name) / CONFIG).is_file() and not (Path(name) / "best").is_dir()


def _checked_agent(name: str) -> str:
    if not is_agent(name):
        raise ValueError(f"should be the folder of an agent, or {', '.join(SHIPPED)}, which ship")
    return name


AgentName = Annotated[str, AfterValidator(_checked_agent)]  # see `find_agent`


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
    raise FileNotFoundError(f"the agent {name!r} does not ship for {task}; what does: {', '.join(there) or 'none'}")


def find_agent(name: str, task: str) -> Path:
    """Folder of an agent by its name: one of `SHIPPED` for the task, or a folder. Raises ValueError, FileNotFoundError."""
    folder = trained_folder() / shipped_as(name, task) / task if is_shipped(name) else Path(name)
    if not (folder / WEIGHTS).is_file():
        raise FileNotFoundError(f"{name}: there is no file {folder / WEIGHTS}")
    return folder


def read_config(folder: Path) -> AgentConfig:
    """Configuration of the agent in a folder. Raises ValueError, FileNotFoundError."""
    return AgentConfig.parse(read_json(folder / CONFIG), str(folder / CONFIG))
