"""Benchmark of controllers and agents on arms that none of them was made for: the same tasks, information and seeds for all.

`soft-tendon arena` plays it, an experiment of evaluation/. The rules stand in protocol.py (who plays what, how often), the conditions in
evaluation/conditions.py, the statistics in standings.py, the tables in page.py, the results in
docs/results/learned_against_model_based.md.
"""
