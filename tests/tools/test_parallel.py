"""Independent runs side by side: results in order, one thread each, errors as they were raised."""

import os

import pytest

from soft_tendon_env.tools.parallel import run_all


def square(x):
    if x < 0:
        raise ValueError(f"x is {x}: it should be at least 0")
    return x * x, os.getpid(), os.environ.get("OMP_NUM_THREADS")


@pytest.mark.parametrize("options", [{"workers": 1}, {"workers": 2}, {"workers": 2, "threads": True}])
def test_results_come_in_order_from_as_many_processes(options):
    values, processes, threads = zip(*run_all(square, range(6), label="squares", **options), strict=True)
    assert values == (0, 1, 4, 9, 16, 25)
    apart = options["workers"] == 2 and "threads" not in options
    assert (os.getpid() not in processes) == apart and (not apart or set(threads) == {"1"})


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_comes_through_and_ends_the_others(workers):
    with pytest.raises(ValueError, match="^x is -1: it should be at least 0$"):
        run_all(square, [1, -1, *range(1000)], workers, "squares")


def test_a_cluster_that_is_not_there_is_told():
    with pytest.raises(ValueError, match="needs Ray|Ray cannot be reached at 127.0.0.1:1"):
        run_all(square, range(3), 2, "squares", cluster="127.0.0.1:1")
