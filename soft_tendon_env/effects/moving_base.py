"""Moving base: the arm on a vehicle, a shaker or another robot, as a prescribed motion of the base's frame."""

import math
from typing import Self

from pydantic import Field, model_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lie import coefficients, cross, exp_se3, minus, plus, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import Base, allow_turning, limits_step, moves_base
from soft_tendon_env.tools.types import Frequency, Number, Triple, Turning


@register_effect("moving_base")
class MovingBase(Effect):
    """`[effects.moving_base]`: the base's frame moves along with the world's axes and turns about a fixed axis through its origin.

    r(t) = `velocity` t + `acceleration` t^2 / 2 + `amplitude` sin(2 pi f t), theta(t) = `angular_velocity` t + `angular_amplitude`
    sin(2 pi f t), with t the time of the simulation or of the episode. Base twist and acceleration enter the recursions (17)-(18) where
    they begin, from which inertia forces follow. Statics are those of the base at rest in its pose at t = 0.
    """

    velocity: Triple = Field((0.0, 0.0, 0.0), description="velocity (x, y, z) at time 0 [m/s], world frame")
    acceleration: Triple = Field((0.0, 0.0, 0.0), description="constant acceleration (x, y, z) [m/s^2]")
    amplitude: Triple = Field((0.0, 0.0, 0.0), description="amplitude (x, y, z) of the swing [m]")
    axis: Triple = Field((0.0, 0.0, 1.0), description="axis about which it turns [-], of any length but zero")
    angular_velocity: Turning = Field(0.0, description="constant angular velocity [rad/s]")
    angular_amplitude: Number = Field(0.0, description="amplitude of the turning swing [rad]")
    frequency: Frequency = Field(0.0, description="frequency f of both swings [Hz]")

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis should not be zero")
        if not self.frequency and (any(self.amplitude) or self.angular_amplitude):
            raise ValueError("frequency should be above 0 Hz where there is an amplitude")
        return self

    def parameters(self, rod: Discretisation) -> "MovingBaseParameters":
        x, y, z = (part / math.hypot(*self.axis) for part in self.axis)
        turning = (x, y, z), self.angular_velocity, self.angular_amplitude, 2.0 * math.pi * self.frequency
        return MovingBaseParameters(self.velocity, self.acceleration, self.amplitude, *turning)


class MovingBaseParameters(Struct):
    """The motion, with a unit axis and the angular frequency [rad/s]."""

    velocity: Triple
    acceleration: Triple
    amplitude: Triple
    axis: Triple
    angular_velocity: float
    angular_amplitude: float
    omega: float


@moves_base(MovingBaseParameters)
@kernel
def move(motion, base: Base):
    """Pose (R, r), spatial twist (w, r_dot - w x r) and its rate (w_dot, r_ddot - w_dot x r - w x r_dot)."""
    t, phase = base.time, motion.omega * base.time
    sine, cosine = math.sin(phase), math.cos(phase)
    angle = motion.angular_velocity * t + motion.angular_amplitude * sine
    rate = motion.angular_velocity + motion.angular_amplitude * motion.omega * cosine
    rate_dot = -motion.angular_amplitude * motion.omega * motion.omega * sine
    r = plus(plus(times(t, motion.velocity), times(0.5 * t * t, motion.acceleration)), times(sine, motion.amplitude))
    r_dot = plus(plus(motion.velocity, times(t, motion.acceleration)), times(motion.omega * cosine, motion.amplitude))
    r_ddot = minus(motion.acceleration, times(motion.omega * motion.omega * sine, motion.amplitude))
    w, w_dot = times(rate, motion.axis), times(rate_dot, motion.axis)
    v, v_dot = minus(r_dot, cross(w, r)), minus(minus(r_ddot, cross(w_dot, r)), cross(w, r_dot))
    R, _ = exp_se3((times(angle, motion.axis), (0.0, 0.0, 0.0)), coefficients(angle * angle))
    for i in range(9):
        base.pose[i] = R[i]
    for i in range(3):
        base.pose[9 + i] = r[i]
        base.twist[i], base.twist[3 + i] = w[i], v[i]
        base.acceleration[i], base.acceleration[3 + i] = w_dot[i], v_dot[i]


@limits_step(MovingBaseParameters)
@kernel
def limit_step(motion, nodes, longest):
    """Steps are short beside a period of the swing, and beside a turn."""
    allow_turning(motion.omega, longest)
    allow_turning(motion.angular_velocity, longest)
