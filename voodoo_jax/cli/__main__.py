"""`python -m voodoo_jax.cli`: the command."""

import sys

from voodoo_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
