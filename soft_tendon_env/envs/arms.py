"""Batched arms of one scene on several threads, each row with its own material and motion."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects import Effects
from soft_tendon_env.effects.contact.wrench import ContactReading, number_of_contact, read_contact_rows
from soft_tendon_env.envs.kernels import read_wrench_rows
from soft_tendon_env.mechanics.algebra.lanes import LANES, aligned
from soft_tendon_env.mechanics.effects import EffectTable
from soft_tendon_env.mechanics.motion import batch
from soft_tendon_env.mechanics.motion.adjoint import AdjointMemory, Cotangents, adjoint_rows, make_adjoint_memory, make_cotangents
from soft_tendon_env.mechanics.motion.advance import Scheme
from soft_tendon_env.mechanics.motion.scratch import Scratch, make_scratch
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.mechanics.motion.tape import Tape, make_tape
from soft_tendon_env.mechanics.types import Arm, Loaded, Loads, node_field
from soft_tendon_env.model.coordinates import effects_inside
from soft_tendon_env.model.grid import fixed_inertia
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.step_control import linear_rate, step_control, step_method
from soft_tendon_env.tools.parallel import processors
from soft_tendon_env.tools.types import Array

Indices = NDArray[np.int64]

LEAST_ROWS = 8
"""Rows that a thread should have before another one pays for its wake-up."""
HEAD_START = 2
"""Rows that one thread steps in about the time that another one takes to wake up and to say that it is done."""


class Material(NamedTuple):
    """Material of a row beside the scene's: factors of stiffness, viscosity and density, and a mass added at the tip [kg]."""

    stiffness: float = 1.0
    damping: float = 1.0
    density: float = 1.0
    payload: float = 0.0


class RowEffects(NamedTuple):
    """Effects of a row in place of the scene's, from which they differ in numbers alone."""

    effects: Effects
    table: EffectTable  # what the kernels read of them, on the rod with the row's stiffness


def row_effects(model: Model, effects: Effects, stiffness: float = 1.0) -> RowEffects:
    """Effects on the rod of a model made so many times as stiff. Raises ConfigurationError or TypeError that effects raise."""
    rod, acting = model.discretisation, effects.outside() if effects_inside(model.scene) else effects
    own = replace(rod, effects=effects, elasticity=lambda arc_length: stiffness * rod.elasticity(arc_length))
    return RowEffects(effects, acting.table(own))


