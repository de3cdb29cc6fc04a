"""Compiler of the kernels: the decorators, how kernels call one another, and the folder in which
numba keeps the machine code."""
