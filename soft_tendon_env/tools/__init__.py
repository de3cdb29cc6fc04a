"""Tools of the whole package that know nothing of arms: argument validation, configuration, files."""
