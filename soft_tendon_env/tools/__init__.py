"""Tools of the whole package that know nothing of arms: argument validation, configuration, compilation of kernels and its cache."""
