"""The same as `soft-tendon reproduce-paper`, from a clone: python agents/reproduce_paper.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["reproduce-paper", *sys.argv[1:]])
