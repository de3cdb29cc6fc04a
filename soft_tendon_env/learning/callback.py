"""Upkeep of a training's folder (evaluations, checkpoints, the bar), and the callback of Stable-Baselines3 that does it there."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.error_units import error_unit
from soft_tendon_env.evaluation import VALIDATION_SEEDS, Summary, evaluate_rows, summarise
from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.learning.checkpoints import Evaluations, config_record, find_checkpoint, save_checkpoint, statistics_of
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.training_env import Timed, freeze_observations, make_training_env, unwrapped
from soft_tendon_env.policies.agent import NetworkPolicy, acting_policy
from soft_tendon_env.policies.agent_files import CONFIG
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.residual import Residual
from soft_tendon_env.tools.files import read_json
from soft_tendon_env.tools.messages import UserError

CHECKPOINT_SHARE = 0.05
"""Of a training's time, that checkpoints which are due by time may take."""


class Times(NamedTuple):
    """Seconds of a training: in all, in steps of the environment, in evaluations and checkpoints."""

    all: float
    environment: float
    beside: float


class Examination:
    """The fixed validation episodes, side by side."""

    def __init__(self, training: Training) -> None:
        self._seeds, self._skip = VALIDATION_SEEDS[: training.evaluation.episodes], training.evaluation.skip
        steps = training.episode_steps(training.options)
        size: dict[str, Any] = {"num_envs": len(self._seeds), "max_episode_steps": steps, "threads": training.threads}
        self._envs = gym.make_vec(IDS[training.task], **size, **training.options)
        self._residual = None if training.residual is None else Residual(training.residual, self._envs)
        self._integral_time = training.integral_time

    def of_agent(self, agent: Policy) -> Summary:
        """How it does now."""
        policy = acting_policy(agent, self._envs, self._residual, self._integral_time)
        return summarise(evaluate_rows(policy, self._envs, self._seeds, self._skip))

    @property
    def envs(self) -> gym.vector.VectorEnv[Any, Any, Any]:
        """What it acts in."""
        return self._envs


def evaluation_row(steps: int, seconds: float, summary: Summary) -> dict[str, float]:
    """For the learning curve, in SI units."""
    row = {"steps": steps, "seconds": seconds, "return": summary.mean_return, "diverged": summary.diverged}
    if summary.reached is not None:
        row["reached"] = summary.reached
    for name, error in summary.errors.items():
        row |= {f"{name}_rms": error.rms, f"{name}_p95": error.percentile_95}
    return row


def quality(row: Mapping[str, Any]) -> tuple[float, ...]:
    """What makes one evaluation better than another, the smaller the better: no divergence, goals reached, the task's first error."""
    error = next(value for name, value in row.items() if name.endswith("_rms"))
    return row["diverged"], -row.get("reached", 0.0), np.inf if error is None or np.isnan(error) else error


def best_quality(folder: Path) -> tuple[float, ...] | None:
    """Of the best agent in a training's folder, which may be further than the last checkpoint; None without one. Raises ValueError."""
    best = find_checkpoint(folder / "best")
    if best is None:
        return None
    try:
        row = read_json(best / CONFIG).get("evaluated")
        if not isinstance(row, dict) or "diverged" not in row or not any(name.endswith("_rms") for name in row):
            raise ValueError(f"{best / CONFIG} has no evaluation of the agent")
    except (ValueError, OSError) as error:
        raise ValueError(f"{error}: take {best} away, and the best is chosen anew from here on") from error
    return quality(row)


def finite(network: torch.nn.Module) -> bool:
    """Whether all weights of an agent are numbers."""
    return all(bool(torch.isfinite(weights).all()) for weights in network.parameters())


def free_actor(model: Any, free: bool) -> None:
    """Let the actor of an actor-critic policy learn, or the critic alone."""
    policy: Any = model.policy
    for weights in (*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters(), policy.log_std):
        weights.requires_grad = free


Watch = Callable[[Mapping[str, float]], None]
"""Gets every row of a learning curve as it is measured."""


