"""The same as `soft-tendon train`, from a clone: python agents/train.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["train", *sys.argv[1:]])
