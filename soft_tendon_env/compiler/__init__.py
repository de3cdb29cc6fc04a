"""Compiler of the kernels: decorators, calls between kernels, and the folder of machine code.

numba keeps the machine code in the folder.
"""
