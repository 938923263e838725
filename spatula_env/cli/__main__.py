"""`python -m spatula_env.cli`: the `spatula` command."""

from __future__ import annotations

import sys

from spatula_env.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
