"""The arm in SoRoMoX: geometric variable strain (GVS), Legendre polynomials for all six strains on
each piece, threadlike actuators.

Everything of the arm can be said: a linear taper, shear modulus, Kelvin-Voigt damping (the same
law), tendons through a routing function of our own, which end where a piece ends. The motion is
SoRoMoX's own `rollout_discrete_closed_loop_to`, with a controller that reads the table of tensions;
its solvers are those of Diffrax. The model's eigenvalues go to -1e6 1/s, so that explicit solvers,
also its default, need steps of microseconds. Two implicit ones are measured: ImplicitEuler at fixed
steps, and Kvaerno3, of third order, with steps by a tolerance on the strains (it takes an explicit
stage and therefore has to begin each 20 ms, where the rates jump, with small steps). Newton's
method starts from the state, not from Diffrax's extrapolation by the rates, from which
ImplicitEuler stops at 1 ms already.
"""

import os

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from soromox.actuation import BaseThreadlikeRoutingParams, ThreadlikeActuator, ThreadlikeRouting
from soromox.systems.components import JointSpec, LinearProfile, LinkSpec
from soromox.systems.gvs import GVS, GVSSegment, StrainBasisSpec
from soromox.systems.system_state import SystemState

from soft_tendon_env.scene.scene import (
    Scene,
    breakpoints,
    rod_radius,
    segment_index,
    tendon_ends,
    tendon_offset,
)

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "SoRoMoX"
DISTRIBUTION = "soromox"
SECONDS = 0.2


@dataclass(frozen=True)
class Setting:
    """Order of the polynomials, fixed time step [s] of ImplicitEuler, or else tolerance of
    Kvaerno3."""

    order: int
    step: float | None = None
    tolerance: float | None = None

    @property
    def label(self) -> str:
        solver = (
            f"ImplicitEuler, {1e3 * self.step:g} ms"
            if self.step
            else f"Kvaerno3, tolerance {self.tolerance:g}"
        )
        return f"order {self.order}, {solver}"


ORDERS = (1, 2, 3)
STEPS = (0.01, 0.005, 0.002)
FIRST_STEP = 1e-4  # [s], of Kvaerno3 after each change of the tensions
GAUSS_POINTS = 8  # per piece
QUICK = (Setting(0, step=0.01),)
HARD = (Setting(1, step=0.01), Setting(1, step=0.002))


def settings() -> list[Setting]:
    return [
        *(Setting(order, step=step) for order in ORDERS for step in STEPS),
        Setting(ORDERS[-1], tolerance=0.1),
    ]


class Spiral(BaseThreadlikeRoutingParams):
    """Routing at distance `radius + taper s` [m] from the axis, at the angle `phase + rate s` [rad]
    from y towards z; (tendons,) each."""

    radius: jax.Array
    taper: jax.Array
    phase: jax.Array
    rate: jax.Array
    start_segment_index: tuple[int, ...] = eqx.field(static=True)
    end_segment_index: tuple[int, ...] = eqx.field(static=True)

    @property
    def num_paths(self) -> int:
        return len(self.start_segment_index)

    def validate_structure(self) -> None:
        pass

    def validate_values(self) -> None:
        pass


def offset(path: Spiral, s: jax.Array) -> jax.Array:
    distance = path.radius + path.taper * s
    angle = path.phase + path.rate * s
    return jnp.stack(
        [jnp.zeros_like(distance), distance * jnp.cos(angle), distance * jnp.sin(angle)]
    )


def slope(path: Spiral, s: jax.Array) -> jax.Array:
    return jax.jvp(lambda at: offset(path, at), (s,), (jnp.ones_like(s),))[1]


def routing_of(scene: Scene, pieces: Array) -> ThreadlikeRouting:
    """The scene's tendons between the borders [m] of its pieces."""
    spirals = []
    for tendon in scene.tendons:
        (y, z), (y_slope, z_slope) = (values[0] for values in tendon_offset(scene, tendon, 0.0))
        distance = np.hypot(y, z)
        spirals.append(
            (
                distance,
                (y * y_slope + z * z_slope) / distance,
                np.arctan2(z, y),
                (y * z_slope - z * y_slope) / distance**2,
            )
        )
    ends = [
        np.searchsorted(pieces, np.array(tendon_ends(scene, tendon)) + 1e-9) - 1
        for tendon in scene.tendons
    ]
    starts, lasts = (tuple(int(i) for i in column) for column in np.array(ends).T)
    params = Spiral(
        *jnp.array(spirals).T,
        start_segment_index=starts,
        end_segment_index=tuple(last - 1 for last in lasts),
    )
    routing = ThreadlikeRouting(params=params, offset_fn=offset, derivative_fn=slope)
    check(scene, routing)
    return routing


