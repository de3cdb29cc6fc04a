"""The same as `soft-tendon evaluate`, from a clone: python agents/evaluate.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["evaluate", *sys.argv[1:]])
