"""The same as `soft-tendon compare`, from a clone: python agents/compare.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["compare", *sys.argv[1:]])
