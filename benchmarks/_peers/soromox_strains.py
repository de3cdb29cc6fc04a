"""The arm in SoRoMoX: geometric variable strain (GVS), Legendre polynomials for all six strains on each piece, threadlike actuators.

Everything of the arm can be said: a linear taper, shear modulus, Kelvin-Voigt damping (the same law), tendons through a routing function
of our own, which end where a piece ends. The motion is SoRoMoX's own `rollout_discrete_closed_loop_to`, with a controller that reads the
table of tensions; its solvers are those of Diffrax. The rod's eigenvalues go to -1e6 1/s, so that explicit solvers, also its default, need
steps of microseconds; implicit ones of Diffrax differentiate the whole equation of motion and take steps of milliseconds.
"""

import os

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

from dataclasses import dataclass

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import soromox
from soromox.actuation import BaseThreadlikeRoutingParams, ThreadlikeActuator, ThreadlikeRouting
from soromox.systems.components import JointSpec, LinearProfile, LinkSpec
from soromox.systems.gvs import GVS, GVSSegment, StrainBasisSpec
from soromox.systems.system_state import SystemState

from soft_tendon_env.scene.scene import Scene, breakpoints, rod_radius, segment_index, tendon_ends, tendon_offset

from .simulator import HOLD, Array, Motion, Run, cpu_time

NAME = "SoRoMoX"
DISTRIBUTION = "soromox"
SECONDS = 2.0
SOLVERS = {
    "ImplicitEuler": diffrax.ImplicitEuler,
    "Kvaerno3": diffrax.Kvaerno3,
    "Kvaerno5": diffrax.Kvaerno5,
    "Tsit5": diffrax.Tsit5,
}


@dataclass(frozen=True)
class Setting:
    """Order of the polynomials, Diffrax's solver, its step [s] (the first where a tolerance chooses them), relative tolerance."""

    order: int
    solver: str
    step: float
    tolerance: float | None = None
    gauss_points: int = 8

    @property
    def label(self) -> str:
        steps = f"{1e3 * self.step:g} ms" if self.tolerance is None else f"rtol {self.tolerance:g}"
        return f"order {self.order}, {self.solver}, {steps}"


class Spiral(BaseThreadlikeRoutingParams):
    """Routing at distance `radius + taper s` [m] from the axis, at the angle `phase + rate s` [rad] from y towards z; (tendons,) each."""

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
    distance, angle = path.radius + path.taper * s, path.phase + path.rate * s
    return jnp.stack([jnp.zeros_like(distance), distance * jnp.cos(angle), distance * jnp.sin(angle)])


def slope(path: Spiral, s: jax.Array) -> jax.Array:
    return jax.jvp(lambda at: offset(path, at), (s,), (jnp.ones_like(s),))[1]


def routing_of(scene: Scene, pieces: Array) -> ThreadlikeRouting:
    """The scene's tendons between the borders [m] of its pieces."""
    spirals = []
    for tendon in scene.tendons:
        (y, z), (y_slope, z_slope) = (values[0] for values in tendon_offset(scene, tendon, 0.0))
        distance = np.hypot(y, z)
        spirals.append((distance, (y * y_slope + z * z_slope) / distance, np.arctan2(z, y), (y * z_slope - z * y_slope) / distance**2))
    ends = [np.searchsorted(pieces, np.array(tendon_ends(scene, tendon)) + 1e-9) - 1 for tendon in scene.tendons]
    starts, lasts = (tuple(int(i) for i in column) for column in np.array(ends).T)
    params = Spiral(*jnp.array(spirals).T, start_segment_index=starts, end_segment_index=tuple(last - 1 for last in lasts))
    routing = ThreadlikeRouting(params=params, offset_fn=offset, derivative_fn=slope)
    check(scene, routing)
    return routing


def check(scene: Scene, routing: ThreadlikeRouting) -> None:
    """Raises ValueError where a tendon of the scene is no such spiral."""
    for k, tendon in enumerate(scene.tendons):
        for at in np.linspace(*tendon_ends(scene, tendon), 7):
            exact, _ = tendon_offset(scene, tendon, at)
            found = offset(jax.tree.map(lambda values, k=k: values[k], routing.params), jnp.array(at))
            if not np.allclose(found[1:], exact[0], atol=1e-9):
                raise ValueError(f"tendon {k + 1} is at {exact[0]} m from the axis at {at:g} m, but a spiral at {found[1:]}")


def robot_of(scene: Scene, setting: Setting) -> GVS:
    borders = breakpoints(scene)
    middles = 0.5 * (borders[1:] + borders[:-1])
    segments = []
    for start, end, index in zip(borders[:-1], borders[1:], segment_index(scene, middles), strict=True):
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
        basis = StrainBasisSpec("legendre", [1] * 6, setting.order)
        segments.append(GVSSegment(link, JointSpec("fixed"), basis, setting.gauss_points))
    return GVS.from_segments(
        segments,
        gravity=jnp.zeros(3),
        base_pose=jnp.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        num_dynamics_prefix_buckets=1,  # the pieces have as many coordinates
        actuators=ThreadlikeActuator.tendons(routing_of(scene, borders)),
    )


def prepare(scene: Scene, setting: Setting) -> Run:
    robot = robot_of(scene, setting)
    solver = SOLVERS[setting.solver]
    tolerance = setting.tolerance
    if issubclass(solver, diffrax.AbstractImplicitSolver):
        newton = 1e-2 if tolerance is None else min(tolerance, 1e-2)
        solver = solver(root_finder=diffrax.VeryChord(rtol=newton, atol=1e-4 * newton), root_find_max_steps=50)
    else:
        solver = solver()
    def of_strains(error) -> jax.Array:
        """Root mean square of the errors of the strains; their rates, which jump within microseconds, are left to follow."""
        return jnp.sqrt(jnp.mean(robot.split_state(error.y)[0] ** 2))

    steps = diffrax.ConstantStepSize() if tolerance is None else diffrax.PIDController(rtol=tolerance, atol=tolerance, norm=of_strains)

    @jax.jit
    def tips(table: jax.Array) -> jax.Array:
        def held(state: SystemState) -> tuple[jax.Array, None]:
            return table[jnp.round(state.t / HOLD).astype(int)], None

        states = robot.rollout_discrete_closed_loop_to(
            SystemState(t=jnp.array(0.0), y=jnp.zeros(robot.state_size)),
            held,
            duration=HOLD * table.shape[0],
            solver_dt=setting.step,
            control_dt=HOLD,
            save_dt=HOLD,
            solver=solver,
            stepsize_controller=steps,
            max_steps=100_000,
        )
        return jax.vmap(lambda y: robot.forward_kinematics_tips(robot.split_state(y)[0])[-1, :3, 3])(states.y)

    compiled: dict[tuple[int, ...], object] = {}

    def run(tensions: Array) -> Motion:
        table = jnp.asarray(tensions)
        if table.shape not in compiled:
            compiled[table.shape] = tips.lower(table).compile()
        found: list[np.ndarray] = []
        told = ""

        def step() -> None:
            nonlocal told
            try:
                found.append(np.asarray(compiled[table.shape](table)))
            except Exception as error:  # whatever the solver raises inside of compiled code
                told = f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"

        cpu = cpu_time(step)
        tip = found[0] if found else np.full((len(tensions) + 1, 3), np.nan)
        return Motion(tip, cpu / (HOLD * len(tensions)), told)

    return run
