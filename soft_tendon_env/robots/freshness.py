"""Freshness of measurements: the newest one, and since when the slowest sensor gave nothing new."""

import numpy as np

from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.robots.protocol import Measurement


class Freshness:
    """Newest measurement of a robot, and how old it is.

    Motors and the tracker of a pose have times of their own, of any clocks: a reading counts as new
    if its time is later than the last one's, and its age counts from when it came.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.begin()

    def begin(self) -> None:
        """Begins without a measurement."""
        self.newest: Measurement | None = None
        # of the newest readings, by the sensors' clocks
        self._time = -np.inf
        self._time_of_pose = -np.inf
        # when they came, by the loop's clock
        self._came = self._pose_came = self._pose_seen = self._clock.now()

    @property
    def age(self) -> float:
        """Time [s] since the slowest sensor gave something new."""
        oldest = min(self._came, self._pose_came)
        return self._clock.now() - oldest

    @property
    def age_of_pose(self) -> float:
        """Time [s] since a pose came that was new, also of one that was not taken."""
        return self._clock.now() - self._pose_seen

    def is_new_pose(self, measured: Measurement) -> bool:
        """Whether the pose of a measurement is of a later time than all before."""
        return measured.time_of_pose > self._time_of_pose

    def take(self, measured: Measurement, takes_pose: bool) -> None:
        """Takes what is new of a measurement; its pose only if `takes_pose`."""
        is_new = measured.time > self._time
        now = self._clock.now()
        if takes_pose:
            self._pose_came = now
        if self.is_new_pose(measured):
            self._pose_seen = now
        if is_new:
            self._came = now
        self._time = max(self._time, measured.time)
        self._time_of_pose = max(self._time_of_pose, measured.time_of_pose)
        if self.newest is None:
            self.newest = measured
            return
        if is_new:
            motors = measured
        else:
            motors = self.newest
        if takes_pose:
            tracker = measured
        else:
            tracker = self.newest
        self.newest = motors._replace(
            tip_pose=tracker.tip_pose, tip_twist=tracker.tip_twist, tip_time=tracker.tip_time
        )
