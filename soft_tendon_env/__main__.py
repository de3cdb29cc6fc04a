"""`python -m soft_tendon_env COMMAND`: the command line, see `soft_tendon_env.cli`."""

from soft_tendon_env.cli.main import main

if __name__ == "__main__":
    main()
