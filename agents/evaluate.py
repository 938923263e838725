"""Evaluates a policy, and says how well it does.

    python -m agents.evaluate --env Spatula/Press-v0 --policy expert --engine batch --episodes 100 --seed 0 --json

The last line of the output is one JSON object with `--json`.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.evaluate import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.evaluate"))
