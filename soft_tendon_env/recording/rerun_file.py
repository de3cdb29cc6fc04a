"""Rollouts written to a Rerun file (.rrd), which `rerun FILE` plays."""

from collections.abc import Callable
from pathlib import Path

from soft_tendon_env.recording.rerun_stream import RerunStream
from soft_tendon_env.recording.rollout import Rollout


class RerunFile(RerunStream):
    """Rerun file that opens as a 3-D view beside plots.

    It is a context manager too. Whatever `write` has returned from stays readable if the process is
    killed, unless in the very moment of another write; `close` adds the index that `rerun rrd
    verify` asks for.

    Args:
        path: of the file, which is replaced; its folder is made.

    Raises:
        OSError: if the file cannot be written, because a disk is full for instance.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(b"")  # Rerun itself would only warn
        super().__init__(self.path.stem, str(self.path))
        self._attempt(self._open_recording().save, self.path)

    def write(
        self,
        rollout: Rollout,
        arm: str = "arm",
        *,
        continues: bool = False,
    ) -> None:
        """Appends an episode of an arm, which is on disk when this returns.

        Args:
            rollout: the episode, or a stretch of one.
            arm: its name.
            continues: whether it is the next stretch of the arm's last episode.

        Raises:
            ValueError: if the arm has another scene, or the file is closed.
            OSError: if the file cannot be written.
        """
        super().write(rollout, arm, continues=continues)
        self._attempt(self._open_recording().flush)

    def _attempt(self, action: Callable[..., None], *arguments: Path) -> None:
        """Raises OSError."""
        try:
            action(*arguments)
        except RuntimeError as error:  # what Rerun makes of it
            raise OSError(
                f"{self.path} cannot be written, what was recorded ends before this: {error}"
            ) from error
