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

LEAST_ROWS = 8
"""Rows that a thread should have before another one pays for its wake-up."""

HEAD_START = 2
"""Rows that a thread steps in about the time that another takes to wake up and say that it is
done."""


class Arms:
    """Rows of arms, which are stepped on several threads.

    `outcome` and `reading` (see mechanics.motion.batch) are those of the last `step` or `place`.
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
        """Make rows of a model's arm.

        Args:
            model: of the arm.
            rows: of arms.
            period: of control [s].
            stations: arc lengths [m] at which poses are read.
            sensors: arc lengths [m] at which strains are read.
            threads: at most this many; None: as many as there are processors.
        """
        self.model = model
        self.size = rows
        self.period = period
        self.places = model.grid.places(stations, sensors)
        workers = threads or processors()
        most = min(workers, rows // LEAST_ROWS)
        self.threads = max(1, most)
        control = step_control(model, period)
        method = step_method(model)
        self.substeps = round(period / control.step)
        self._scheme = Scheme(method, control)
        self._goes_on = Scheme(method, control, begins=False)
        self._scratch = [make_scratch(model.arm, method.columns) for _ in range(self.threads)]
        self._pool: tuple[int, ThreadPoolExecutor] | None = None  # of the process with this id

        n = model.coordinate_count
        start = Motion(
            np.zeros(n),
            np.zeros(n),
            model.arm.rod.reference_strain,
            model.arm.effects.state,
            np.zeros(1),
        )
        self._batch = batch.make_batch(
            model.arm,
            self.places,
            start,
            control.step,
            rows,
        )
        self.rows = self._batch.rows
        self.outcome = self._batch.outcome
        self.reading = self._batch.reading

        self._models = [model] * rows
        self.ratio = np.ones((rows, n))
        # how often each row has got another arm: a tape of before does not fit the one of now
        self._changes = np.zeros(rows, dtype=np.int64)
        # durations of the usual commands of a period, one for each integrator step
        shape = (rows, self.substeps)
        self._durations = np.full(shape, control.step)
        self._no_tape = make_tape(model.arm, 0, 0)
        self._adjoint_memory: list[AdjointMemory] | None = None

    @property
    def shape(self) -> Array:
        """Coordinates (rows, n) that give the scene's arm the shape of each row."""
        q = self.rows.q / self.ratio
        return np.asarray(q)

    def coordinates_of(self, row: int, shape: Array) -> Array:
        """Coordinates (.., n) that give a row's arm the shape of the scene's arm.

        Args:
            row: whose arm it is.
            shape: coordinates (.., n) of the scene's arm, as those of targets are.

        Returns:
            The coordinates of the row's arm.
        """
        ratio = self.ratio[row]
        return np.asarray(ratio * shape)

    def step(
        self,
        command: Array,
        members: Indices,
        durations: Array | None = None,
        tape: Tape | None = None,
        begins: bool = True,
    ) -> None:
        """Advance rows under commands.

        Args:
            command: (rows, parts, n_a), held one after another.
            members: rows that are advanced.
            durations: (rows, parts) [s] of the commands, by default an integrator step.
            tape: of `make_tape`, that keeps what `adjoint` needs; the motion is the same.
            begins: False where the first command is the last one of the step before.
        """
        if durations is None and command.shape[1] == self.substeps:
            durations = self._durations
        elif durations is None:
            shape = command.shape[:2]
            durations = np.full(shape, self._scheme.control.step)
        durations = np.ascontiguousarray(durations)
        if tape is None:
            tape = self._no_tape
        else:
            tape.material[members] = self._changes[members]
        rows = self._batch
        if begins:
            scheme = self._scheme
        else:
            scheme = self._goes_on

        def step(part: Indices, scratch: Scratch) -> None:
            batch.step_rows(
                rows,
                scheme,
                part,
                command,
                durations,
                scratch,
                tape,
            )

        self.map_rows(step, members, HEAD_START)

    def make_tape(self, parts: int = 1) -> Tape:
        """Tape for `step`, of a period with so many parts: commands that follow on one another."""
        return make_tape(self.model.arm, self.size, parts)

    def make_cotangents(self, parts: int = 1) -> Cotangents:
        """Zeroed cotangents for `adjoint`, of a period with so many parts."""
        return make_cotangents(self.model.arm, self.places, self.size, parts)

    def check_adjoint(self) -> None:
        """Raise an error where there is no adjoint.

        Raises:
            ValueError: where stresses depend on the strain before, as those of memory.
        """
        table = self.model.arm.effects
        if not table.remembers:
            return
        state_sizes = np.diff(table.first_state)
        for i, name in enumerate(self.model.acting):
            if state_sizes[i] and i != table.transmission.filter:
                raise ValueError(
                    f"effects.{name} has internal states that follow the motion of the arm,"
                    " through which there is no adjoint; Simulation.linearize has them"
                )

    def adjoint(
        self,
        tape: Tape,
        members: Indices,
        cotangents: Cotangents,
    ) -> None:
        """Adjoint of a period: derivatives of a scalar by the state before it and its commands.

        They are approximate, see mechanics.motion.adjoint; their errors:
        docs/explanation/derivatives.md. Rows whose step had failed get zeros.

        Args:
            tape: of the period.
            members: rows that go back.
            cotangents: derivatives by the state after it and by what was read of it, which those by
                the state before it and by its commands replace; see Cotangents.

        Raises:
            ValueError: where rows have got another arm since, and as `check_adjoint`.
            LinAlgError: which names a row, where its motion has no derivative.
        """
        self.check_adjoint()
        material = tape.material[members]
        before = self._changes[members]
        changed = members[material != before]
        if changed.size:
            raise ValueError(
                f"row {changed[0]} has got another arm since the period on the tape: go back before"
                " that"
            )
        memory_of = self._adjoint_memories()
        rows = self._batch
        scheme = self._scheme

        def go_back(part: Indices, scratch: Scratch) -> None:
            adjoint_rows(
                rows,
                scheme,
                tape,
                part,
                cotangents,
                scratch,
                memory_of[id(scratch)],
            )

        self.map_rows(go_back, members, HEAD_START)
        has_failed = cotangents.status[members] != OK
        failed = members[has_failed]
        if failed.size:
            code = int(cotangents.status[failed[0]])
            cause = MESSAGES[code]
            message = f"the motion of row {failed[0]} has no derivative: {cause}"
            raise np.linalg.LinAlgError(message)

    def _adjoint_memories(self) -> dict[int, AdjointMemory]:
        """The memory of every thread's adjoint, by the `id` of its scratch.

        It is made when first asked for.
        """
        if self._adjoint_memory is None:
            rate = linear_rate(self.model)
            self._adjoint_memory = [
                make_adjoint_memory(self.model.arm, rate) for _ in range(self.threads)
            ]
        pairs = zip(self._scratch, self._adjoint_memory, strict=True)
        return {id(scratch): memory for scratch, memory in pairs}

    def place(
        self,
        members: Indices,
        q: Array,
        tension: Array | None = None,
    ) -> None:
        """Put rows at rest.

        Args:
            members: the rows.
            q: their coordinates (members, n).
            tension: (members, n_a) [N] that holds them; None: none.
        """
        shape = (self.size, self.model.tendon_count)
        commands = np.zeros(shape)
        if tension is not None:
            commands[members] = tension
        if self.model.arm.effects.transmission.acts:
            for row, coordinates in zip(members.tolist(), q, strict=True):
                model = self._models[row]
                commands[row] = model.command(commands[row], coordinates)
        self.rows.q[members] = q
        self.rows.q_dot[members] = 0.0
        self.rows.step[members] = self._scheme.control.step
        rows = self._batch

        def place(part: Indices, scratch: Scratch) -> None:
            batch.place_rows(rows, part, commands, scratch.work)

        self.map_rows(place, members)

    def map_rows(
        self,
        work: Callable[[Indices, Scratch], None],
        members: Indices,
        head_start: int = 0,
    ) -> None:
        """Split rows among the threads.

        Args:
            work: on a part of the rows, with the scratch of a thread.
            members: the rows.
            head_start: rows that this thread takes more, while the others wake up.
        """
        is_alone = self.threads == 1
        if is_alone or members.size < self.threads + head_start:
            work(members, self._scratch[0])
            return
        pool = self._own_pool() or ThreadPoolExecutor(self.threads - 1)
        self._pool = os.getpid(), pool
        # borders[i] is where the rows of thread i end; this one is thread 0
        shared = members.size - head_start
        borders = [
            head_start + shared * thread // self.threads for thread in range(1, self.threads + 1)
        ]
        others = []
        for thread in range(1, self.threads):
            begin = borders[thread - 1]
            part = members[begin : borders[thread]]
            scratch = self._scratch[thread]
            others.append(pool.submit(work, part, scratch))
        own = members[: borders[0]]
        scratch = self._scratch[0]
        work(own, scratch)
        for other in others:
            other.result()

    def read_samples(
        self,
        q: Array,
        q_dot: Array,
        places: batch.Places | None = None,
    ) -> tuple[batch.Reading, NDArray[np.bool_]]:
        """Kinematics of the scene's arm along motions.

        What is read of a sample depends on its q and q_dot alone.

        Args:
            q: coordinates (samples, n).
            q_dot: their rates (samples, n).
            places: at which poses and strains are read, by default those of the rows.

        Returns:
            The Reading (samples, ..), and which samples have a strain, (samples,) bool.
        """
        arm = self.model.arm
        if places is None:
            places = self.places
        samples = len(q)
        q = np.ascontiguousarray(q)  # kernels are compiled for such
        q_dot = np.ascontiguousarray(q_dot)
        reading = batch.make_reading(arm, places, samples)
        has_strain = np.zeros(samples, dtype=bool)

        def read(part: Indices, scratch: Scratch) -> None:
            batch.read_samples(
                arm,
                places,
                q,
                q_dot,
                part,
                scratch.work,
                reading,
                has_strain,
            )

        self.map_rows(read, np.arange(samples))
        return reading, has_strain

    def have_margin(self, q: Array) -> NDArray[np.bool_]:
        """Whether the scene's arm has firm strains, see mechanics.strain.

        Args:
            q: coordinates (samples, n).

        Returns:
            Whether it has, (samples,).
        """
        arm = self.model.arm
        samples = len(q)
        q = np.ascontiguousarray(q)
        firm = np.zeros(samples, dtype=bool)

        def look(part: Indices, scratch: Scratch) -> None:
            batch.are_firm(
                arm,
                q,
                part,
                scratch.work,
                firm,
            )

        self.map_rows(look, np.arange(samples))
        return firm

    def set_model(self, row: int, model: Model) -> None:
        """Give a row its arm.

        Args:
            row: whose arm it is.
            model: without `misfit` to the scene's, see `Model.with_scene`.
        """
        if model is self._models[row]:
            return
        self._models[row] = model
        self.rows.arm[row] = model.arm.address
        if isinstance(model.arm.strain, Implicit):
            stiffness = np.diag(self.model.metric)
            own_stiffness = np.diag(model.metric)
            self.ratio[row] = stiffness / own_stiffness
        self._changes[row] += 1

    def model_of(self, row: int) -> Model:
        """The model of a row's arm."""
        return self._models[row]

    def _own_pool(self) -> ThreadPoolExecutor | None:
        """The threads of this process.

        A fork copies the pool but none of its threads, and perhaps locks that they held.
        """
        if self._pool is None:
            return None
        process, pool = self._pool
        if process != os.getpid():
            return None
        return pool

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_adjoint_memory": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.rows.arm[:] = [model.arm.address for model in self._models]

    def close(self) -> None:
        """Stop this process's threads; a later step starts new ones."""
        pool = self._own_pool()
        self._pool = None
        if pool is not None:
            pool.shutdown()
