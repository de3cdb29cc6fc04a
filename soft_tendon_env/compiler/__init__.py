"""Compiler of the kernels: one decorator, machine code that calls by symbols, and its cache on disk."""
