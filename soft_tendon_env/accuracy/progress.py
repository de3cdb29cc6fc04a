"""Progress bar of a trial: the arm's name, the share that is done, and the time to go."""

from __future__ import annotations

from types import TracebackType

REFERENCE_SHARE = 0.7
"""Share of a trial's time that the reference takes, as measured on the arms of
benchmarks/own_arms.py."""

CANDIDATE_SHARE = 0.1
"""Share of what is left that each candidate is taken to need: how many there are is not known."""

LAYOUT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}, about {remaining} to go"


class Progress:
    """Bar of one trial, which SOFT_TENDON_ENV_QUIET=1 leaves out."""

    def __init__(self, name: str, shown: bool = True) -> None:
        # tqdm is not for everyone who imports an environment
        from soft_tendon_env.tools.progress import progress_bar

        label = None
        if shown:
            label = f"{name}, trial of its accuracy"
        self._bar = progress_bar(1.0, label, "trial", LAYOUT)
        self._planned = 0.0
        self._done = 0.0

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def plan(self, work: float) -> None:
        """Adds work of the reference, in units that are the same throughout."""
        self._planned += work

    def reference(self, work: float) -> None:
        """Some of the reference's work is done."""
        self._done += work
        ratio = self._done / self._planned
        done_share = min(ratio, 1.0)
        share = REFERENCE_SHARE * done_share
        growth = share - self._bar.n
        self._bar.update(max(growth, 0.0))

    def candidate(self) -> None:
        """One more candidate was judged."""
        left = CANDIDATE_SHARE * (1.0 - self._bar.n)
        self._bar.update(left)