def check(scene: Scene, routing: ThreadlikeRouting) -> None:
    """Raises ValueError where a tendon of the scene is no such spiral."""
    for k, tendon in enumerate(scene.tendons):
        for at in np.linspace(*tendon_ends(scene, tendon), 7):
            exact, _ = tendon_offset(scene, tendon, at)
            found = offset(
                jax.tree.map(lambda values, k=k: values[k], routing.params), jnp.array(at)
            )
            if not np.allclose(found[1:], exact[0], atol=1e-9):
                raise ValueError(
                    f"tendon {k + 1} is at {exact[0]} m from the axis at {at:g} m, but a spiral at"
                    f" {found[1:]}"
                )


def robot_of(scene: Scene, order: int) -> GVS:
    borders = breakpoints(scene)
    middles = 0.5 * (borders[1:] + borders[:-1])
    segments = []
    for start, end, index in zip(
        borders[:-1], borders[1:], segment_index(scene, middles), strict=True
    ):
        material = scene.segments[index]
        base, tip = (float(rod_radius(scene, at)[0][0]) for at in (start, end))
        link = LinkSpec.circular(
            length=float(end - start),
            radius=LinearProfile(base=base, tip=tip),
            density=material.density,
            reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
            young_modulus=material.young_modulus,
            shear_modulus=material.young_modulus / (2.0 * (1.0 + material.poisson_ratio)),
            material_damping_coefficient=material.damping,
        )
        basis = StrainBasisSpec("legendre", [1] * 6, order)
        segments.append(GVSSegment(link, JointSpec("fixed"), basis, GAUSS_POINTS))
    return GVS.from_segments(
        segments,
        gravity=jnp.zeros(3),
        base_pose=jnp.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        num_dynamics_prefix_buckets=1,  # the pieces have as many coordinates
        actuators=ThreadlikeActuator.tendons(routing_of(scene, borders)),
    )


class FromTheState(optimistix.Chord):
    """Newton's method with one derivative a stage, from no change of the state."""

    def init(self, fn: Any, y: Any, *others: Any, **named: Any) -> Any:
        return super().init(fn, jax.tree.map(jnp.zeros_like, y), *others, **named)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        start = jax.tree.map(
            lambda value: jnp.where(state.step == 0, jnp.zeros_like(value), value), y
        )
        return super().step(fn, start, args, options, state, tags)


@cache
def tips_of(
    scene: str, order: int, adaptive: bool, rows: int
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Compiled: tips (rows + 1, 3) [m] under a table of tensions (rows, n_a) [N] and a step [s] or
    tolerance; scene as JSON."""
    robot = robot_of(Scene.model_validate_json(scene), order)
    solver = diffrax.Kvaerno3 if adaptive else diffrax.ImplicitEuler

    def of_strains(error: Any) -> jax.Array:
        return jnp.sqrt(jnp.mean(robot.split_state(error.y)[0] ** 2))

    def tips(table: jax.Array, setting: jax.Array) -> jax.Array:
        def held(state: SystemState) -> tuple[jax.Array, None]:
            return table[jnp.round(state.t / HOLD).astype(int)], None

        states = robot.rollout_discrete_closed_loop_to(
            SystemState(t=jnp.array(0.0), y=jnp.zeros(robot.state_size)),
            held,
            duration=HOLD * rows,
            solver_dt=FIRST_STEP if adaptive else setting,
            control_dt=HOLD,
            save_dt=HOLD,
            solver=solver(root_finder=FromTheState(rtol=1e-3, atol=1e-5), root_find_max_steps=50),
            stepsize_controller=(
                diffrax.PIDController(setting, setting, norm=of_strains)
                if adaptive
                else diffrax.ConstantStepSize()
            ),
            max_steps=10_000,
        )
        return jax.vmap(
            lambda y: robot.forward_kinematics_tips(robot.split_state(y)[0])[-1, :3, 3]
        )(states.y)

    table = jnp.zeros((rows, robot.num_actuators))
    return jax.jit(tips).lower(table, jnp.array(HOLD)).compile()


def prepare(scene: Scene, setting: Setting) -> Run:
    return partial(simulate, scene.model_dump_json(), setting)


def simulate(scene: str, setting: Setting, tensions: Array) -> Motion:
    tips = tips_of(scene, setting.order, setting.step is None, len(tensions))
    table = jnp.asarray(tensions)
    chosen = jnp.array(setting.step or setting.tolerance)
    tip = np.full((len(tensions) + 1, 3), np.nan)

    def run() -> None:
        tip[:] = tips(table, chosen)

    try:
        cpu = cpu_time(run)
    except jax.errors.JaxRuntimeError as error:
        return Motion(tip, np.nan, what_it_says(error))
    return Motion(tip, cpu / (HOLD * len(tensions)), "")


def what_it_says(error: Exception) -> str:
    """The line of Equinox's error in what XLA makes of it."""
    lines = [line.strip() for line in str(error).splitlines() if "EquinoxRuntimeError" in line]
    return (
        lines[-1].split(": ", 1)[-1]
        if lines
        else f"{type(error).__name__}: {str(error).splitlines()[0]}"
    )