class Arms:
    """Rows of arms. `outcome` and `reading` (see mechanics.rows) are those of the last `step` or `place`.

    Copies, pickled ones and forked processes go on from where the rows were, each on threads of its own. A process that is forked while
    another thread steps begins with some rows stepped and others not.
    """

    def __init__(self, model: Model, rows: int, period: float, stations: Array, sensors: Array, threads: int | None = None) -> None:
        """`stations` and `sensors`: arc lengths [m] at which poses and strains are read."""
        self.model, self.size = model, rows
        self.places = model.grid.places(stations, sensors)
        self.threads = max(1, min(threads or processors(), rows // LEAST_ROWS))
        control, n = step_control(model, period), model.coordinate_count
        self.substeps = round(period / control.step)
        method = step_method(model)
        self._scheme, self._goes_on = Scheme(method, control), Scheme(method, control, begins=False)
        self._scratch = [make_scratch(model.arm, method.columns) for _ in range(self.threads)]
        self._pool: tuple[int, ThreadPoolExecutor] | None = None  # of the process with this id
        rod, strain = model.arm.rod, model.arm.strain
        each = {
            **{name: getattr(rod, name) for name in ("mass", "root_compliance", "root_stiffness", "viscosity", "inertia", "node_mass")},
            "damping": strain.damping_matrix(),
            "effects": model.arm.effects.values,
            "q": np.zeros(n),
            "q_dot": np.zeros(n),
            "xi": rod.reference_strain,
            "state": model.arm.effects.state,
            "clock": np.zeros(1),
            "arm": np.zeros((), dtype=np.int64),
            "step": np.array(control.step),
        }
        self.rows = batch.Rows(**{name: aligned(np.tile(values, (rows, *[1] * values.ndim))) for name, values in each.items()})
        self._effects: list[RowEffects | None] = [None] * rows  # of their own
        self._find_arms()
        self._fixed = node_field(fixed_inertia(model.scene.effects, model.discretisation))
        self.outcome = batch.Outcome(status=np.zeros(rows, dtype=np.int64), rejected=np.zeros(rows, dtype=np.int64), error=np.zeros(rows))
        self.reading = batch.make_reading(model.arm, self.places, rows)
        self._batch = batch.Batch(arm=model.arm, places=self.places, rows=self.rows, outcome=self.outcome, reading=self.reading)
        self._stiffness = np.ones((rows, 1))
        self._materials = np.zeros(rows, dtype=np.int64)  # how many each row has had
        self._no_tape = make_tape(model.arm, 0, 0)
        self._adjoint_memory: list[AdjointMemory] | None = None

    @property
    def shape(self) -> Array:
        """Coordinates (rows, n) that give the scene's material the strain of each row; those of a statics-based strain are in proportion
        to its stiffness."""
        return np.asarray(self.model.arm.strain.of_softer_rod(self.rows.q, self._stiffness))

    def coordinates_of(self, row: int, shape: Array) -> Array:
        """Coordinates (.., n) that give a row's material the strain that the scene's has at `shape` (.., n), as those of targets are."""
        return np.asarray(self.model.arm.strain.of_softer_rod(shape, 1.0 / self._stiffness[row]))

    def step(self, command: Array, members: Indices, durations: Array | None = None, tape: Tape | None = None, begins: bool = True) -> None:
        """Advance the rows `members` under commands (rows, parts, n_a), each held for its duration (rows, parts) [s], by default for an
        integrator step. A tape of `make_tape` keeps what `adjoint` needs; the motion is the same. begins: False where the first command
        is the last one of the step before."""
        if durations is None:
            durations = np.empty(command.shape[:2])
            durations.fill(self._scheme.control.step)
        held, kept = np.ascontiguousarray(durations), self._no_tape if tape is None else tape
        if tape is not None:
            tape.material[members] = self._materials[members]
        own, scheme = self._batch, self._scheme if begins else self._goes_on
        self.share(lambda part, scratch: batch.step_rows(own, scheme, part, command, held, scratch, kept), members, HEAD_START)

    def make_tape(self, parts: int = 1) -> Tape:
        """A tape for `step`, of one period with so many parts: commands that follow on one another within it."""
        return make_tape(self.model.arm, self.size, parts)

    def make_cotangents(self, parts: int = 1) -> Cotangents:
        """Zeroed cotangents for `adjoint`, of a period with so many parts."""
        return make_cotangents(self.model.arm, self.places, self.size, parts)

    def check_adjoint(self) -> None:
        """Raises ValueError where stresses depend on the strain before, as those of memory."""
        table = self.model.arm.effects
        if table.remembers:
            sizes = np.diff(table.first_state)
            name = next(own for i, own in enumerate(self.model.acting) if sizes[i] and i != table.transmission.filter)
            text = "has internal states that follow the motion of the arm, through which there is no adjoint"
            raise ValueError(f"effects.{name} {text}; Simulation.linearize has them")

    def adjoint(self, tape: Tape, members: Indices, cotangents: Cotangents) -> None:
        """Derivatives of a scalar by what went into the period on the tape, of the rows `members`: given those by the state after it and by
        what was read of it, those by the state before it, in their place, and by its commands; see Cotangents.

        They are approximate, see mechanics.motion.adjoint: of the continuous motion, to second order in the length of a piece; at
        kinks of contact, of the side that the middle of the piece is on, at slack that of its end. Their errors by arm and effect:
        docs/appendix/derivatives_measured.md. What is read is not overwritten. Rows whose step had failed get zeros.

        Raises ValueError where rows have got another material since, and as `check_adjoint`; LinAlgError, which names a row, where its
        motion has no derivative.
        """
        self.check_adjoint()
        changed = members[tape.material[members] != self._materials[members]]
        if changed.size:
            raise ValueError(f"row {changed[0]} has got another material or effects since the period on the tape: go back before that")
        if self._adjoint_memory is None:
            rate = linear_rate(self.model)
            self._adjoint_memory = [make_adjoint_memory(self.model.arm, rate) for _ in range(self.threads)]
        memories, scheme = self._adjoint_memory, self._scheme

        def go_back(part: Indices, scratch: Scratch) -> None:
            memory = memories[self._scratch.index(scratch)]
            adjoint_rows(self._batch, scheme, tape, part, cotangents, scratch, memory)

        self.share(go_back, members, HEAD_START)
        failed = members[cotangents.status[members] != OK]
        if failed.size:
            cause = MESSAGES[int(cotangents.status[failed[0]])]
            raise np.linalg.LinAlgError(f"the motion of row {failed[0]} has no derivative: {cause}")

    def place(self, members: Indices, q: Array, tension: Array | None = None) -> None:
        """Put the rows `members` at rest at their coordinates q (members, n), where tensions (members, n_a) [N], or none, hold them."""
        commands = np.zeros((self.size, self.model.tendon_count))
        if self.model.arm.effects.transmission.acts:
            held = np.broadcast_to(0.0 if tension is None else tension, (members.size, self.model.tendon_count))
            commands[members] = [self.model_of(row).command(*own) for row, *own in zip(members.tolist(), held, q, strict=True)]
        self.rows.q[members], self.rows.q_dot[members], self.rows.step[members] = q, 0.0, self._scheme.control.step
        self.share(lambda part, scratch: batch.place_rows(self._batch, part, commands, scratch.work), members)

    def read_contact(self, members: Indices, section: Indices, reading: ContactReading) -> None:
        """Contact of the rows `members` with their obstacles into `reading`; `section` (samples,) of the arm in which each sample lies."""
        arm, number = self.model.arm, number_of_contact(self.model.arm.effects)
        self.share(lambda part, scratch: read_contact_rows(arm, self.rows, part, number, section, scratch.work, reading), members)

    def read_wrenches(self, members: Indices, number: int) -> Array:
        """Forces (members, nodes, 3) [N], world frame, of the effect of that `number` on the nodes of the rows `members`."""
        arm, nodes = self.model.arm, self.model.arm.rod.length.size
        wrench, pose = np.zeros((self.size, 6 * nodes)), np.zeros((self.size, 12 * nodes))
        self.share(lambda part, scratch: read_wrench_rows(arm, self.rows, part, number, scratch.work, wrench, pose), members)
        force, rotation = (values[members].reshape(members.size, -1, width, LANES) for values, width in ((wrench, 6), (pose, 12)))
        turned = np.einsum("rpijl,rpjl->rpli", rotation[:, :, :9].reshape(*rotation.shape[:2], 3, 3, LANES), force[:, :, 3:])
        return turned.reshape(members.size, nodes, 3)

    def read_positions(self, members: Indices, places: batch.Places) -> Array:
        """Positions (members, stations, 3) [m] of the rows `members` at other places."""
        poses = batch.identities(members.size, places.station.size)
        batch.read_backbones(self.model.arm, places, self.rows.xi[members], self._scratch[0].work, poses)
        return np.ascontiguousarray(poses[..., :3, 3])

    def share(self, work: Callable[[Indices, Scratch], None], members: Indices, head_start: int = 0) -> None:
        """Split the rows among the threads; this one takes `head_start` more, which it does while the others wake up."""
        if self.threads == 1 or members.size < self.threads + head_start:
            work(members, self._scratch[0])
            return
        pool = self._own_pool()
        if pool is None:
            pool = ThreadPoolExecutor(self.threads - 1)
            self._pool = os.getpid(), pool
        shared = members.size - head_start
        borders = [head_start + shared * i // self.threads for i in range(1, self.threads + 1)]
        parts = zip(borders[:-1], borders[1:], self._scratch[1:], strict=True)
        others = [pool.submit(work, members[start:end], scratch) for start, end, scratch in parts]
        work(members[: borders[0]], self._scratch[0])
        for other in others:
            other.result()

    def read_samples(self, q: Array, q_dot: Array, places: batch.Places | None = None) -> tuple[batch.Reading, NDArray[np.bool_]]:
        """Kinematics along motions with samples q, q_dot (samples, n), of arms of the scene's material, at other `places` if given.

        The Reading (samples, ..), and which samples have a strain, (samples,) bool. What is read of a sample depends on its q and q_dot
        alone.
        """
        arm, where = self.model.arm, self.places if places is None else places
        q, q_dot = np.ascontiguousarray(q), np.ascontiguousarray(q_dot)  # kernels are compiled for such
        reading, good = batch.make_reading(self.model.arm, where, len(q)), np.zeros(len(q), dtype=bool)
        everything = np.arange(len(q), dtype=np.int64)
        self.share(lambda part, scratch: batch.read_samples(arm, where, q, q_dot, part, scratch.work, reading, good), everything)
        return reading, good

    def are_firm(self, q: Array) -> NDArray[np.bool_]:
        """Whether arms of the scene's material have firm strains, see mechanics.strain, at coordinates q (samples, n): (samples,)."""
        q, firm = np.ascontiguousarray(q), np.zeros(len(q), dtype=bool)
        everything = np.arange(len(q), dtype=np.int64)
        self.share(lambda part, scratch: batch.are_firm(self.model.arm, q, part, scratch.work, firm), everything)
        return firm

    def set_material(self, row: int, material: Material, own: RowEffects | None = None) -> None:
        """Give a row its material, and effects in place of the scene's, made with `row_effects` for its stiffness; the strain
        parametrisation stays the scene's."""
        rod, rows, scene = self.model.arm.rod, self.rows, self.model.scene
        self._stiffness[row] = material.stiffness
        self._materials[row] += 1
        rows.root_compliance[row] = rod.root_compliance / np.sqrt(material.stiffness)
        rows.root_stiffness[row] = rod.root_stiffness * np.sqrt(material.stiffness)
        rows.viscosity[row] = rod.viscosity * material.damping
        rows.damping[row] = self.model.arm.strain.damping_matrix() * material.damping
        inertia = (rod.inertia * material.density + (1.0 - material.density) * self._fixed).reshape(-1, 6, LANES)
        inertia[-1, 3:, -1] += material.payload
        rows.node_mass[row] = rod.node_mass * material.density
        rows.node_mass[row, -1] += (1.0 - material.density) * scene.effects.payload[3] + material.payload
        if own is not None:
            fixed = fixed_inertia(own.effects, replace(self.model.discretisation, effects=own.effects))
            inertia += (node_field(fixed) - self._fixed).reshape(inertia.shape)
            rows.node_mass[row, -1] += own.effects.payload[3] - scene.effects.payload[3]
        rows.inertia[row] = inertia.ravel()
        rows.mass[row] = inertia[:, 3].sum()
        if own is None and material.stiffness != 1.0 and self.model.arm.effects.count:
            rows.effects[row] = row_effects(self.model, scene.effects, material.stiffness).table.values
        else:
            rows.effects[row] = (self.model.arm.effects if own is None else own.table).values
        if own is not None or self._effects[row] is not None:
            self._effects[row] = own
            self._arms[row] = self._arm_of(row)
            rows.arm[row] = self._arms[row].address

    def _arm_of(self, row: int) -> Arm:
        """The arm of a row, with loads inside of its strain and states at rest of its own where it has effects of its own."""
        arm, own = batch.arm_of_row(self.model.arm, self.rows, row), self._effects[row]
        if own is None:
            return arm
        if isinstance(arm.strain, Loaded):
            arm = arm.replaced(strain=arm.strain.replaced(loads=Loads(**own.effects.dead_loads()._asdict())))
        state, begins = arm.effects.state.copy(), own.table.first_state
        for first, start, end in zip(arm.effects.first_state[:-1], begins[:-1], begins[1:], strict=True):
            state[first : first + end - start] = own.table.state[start:end]  # none, where the effect then needs none
        return arm.replaced(effects=arm.effects.replaced(state=state, transmission=own.table.transmission))

    def model_of(self, row: int) -> Model:
        """The model of a row: the arm with its material and its effects. Its scene has the effects; the material is that of the scene."""
        return self.model.beside(self._arms[row], self.effects_of(row))

    def model_among(self, row: int) -> Model:
        """The model of the scene's arm, with all that it may come upon, as obstacles, being the row's."""
        own = self._effects[row]
        if own is None:
            return self.model
        met = {name: effect for name, effect in own.effects.chosen().items() if effect.is_encountered}
        return model_with(self.model, Effects(**{**self.model.scene.effects.chosen(), **met}))

    def effects_of(self, row: int) -> Effects:
        """The effects of a row."""
        return self.model.scene.effects if (own := self._effects[row]) is None else own.effects

    def _own_pool(self) -> ThreadPoolExecutor | None:
        """The threads of this process: a fork copies the pool but none of its threads, and perhaps locks that they held."""
        return self._pool[1] if self._pool is not None and self._pool[0] == os.getpid() else None

    def _find_arms(self) -> None:
        """The arms of the rows, for the kernels to find by their addresses."""
        self._arms = [self._arm_of(row) for row in range(self.size)]
        self.rows.arm[:] = [arm.address for arm in self._arms]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_arms": None, "_adjoint_memory": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._find_arms()

    def close(self) -> None:
        """Stop this process's threads; a later step starts new ones."""
        pool, self._pool = self._own_pool(), None
        if pool is not None:
            pool.shutdown()


def model_with(model: Model, effects: Effects) -> Model:
    """The model of the same arm, on the same grid, with other effects, those inside of its strain and the inertia that effects add left as
    they are: for its statics."""
    return model.beside(model.arm.replaced(effects=row_effects(model, effects).table), effects)
