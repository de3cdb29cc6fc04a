"""Rows of arms on several threads, each with an arm and a motion of its own."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.mechanics.motion import batch
from soft_tendon_env.mechanics.motion.adjoint import (
    AdjointMemory,
    Cotangents,
    adjoint_rows,
    make_adjoint_memory,
    make_cotangents,
)
from soft_tendon_env.mechanics.motion.advance import Scheme
from soft_tendon_env.mechanics.motion.scratch import Motion, Scratch, Tape, make_scratch, make_tape
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.step_control import linear_rate, step_control, step_method
from soft_tendon_env.tools.parallel import processors
from soft_tendon_env.tools.types import Array

Indices = NDArray[np.int64]

LEAST_ROWS = 8  # rows that a thread should have before another one pays for its wake-up
# rows that one thread steps in about the time that another one takes to wake up and to say that it
# is done
HEAD_START = 2


class Arms:
    """Rows of arms. `outcome` and `reading` (see mechanics.motion.batch) are those of the last
    `step` or `place`.

    All begin with the scene's arm; `set_model` gives one another. Coordinates of a statics-based
    strain are in proportion to the rod's stiffness: `ratio` (rows, n) is that of a row's
    coordinates to those of the scene's arm in the same shape, exact where the whole rod is stiffer
    by a factor, else to first order about the straight arm.

    Copies, pickled ones and forked processes go on from where the rows were, each on threads of its
    own. A process that is forked while another thread steps begins with some rows stepped and
    others not.
    """

    def __init__(
        self,
        model: Model,
        rows: int,
        period: float,
        stations: Array,
        sensors: Array,
        threads: int | None = None,
    ) -> None:
        """`stations` and `sensors`: arc lengths [m] at which poses and strains are read."""
        self.model, self.size, self.period = model, rows, period
        self.places = model.grid.places(stations, sensors)
        self.threads = max(1, min(threads or processors(), rows // LEAST_ROWS))
        control, n = step_control(model, period), model.coordinate_count
        self.substeps = round(period / control.step)
        method = step_method(model)
        self._scheme, self._goes_on = Scheme(method, control), Scheme(method, control, begins=False)
        self._scratch = [make_scratch(model.arm, method.columns) for _ in range(self.threads)]
        self._pool: tuple[int, ThreadPoolExecutor] | None = None  # of the process with this id
        motion = Motion(
            np.zeros(n),
            np.zeros(n),
            model.arm.rod.reference_strain,
            model.arm.effects.state,
            np.zeros(1),
        )
        self._batch = batch.make_batch(model.arm, self.places, motion, control.step, rows)
        self.rows, self.outcome, self.reading = (
            self._batch.rows,
            self._batch.outcome,
            self._batch.reading,
        )
        self._models = [model] * rows
        self.ratio = np.ones((rows, n))
        self._changes = np.zeros(rows, dtype=np.int64)  # of each row's arm
        self._durations = np.full(
            (rows, self.substeps), control.step
        )  # of the usual commands of a period
        self._no_tape = make_tape(model.arm, 0, 0)
        self._adjoint_memory: list[AdjointMemory] | None = None

    @property
    def shape(self) -> Array:
        """Coordinates (rows, n) that give the scene's arm the shape of each row."""
        return np.asarray(self.rows.q / self.ratio)

    def coordinates_of(self, row: int, shape: Array) -> Array:
        """Coordinates (.., n) that give a row's arm the shape that the scene's has at `shape` (..,
        n), as those of targets are."""
        return np.asarray(self.ratio[row] * shape)

    def step(
        self,
        command: Array,
        members: Indices,
        durations: Array | None = None,
        tape: Tape | None = None,
        begins: bool = True,
    ) -> None:
        """Advance the rows `members` under commands (rows, parts, n_a), each held for its duration
        (rows, parts) [s], by default for an integrator step. A tape of `make_tape` keeps what
        `adjoint` needs; the motion is the same. begins: False where the first command is the last
        one of the step before."""
        if durations is None:
            is_usual = command.shape[1] == self.substeps
            durations = (
                self._durations
                if is_usual
                else np.full(command.shape[:2], self._scheme.control.step)
            )
        held, kept = np.ascontiguousarray(durations), self._no_tape if tape is None else tape
        if tape is not None:
            tape.material[members] = self._changes[members]
        rows, scheme = self._batch, self._scheme if begins else self._goes_on
        self.map_rows(
            lambda part, scratch: batch.step_rows(rows, scheme, part, command, held, scratch, kept),
            members,
            HEAD_START,
        )

    def make_tape(self, parts: int = 1) -> Tape:
        """A tape for `step`, of one period with so many parts: commands that follow on one another
        within it."""
        return make_tape(self.model.arm, self.size, parts)

    def make_cotangents(self, parts: int = 1) -> Cotangents:
        """Zeroed cotangents for `adjoint`, of a period with so many parts."""
        return make_cotangents(self.model.arm, self.places, self.size, parts)

    def check_adjoint(self) -> None:
        """Raises ValueError where stresses depend on the strain before, as those of memory."""
        table = self.model.arm.effects
        if table.remembers:
            sizes = np.diff(table.first_state)
            name = next(
                effect
                for i, effect in enumerate(self.model.acting)
                if sizes[i] and i != table.transmission.filter
            )
            text = (
                "has internal states that follow the motion of the arm, through which there is no"
                " adjoint"
            )
            raise ValueError(f"effects.{name} {text}; Simulation.linearize has them")

    def adjoint(self, tape: Tape, members: Indices, cotangents: Cotangents) -> None:
        """Derivatives of a scalar by what went into the period on the tape, of the rows `members`:
        given those by the state after it and by what was read of it, those by the state before it,
        in their place, and by its commands; see Cotangents.

        They are approximate, see mechanics.motion.adjoint; their errors:
        docs/explanation/derivatives.md. Rows whose step had failed get zeros. Raises ValueError
        where rows have got another arm since, and as `check_adjoint`; LinAlgError, which names a
        row, where its motion has no derivative.
        """
        self.check_adjoint()
        changed = members[tape.material[members] != self._changes[members]]
        if changed.size:
            raise ValueError(
                f"row {changed[0]} has got another arm since the period on the tape: go back before"
                " that"
            )
        if self._adjoint_memory is None:
            rate = linear_rate(self.model)
            self._adjoint_memory = [
                make_adjoint_memory(self.model.arm, rate) for _ in range(self.threads)
            ]
        memories = {
            id(scratch): memory
            for scratch, memory in zip(self._scratch, self._adjoint_memory, strict=True)
        }
        motions = self._batch, self._scheme, tape
        self.map_rows(
            lambda part, scratch: adjoint_rows(
                *motions, part, cotangents, scratch, memories[id(scratch)]
            ),
            members,
            HEAD_START,
        )
        failed = members[cotangents.status[members] != OK]
        if failed.size:
            cause = MESSAGES[int(cotangents.status[failed[0]])]
            raise np.linalg.LinAlgError(f"the motion of row {failed[0]} has no derivative: {cause}")

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Put the rows `members` at rest at their coordinates q (members, n), where tensions
        (members, n_a) [N], or none, hold them."""
        commands = np.zeros((self.size, self.model.tendon_count))
        if tension is not None:
            commands[members] = tension
        if self.model.arm.effects.transmission.acts:
            held = commands[members]
            commands[members] = [
                self._models[row].command(*start)
                for row, *start in zip(members.tolist(), held, q, strict=True)
            ]
        self.rows.q[members], self.rows.q_dot[members], self.rows.step[members] = (
            q,
            0.0,
            self._scheme.control.step,
        )
        self.map_rows(
            lambda part, scratch: batch.place_rows(self._batch, part, commands, scratch.work),
            members,
        )

    def map_rows(
        self, work: Callable[[Indices, Scratch], None], members: Indices, head_start: int = 0
    ) -> None:
        """Split the rows among the threads; this one takes `head_start` more, which it does while
        the others wake up."""
        if self.threads == 1 or members.size < self.threads + head_start:
            work(members, self._scratch[0])
            return
        pool = self._own_pool() or ThreadPoolExecutor(self.threads - 1)
        self._pool = os.getpid(), pool
        shared = members.size - head_start
        borders = [head_start + shared * i // self.threads for i in range(1, self.threads + 1)]
        parts = zip(borders[:-1], borders[1:], self._scratch[1:], strict=True)
        others = [pool.submit(work, members[start:end], scratch) for start, end, scratch in parts]
        work(members[: borders[0]], self._scratch[0])
        for other in others:
            other.result()

    def read_samples(
        self, q: Array, q_dot: Array, places: batch.Places | None = None
    ) -> tuple[batch.Reading, NDArray[np.bool_]]:
        """Kinematics along motions with samples q, q_dot (samples, n), of the scene's arm, at other
        `places` if given.

        The Reading (samples, ..), and which samples have a strain, (samples,) bool. What is read of
        a sample depends on its q and q_dot alone.
        """
        arm, where = self.model.arm, self.places if places is None else places
        q, q_dot = (
            np.ascontiguousarray(q),
            np.ascontiguousarray(q_dot),
        )  # kernels are compiled for such
        reading, good = batch.make_reading(arm, where, len(q)), np.zeros(len(q), dtype=bool)
        self.map_rows(
            lambda part, scratch: batch.read_samples(
                arm, where, q, q_dot, part, scratch.work, reading, good
            ),
            np.arange(len(q)),
        )
        return reading, good

    def have_margin(self, q: Array) -> NDArray[np.bool_]:
        """Whether the scene's arm has firm strains, see mechanics.strain, at coordinates q
        (samples, n): (samples,)."""
        q, firm = np.ascontiguousarray(q), np.zeros(len(q), dtype=bool)
        self.map_rows(
            lambda part, scratch: batch.are_firm(self.model.arm, q, part, scratch.work, firm),
            np.arange(len(q)),
        )
        return firm

    def set_model(self, row: int, model: Model) -> None:
        """Give a row its arm: that of a model without `misfit` to the scene's, see
        `Model.with_scene`."""
        if model is self._models[row]:
            return
        self._models[row], self.rows.arm[row] = model, model.arm.address
        if isinstance(model.arm.strain, Implicit):
            self.ratio[row] = np.diag(self.model.metric) / np.diag(model.metric)
        self._changes[row] += 1

    def model_of(self, row: int) -> Model:
        """The model of a row's arm."""
        return self._models[row]

    def _own_pool(self) -> ThreadPoolExecutor | None:
        """The threads of this process: a fork copies the pool but none of its threads, and perhaps
        locks that they held."""
        return self._pool[1] if self._pool is not None and self._pool[0] == os.getpid() else None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_adjoint_memory": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.rows.arm[:] = [model.arm.address for model in self._models]

    def close(self) -> None:
        """Stop this process's threads; a later step starts new ones."""
        pool, self._pool = self._own_pool(), None
        if pool is not None:
            pool.shutdown()
