"""Tools of the whole package that know nothing of arms.

They are argument validation, configuration and files.
"""
