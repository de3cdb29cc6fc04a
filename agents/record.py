"""The same as `soft-tendon record`, from a clone: python agents/record.py --help."""

import sys

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main(["record", *sys.argv[1:]])
