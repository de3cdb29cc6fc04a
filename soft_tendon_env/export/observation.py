"""Observations as nodes of a graph: groups from measurements, scaled and clipped, with their history, as `envs.observation` makes them."""

import numpy as np

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import CHANGE
from soft_tendon_env.export.graph import Graph, Value
from soft_tendon_env.export.measurements import LENGTHS, STATES, measurements, own_group
from soft_tendon_env.export.pose_errors import pose_errors

TIP_ENTRIES = {"tip_position": [3, 7, 11], "tip_rotation": [0, 4, 8, 1, 5, 9]}  # of a pose, row by row


class ObservationNodes:
    """Nodes from measurements and states to an agent's observation.

    States are inputs NAME and outputs next_NAME, all zeros at the beginning of an episode; `started` is 0 there.
    """

    def __init__(self, graph: Graph, episodes: Episodes) -> None:
        self._graph, self._episodes = graph, episodes
        self._inputs = {name: graph.input(name, of.shape, f"{of.description} [{of.unit}]") for name, of in measurements(episodes).items()}
        started = graph.input("started", (1,), "0 at the beginning of an episode, then 1")
        self._running = graph.add("Greater", started, 0.5)
        graph.output("next_started", graph.add("Max", started, 1.0), (1,), "for the next call")
        start, tendons = episodes.actuation, episodes.model.tendon_count
        self.command = self._state(
            "command", tendons, episodes.start_command, f"command that was sent last [{episodes.model.scene.effects.command_unit}]"
        )
        self._states = {"command": self.command}
        if "last_action" in episodes.layout.slices:
            self._states["last_action"] = self._state("last_action", tendons, start.start_action, "action before, in [-1, 1]")

    def _state(self, name: str, size: int, start: Value, text: str) -> str:
        """A state that begins an episode with another value than zero."""
        return self._graph.add("Where", self._running, self._graph.input(name, (size,), text), start)

    def flat(self) -> str:
        """Scaled groups and their history (size,), float32."""
        graph, layout = self._graph, self._episodes.layout
        groups = [self._group(name) for name in layout.slices if name in self._episodes.task.observable]
        scaled = graph.add("Mul", graph.add("Concat", *groups, axis=0), layout.scale)
        present = graph.cast(graph.clip(scaled, -layout.bound, layout.bound), np.float32)
        return present if not self._episodes.options.history else graph.add("Concat", present, self._changes(present), axis=0)

    def goals(self) -> tuple[str, str]:
        """Achieved and desired goal (3,), float32, within their space."""
        graph, reach = self._graph, np.float32(self._episodes.goal_bound)
        found = graph.take(graph.reshape(self._inputs["tip_pose"], 16), TIP_ENTRIES["tip_position"]), self._inputs["target_position"]
        achieved, desired = (graph.clip(graph.cast(place, np.float32), np.array(-reach), np.array(reach)) for place in found)
        return achieved, desired

    def _group(self, name: str) -> str:
        """A group's values in SI units."""
        graph = self._graph
        if own_group(self._episodes, name):
            return self._inputs[name]
        if name in TIP_ENTRIES:
            return graph.take(graph.reshape(self._inputs["tip_pose"], 16), TIP_ENTRIES[name])
        if name in ("target_error", "preview"):
            count = len(self._episodes.ahead)
            errors = graph.reshape(pose_errors(graph, self._inputs["tip_pose"], self._inputs["target_pose"], count), 6 * count)
            return graph.take(errors, np.arange(6) if name == "target_error" else np.arange(6, 6 * count))
        if name == LENGTHS:
            return graph.add("Sub", self._inputs[LENGTHS], self._inputs["tendon_lengths"])
        return self._states[name] if name in STATES else self._inputs[name]

    def _changes(self, present: str) -> str:
        """Past less present groups of the arm, the latest period first, flat."""
        graph, kept, periods = self._graph, self._episodes.layout.kept, self._episodes.options.history
        shape, text = (1 + periods, kept.size), "groups of the arm, scaled, now and in the periods before"
        before = graph.input("history", shape, text, np.float32)
        now = graph.take(present, kept)
        moved = graph.add("Concat", graph.reshape(now, 1, kept.size), graph.take(before, np.arange(periods)), axis=0)
        frames = graph.add("Where", self._running, moved, now)
        graph.output("next_history", frames, shape, "for the next call", np.float32)
        change = graph.add("Sub", graph.take(frames, np.arange(1, 1 + periods)), graph.take(frames, [0]))
        return graph.reshape(graph.add("Div", change, np.array(np.float32(CHANGE))), periods * kept.size)
