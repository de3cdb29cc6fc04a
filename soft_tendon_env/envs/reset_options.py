"""Options of `reset`: the state, goal, target and length with which episodes begin, of one environment or row by row."""

from typing import Any

import numpy as np
from pydantic import Field, InstanceOf, field_validator, model_validator

from soft_tendon_env.envs.options import NamedTarget
from soft_tendon_env.envs.targets.set_points import Hold
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among

MASK = "reset_mask"
"""Key of the rows that a vector environment resets, (rows,) bool; the others go on."""


class ResetOptions(Configuration):
    """Entries of `reset(options={...})` for one episode; None, as without the entry: what the environment's own arguments say.

    Attributes:
        state: `State` in which the arm begins, with its rates, the internal states of effects and its time; of an arm like this episode's.
            Commands before are those of an arm at rest.
        goal: position of the tip to reach, three numbers [m] in the world frame (Reach), or its pose, 4 x 4 (Reach, TipPose).
        target: target of this episode, as the argument `target`.
        episode_steps: steps after which the episode is truncated, where that is sooner than otherwise.
    """

    state: InstanceOf[State] | None = None
    goal: Hold | None = None
    target: NamedTarget | None = None
    episode_steps: int | None = Field(default=None, ge=1)

    @field_validator("goal", mode="before")
    @classmethod
    def _as_hold(cls, goal: Any) -> Any:
        try:
            place = np.asarray(goal, dtype=np.float64)
            return {(3,): lambda: Hold(position=place), (4, 4): lambda: Hold(pose=place)}[place.shape]()
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, ConfigurationError):
                raise
            raise ValueError("should be a position of three numbers [m], or a pose, 4 x 4") from None

    @model_validator(mode="after")
    def _one_of_each(self) -> "ResetOptions":
        if self.goal is not None and self.target is not None:
            raise ConfigurationError([Problem(("goal",), "is given, and target too: give one of the two")])
        return self


def reset_options(options: Any, rows: int | None = None) -> dict[int, ResetOptions]:
    """The options of a reset by row; `rows` of a vector environment, None for one environment, which is row 0.

    A vector environment takes for every key a sequence of one value per row, None for what is usual. Raises ConfigurationError, TypeError
    where they are no table.
    """
    if not isinstance(options, dict | None):
        raise TypeError(f"options should be a dict or None, not {type(options).__name__}")
    allowed = {*ResetOptions.model_fields, *([] if rows is None else [MASK])}
    if unknown := [str(key) for key in options or () if key not in allowed]:
        raise ConfigurationError([Problem((key,), f"is no option of reset: {not_among(key, allowed)}") for key in unknown], "options")
    given = {key: value for key, value in (options or {}).items() if value is not None and key != MASK}
    if rows is None:
        return {0: ResetOptions.parse(given, "options")} if given else {}
    for key, value in given.items():
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != rows:
            raise ConfigurationError([Problem((key,), f"should have one value per row, {rows}, each None for what is usual")], "options")
    tables = [{key: values[row] for key, values in given.items() if values[row] is not None} for row in range(rows)]
    return {row: ResetOptions.parse(table, f"options of row {row}") for row, table in enumerate(tables)} if given else {}
