"""The same as `soft-tendon demo`, from a clone: python agents/demo.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["demo", *sys.argv[1:]])
