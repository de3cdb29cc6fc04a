"""Files of a trained agent: a folder of three, or the .zip file of Stable-Baselines3.

`weights.pt`: the tensors of the policy network; `statistics.npz`: the running mean and variance by which it sees observations, absent
where it sees them as they are; `config.json`: the configuration that it was trained with, which says all else, see `AgentConfig`.
"""

import re
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.policies.network import WEIGHTS, algorithm_names
from soft_tendon_env.policies.normalization import STATISTICS
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, read_toml, shown
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
OF_TRAINING = (
    "steps",
    "seconds",
    "seed",
    "threads",
    "learning_rate",
    "hindsight",
    "evaluation",
    "checkpoint_every",
    "checkpoint_seconds",
    "record",
    "evaluated",
    "seconds_learned",
    "engine",
    "runners",
)
"""Keys of config.json that say how an agent was trained, and nothing of how it acts."""
TARGETS_OF_TRAINING = ("bank", "pool")
"""Keys of its `options.target` that say of how many motions a training had its targets, and nothing of how the agent acts."""
UNKNOWN = re.compile("valid: |unknown")


def _checked_options(options: dict[str, Any]) -> dict[str, Any]:
    Options.parse(options, "options")
    return options


EnvironmentOptions = Annotated[dict[str, Any], AfterValidator(_checked_options)]
"""Options of an environment as plain tables."""


class AgentConfig(Configuration):
    """Configuration of a trained agent, config.json, as far as it acts: what is OF_TRAINING is left out, other keys refused unless empty.

    Attributes:
        task: name of the task that it was trained on; None: not known.
        algorithm: name of the algorithm that trained it; needed where the weights are in weights.pt.
        hyperparameters: arguments of the algorithm; `policy_kwargs` and `use_sde` say what the network is like.
        options: options of the environment that it was trained in; None: not known.
        layout: groups of its observation in their order, with their sizes; None: not known.
        strain: strain parametrisation that its arm had, which says what coordinates are; None: that of its options today.
        integral_time: [s] of integral action around it, see integral.py; None: none.
        normalise: {"observations": false} where it sees observations as they are.
        start_from, arms, steps_done: course of its training, see trained_by.py; None: none, or not known.
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
    start_from: str | None = None
    arms: int | None = None
    steps_done: int | None = Field(default=None, ge=0)
    files: dict[str, str] = Field(default={})

    @model_validator(mode="before")
    @classmethod
    def _says_nothing_else(cls, values: dict[str, Any]) -> dict[str, Any]:
        text = "it is an unknown key, and should be taken out where it changes nothing in how the agent acts"
        if other := [key for key, value in values.items() if value and key not in (*cls.model_fields, *OF_TRAINING)]:
            raise ConfigurationError([Problem((key,), f"is {shown(values[key])}: {text}") for key in other])
        return values

    @field_validator("options", mode="before")
    @classmethod
    def _of_any_targets(cls, options: Any) -> Any:
        target = options.get("target") if isinstance(options, dict) else None
        if not isinstance(target, dict):
            return options
        return {**options, "target": {key: value for key, value in target.items() if key not in TARGETS_OF_TRAINING}}

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str | None) -> str | None:
        if algorithm is not None and algorithm not in algorithm_names():
            raise ValueError(f"should be an algorithm: {not_among(algorithm, algorithm_names())}")
        return algorithm


class AgentFiles(NamedTuple):
    """Paths of an agent: its folder or .zip file, and the algorithm that was named with it (None: not named)."""

    path: Path
    algorithm: str | None = None

    @property
    def folder(self) -> Path:
        return self.path.parent if self.is_zip else self.path

    @property
    def is_zip(self) -> bool:
        return self.path.suffix == ".zip"

    @property
    def weights(self) -> Path:
        return self.path if self.is_zip else self.path / WEIGHTS

    @property
    def config(self) -> Path:
        return self.folder / CONFIG

    @property
    def statistics(self) -> Path:
        return self.folder / STATISTICS


def is_shipped(name: str) -> bool:
    """True for the name of an agent that ships, unless there is a folder or a file of that name."""
    return name in SHIPPED and not Path(name).exists()


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


def is_run(folder: Path) -> bool:
    """True for the folder of a training, with its best agent in it."""
    return (folder / "best").is_dir() and not (folder / WEIGHTS).is_file()


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
    """Files of an agent by its name: one of `SHIPPED` for the task, a folder, "path.zip" or "ALGORITHM:path.zip".

    Raises ValueError, FileNotFoundError.
    """
    if is_shipped(name):
        return AgentFiles(trained_folder() / shipped_as(name, task) / task)
    before, colon, after = name.partition(":")
    files = AgentFiles(Path(after), before) if colon and not Path(name).exists() else AgentFiles(Path(name))
    if files.algorithm is not None and files.algorithm not in algorithm_names():
        raise ValueError(f"{name}: the algorithm is {files.algorithm!r}; valid: {', '.join(algorithm_names())}")
    if not files.weights.is_file():
        beside = f": the agent is its folder, {files.folder}" if files.is_zip and (files.folder / WEIGHTS).is_file() else ""
        if not files.is_zip and (files.folder / "model.zip").is_file():
            beside = f": the agent is its file, {files.folder / 'model.zip'}"
        raise FileNotFoundError(f"{name}: there is no file {files.weights}{beside}")
    return files


def read_config(files: AgentFiles) -> AgentConfig:
    """Configuration of an agent, an empty one for a .zip file that has none beside it. Raises ValueError, FileNotFoundError."""
    if files.is_zip and not files.config.exists():
        return AgentConfig()
    try:
        return AgentConfig.parse(read_json(files.config), str(files.config))
    except ConfigurationError as error:
        raise with_import(error, str(files.config)) from error


def with_import(error: ConfigurationError, source: str) -> ConfigurationError:
    """The error of an agent's configuration, which says of names that are not known what makes those of a user's own known."""
    text = "; if a module of your own registers it, --import MODULE is missing before the command, or `import MODULE` in Python"
    return ConfigurationError([Problem(key, said + text * bool(UNKNOWN.search(said))) for key, said in error.problems], source)
