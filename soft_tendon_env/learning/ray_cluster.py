"""Ray: a cluster that is there, or one of this process's own, which ends with it."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import ray

from soft_tendon_env.tools.failures import first_line

OWN = "local"
"""The address by which Ray begins one of this process's own."""


@contextmanager
def cluster(address: str | None, processors: int, what: str) -> Iterator[None]:
    """While Ray runs. address: of a cluster, or "auto" for the one that runs here; None: one of its own, with as many processors.

    what: takes `processors`, named in errors. Raises ValueError where there is no Ray, or too little room.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    for name in ("ray.rllib", "ray.tune"):
        logging.getLogger(name).setLevel(logging.ERROR)
    own: dict[str, Any] = {} if address else {"num_cpus": max(processors, os.cpu_count() or 1), "include_dashboard": False}
    on_kill = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address or OWN, log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ValueError(f"Ray cannot be reached at {address or 'this machine'}: {first_line(error)}") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_kill)  # which Ray has made its own
    try:
        if (there := int(ray.cluster_resources().get("CPU", 0))) < processors:
            raise ValueError(f"{what} need {processors} processors, the cluster has {there}")
        yield
    finally:
        ray.shutdown()
