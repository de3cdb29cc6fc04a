"""The same as `soft-tendon sweep`, from a clone: python agents/sweep.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["sweep", *sys.argv[1:]])
