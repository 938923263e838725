"""Evaluates a policy and reports the results.

    python -m agents.evaluate --env Spatula/Press-v0 --policy expert --engine batch --episodes 100 --seed 0 --json

With `--json`, the last line of the output is one JSON object.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.evaluate import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.evaluate"))
