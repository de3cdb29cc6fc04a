"""The command line: `soft-tendon COMMAND`, or `python -m soft_tendon_env COMMAND`."""