class Upkeep:
    """Upkeep of a training's folder while it learns: learning curve, best and last agent, the bar. An engine adds what its agent is."""

    watch: Watch | None = None

    def __init__(self, training: Training, folder: Path, curve: Evaluations, before: float) -> None:
        """before: seconds that were learned before this process. Raises ValueError."""
        self.training, self.folder, self.curve, self._before = training, folder, curve, before
        self._best = best_quality(folder)
        self._examination = Examination(training)
        self._beside = 0.0

    def steps_done(self) -> int:
        """Of all arms together."""
        raise NotImplementedError

    def agent(self) -> Policy:
        """What has been learned so far, without what it adds to."""
        raise NotImplementedError

    def network(self) -> torch.nn.Module:
        """All that it has learned."""
        raise NotImplementedError

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        """Replace a checkpoint, see `checkpoints`."""
        raise NotImplementedError

    def log(self, row: Mapping[str, float]) -> None:
        """An evaluation, for what else keeps numbers of a training."""

    def begin(self, config: dict[str, Any]) -> None:
        """Before the first step of this process. config: the record for config.json."""
        self._started = time.perf_counter()
        self._config = config
        write_json(self.folder / CONFIG, self._config, say=False)
        done = self.steps_done()
        self._due = self._started + self.training.checkpoint_seconds
        self._bar = tqdm(total=self.training.steps, initial=done, unit="step", unit_scale=True, desc=self.folder.name, smoothing=0.05)
        self._evaluated, self._checkpointed = done // self.training.evaluation.every, done // self.training.checkpoint_every
        if not self.curve.rows:
            self.aside(self.evaluate)  # compiles, if need be

    def keep(self) -> None:
        """Between two rollouts, when nothing is half done: evaluate and keep what is due."""
        done = self.steps_done()
        self._bar.update(done - self._bar.n)
        if (now := done // self.training.evaluation.every) > self._evaluated:
            self._evaluated = now
            self.aside(self.evaluate)
        now = done // self.training.checkpoint_every
        if now > self._checkpointed or time.perf_counter() >= self._due:
            self._checkpointed = now
            self.aside(self.checkpoint)

    def end(self) -> None:
        """After the last step."""
        self._bar.update(self.steps_done() - self._bar.n)
        if self.curve.rows[-1]["steps"] < self.steps_done():
            self.aside(self.evaluate)
        self.aside(self.checkpoint)
        self._bar.close()

    def aside(self, work: Callable[[], None]) -> None:
        """Work whose time is no part of learning."""
        started = time.perf_counter()
        work()
        self._beside += time.perf_counter() - started

    def evaluate(self) -> None:
        """A row of the learning curve; the best agent is kept."""
        self.check()
        row = evaluation_row(self.steps_done(), self._seconds(), self._examination.of_agent(self.agent()))
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
        """An agent that is no longer one replaces no checkpoint. Raises UserError."""
        if not finite(self.network()):
            text = f"after {self.steps_done()} steps the agent's weights are no longer finite: a smaller learning_rate may help"
            raise UserError(f"{text}. The last checkpoint in {self.folder} is from before")

    def _seconds(self) -> float:
        return self._before + time.perf_counter() - self._started - self._beside


class Learning(Upkeep, BaseCallback):
    """Keeps a training's folder up to date while it learns with Stable-Baselines3."""

    def __init__(self, training: Training, folder: Path, curve: Evaluations, before: float) -> None:
        """Raises ValueError."""
        BaseCallback.__init__(self)
        Upkeep.__init__(self, training, folder, curve, before)
        self._imitated = False

    def begin_after(self, seconds: float) -> None:
        """Count the seconds of an imitation, and keep what was learned in it as soon as the algorithm begins."""
        self._before += seconds
        self._imitated = True

    def steps_done(self) -> int:
        return int(self.num_timesteps)

    def agent(self) -> Policy:
        return NetworkPolicy(self.model, statistics_of(self.model).normalize_obs)

    def network(self) -> torch.nn.Module:
        return self.model.policy

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        save_checkpoint(folder, self.model, config, resumable=resumable)

    def log(self, row: Mapping[str, float]) -> None:
        for name, value in row.items():
            if name not in ("steps", "seconds"):
                self.logger.record(f"evaluation/{name}", value)
        self.logger.dump(self.num_timesteps)

    def times(self) -> Times:
        """Of this process."""
        return Times(time.perf_counter() - self._started, self._environment + self._timed.seconds, self._beside)

    def _on_training_start(self) -> None:
        self._environment = 0.0
        self._stage = self.training.options_at(self.num_timesteps)
        self._frozen = False  # those of a checkpoint that were are frozen once more, which changes nothing
        self.begin(config_record(self.training, unwrapped(self.training_env).env.episodes))
        if self._imitated:
            self.aside(self.checkpoint)

    @property
    def _timed(self) -> Timed:
        timed = statistics_of(self.model).venv
        assert isinstance(timed, Timed)
        return timed

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.keep()
        if not self._frozen and (start := self.training.normalise.frozen_from) is not None and start <= self.num_timesteps:
            self._frozen = True
            freeze_observations(statistics_of(self.model))
        if self.training.imitation is not None:
            free_actor(self.model, self.num_timesteps >= self.training.imitation.critic_steps)
        if (stage := self.training.options_at(self.num_timesteps)) != self._stage:
            self._stage = stage
            self.aside(self._begin_stage)

    def _on_training_end(self) -> None:
        self.end()

    def _begin_stage(self) -> None:
        """New arms for the agent; its networks and statistics go on."""
        training, statistics = self.training, statistics_of(self.model)
        self._environment += self._timed.seconds
        statistics.venv.close()
        statistics.venv = make_training_env(training, self.num_timesteps)
        statistics.venv.seed(training.arm_seed(self.num_timesteps))
        self.model._last_obs = statistics.reset()
        self.model._last_original_obs = statistics.get_original_obs()
        self.model._last_episode_starts = np.ones(training.arms, dtype=bool)


def format_row(row: Mapping[str, float]) -> str:
    """An evaluation in a few words."""
    named = [(name, error_unit(name.removesuffix("_rms"))) for name in row if name.endswith("_rms")]
    words = [f"{unit.heading} {number(unit.factor * row[name])}" for name, unit in named]
    return ", ".join([*words, *([f"reached {100 * row['reached']:.0f} %"] if "reached" in row else [])])

