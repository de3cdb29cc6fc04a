"""Monitor of a training, whatever its engine: learning curve, best and last agent in the training's folder, and the bar."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.learning.checkpoints import Evaluations, learned_before
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.validation import Validation, best_quality, curve_row, format_row, quality
from soft_tendon_env.policies.agent_files import CONFIG
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.messages import UserError

CHECKPOINT_SHARE = 0.05
"""Greatest share of a training's time that checkpoints which are due by time take."""
Watch = Callable[[Mapping[str, float]], None]
"""Function that gets every row of a learning curve as it is measured."""


class TrainingMonitor(ABC):
    """Validations and checkpoints of a training while it learns. An engine says what its agent is, and when nothing is half done.

    checkpoint: where it goes on; None: at the beginning. Raises ValueError, OSError.
    """

    watch: Watch | None = None
    _bar: Any = None

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        done, self._before = (0, 0.0) if checkpoint is None else learned_before(checkpoint)
        self.training, self.folder, self.began = training, folder, done
        self.curve = Evaluations(folder / "evaluations.csv", done)
        self._best = best_quality(folder)
        self.validation = Validation(training)
        self._untimed = 0.0

    @abstractmethod
    def steps_done(self) -> int:
        """Steps of all arms together."""

    @abstractmethod
    def agent(self) -> Policy:
        """The agent as it is now."""

    @abstractmethod
    def network(self) -> torch.nn.Module:
        """All weights of the agent."""

    @abstractmethod
    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        """Replace a checkpoint, see `checkpoints`."""

    @abstractmethod
    def log(self, row: Mapping[str, float]) -> None:
        """Write a row of the learning curve into the engine's own log, if it has one."""

    def begin(self, config: dict[str, Any]) -> None:
        """Begin before the first step of this process. config: the record for config.json."""
        self._started = time.perf_counter()
        self._config = config
        write_json(self.folder / CONFIG, self._config, say=False)
        done = self.steps_done()
        self._bar = tqdm(total=self.training.steps, initial=done, unit="step", unit_scale=True, desc=self.folder.name, smoothing=0.05)
        self._evaluated, self._checkpointed = done // self.training.evaluation.every, done // self.training.checkpoint_every
        if not self.curve.rows:
            self.untimed(self.evaluate)  # compiles, if need be
        self._due = time.perf_counter() + self.training.checkpoint_seconds

    def between_rollouts(self) -> None:
        """Evaluate and keep what is due, when nothing is half done."""
        done = self.steps_done()
        self._bar.update(done - self._bar.n)
        if (now := done // self.training.evaluation.every) > self._evaluated:
            self._evaluated = now
            self.untimed(self.evaluate)
        now = done // self.training.checkpoint_every
        if now > self._checkpointed or time.perf_counter() >= self._due:
            self._checkpointed = now
            self.untimed(self.checkpoint)

    def end(self) -> None:
        """End after the last step."""
        self._bar.update(self.steps_done() - self._bar.n)
        if self.curve.rows[-1]["steps"] < self.steps_done():
            self.untimed(self.evaluate)
        self.untimed(self.checkpoint)

    def close(self) -> None:
        """Close the bar, after the end or an error."""
        if self._bar is not None:
            self._bar.close()

    def untimed(self, work: Callable[[], None]) -> None:
        """Do work whose time does not count as learning."""
        started = time.perf_counter()
        work()
        self._untimed += time.perf_counter() - started

    def evaluate(self) -> None:
        """Add a row to the learning curve, and keep the agent if it is the best so far."""
        self.check()
        row = curve_row(self.steps_done(), self._seconds(), self.validation.summary(self.agent()))
        self.curve.append(row)
        self.log(row)
        self._bar.set_postfix_str(format_row(row))
        if self._best is None or quality(row) < self._best:
            self._best = quality(row)
            self.save(self.folder / "best", self._config | {"steps_done": self.steps_done(), "evaluated": row}, resumable=False)
        if self.watch is not None:
            self.watch(row)

    def checkpoint(self) -> None:
        """Keep what is needed to go on from here."""
        self.check()
        started = time.perf_counter()
        self._config |= {"steps_done": self.steps_done(), "seconds_learned": self._seconds()}
        self.save(self.folder / "last", self._config, resumable=True)
        ended = time.perf_counter()
        self._due = ended + max(self.training.checkpoint_seconds, (ended - started) / CHECKPOINT_SHARE)

    def check(self) -> None:
        """Raises UserError where weights are not finite: such an agent replaces no checkpoint."""
        if not all(bool(torch.isfinite(weights).all()) for weights in self.network().parameters()):
            text = f"after {self.steps_done()} steps the agent's weights are no longer finite: a smaller learning_rate may help"
            raise UserError(f"{text}. The last checkpoint in {self.folder} is from before")

    def report(self, note: str = "") -> None:
        """Print the speed of learning in this process. note: on what it ran."""
        steps = self.steps_done() - self.began
        learned = time.perf_counter() - self._started - self._untimed
        speed = f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s{note}"
        beside = f"{self._untimed:.0f} s of evaluations and checkpoints beside"
        print(f"{speed}; {beside}. At the end: {format_row(self.curve.rows[-1])}")

    def _seconds(self) -> float:
        return self._before + time.perf_counter() - self._started - self._untimed
