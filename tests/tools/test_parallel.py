"""Independent runs side by side: results in order, one thread each, errors as they were raised."""

import os

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from soft_tendon_env.tools.parallel import run_all


def square(x):
    if x < 0:
        raise ValueError(f"x is {x}: it should be at least 0")
    return x * x, os.getpid(), {pool["num_threads"] for pool in threadpool_info()}


@pytest.mark.parametrize(
    "options", [{"workers": 1}, {"workers": 2}, {"workers": 2, "threads": True}]
)
def test_results_come_in_order_from_as_many_processes(options):
    told = []
    with threadpool_limits(2):
        results = run_all(
            square,
            range(6),
            label="squares",
            done=lambda place, result: told.append((place, result)),
            **options,
        )
    values, processes, threads = zip(*results, strict=True)
    assert values == (0, 1, 4, 9, 16, 25), "as soon as it is there"
    assert sorted(told) == list(enumerate(results)), "as soon as it is there"
    assert (os.getpid() not in processes) == (options == {"workers": 2}), (
        "as digits of sums depend on it"
    )
    assert set.union(*threads) == {1}, "as digits of sums depend on it"


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_error_comes_through_and_ends_the_others(workers):
    with pytest.raises(ValueError, match="^x is -1: it should be at least 0$"):
        run_all(square, [1, -1, *range(1000)], workers, "squares")


def test_a_cluster_that_is_not_there_is_told():
    with pytest.raises(ValueError, match="needs Ray|Ray cannot be reached at 127.0.0.1:1"):
        run_all(square, range(3), 2, "squares", cluster="127.0.0.1:1")


@pytest.mark.slow
def test_a_cluster_gives_the_same_results_one_by_one():
    cluster = pytest.importorskip("ray.cluster_utils").Cluster(
        initialize_head=True, head_node_args={"num_cpus": 2}
    )
    told = []
    try:
        results = run_all(
            square,
            range(6),
            2,
            "squares",
            cluster=cluster.address,
            done=lambda place, result: told.append(place),
        )
        with pytest.raises(ValueError, match="x is -1"):
            run_all(square, [1, -1, 2], 2, "squares", cluster=cluster.address)
        ((_, alone, _),) = run_all(
            square, [3], 1, "squares", cluster=cluster.address
        )  # after an error, and by one worker
    finally:
        cluster.shutdown()
    values, processes, _ = zip(*results, strict=True)
    assert values == (0, 1, 4, 9, 16, 25)
    assert os.getpid() not in (*processes, alone)
    assert sorted(told) == [*range(6)]
