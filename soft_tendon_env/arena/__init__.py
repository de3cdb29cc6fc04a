"""Benchmark of controllers and agents on arms that none of them was made for: the same tasks, information and seeds for all.

`soft-tendon arena` plays it. The rules stand in conditions.py (settings, information regimes, difficulties) and protocol.py (who plays
what, how often), the numbers in scoring.py, the statistics in standings.py. docs/arena.md has the results.
"""
