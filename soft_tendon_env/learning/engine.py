"""The engine that trains, as commands have it."""

from typing import Literal

from pydantic import Field, model_validator

from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem

RUNNERS = 2


class Engine(Configuration):
    """What trains.

    Attributes:
        engine: "sb3", Stable-Baselines3 in one process, or "rllib", RLlib with environments in processes of their own (PPO alone, see
            docs/agents.md).
        runners: of RLlib, processes with environments, each with an equal part of the arms; 0: the process that learns has all
            (default: 2).
    """

    engine: Literal["sb3", "rllib"] = "sb3"
    runners: int | None = Field(default=None, ge=0, le=10_000)

    @model_validator(mode="after")
    def _has_runners(self) -> "Engine":
        if self.runners is not None and self.engine != "rllib":
            raise ConfigurationError([Problem(("runners",), "is for --engine rllib")])
        return self

    @property
    def all_runners(self) -> int:
        """How many there are; none with Stable-Baselines3."""
        return 0 if self.engine == "sb3" else RUNNERS if self.runners is None else self.runners
