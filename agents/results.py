"""The documentation's training results: makes the runs, evaluates them, and writes the page.

    python -m agents.results                                             everything that `configs/results.yaml` plans
    python -m agents.results --tasks press --algorithms sac --seeds 0 1  a part of it
    python -m agents.results --page                                      only the page, from existing results

Finished work is not repeated; an interrupted run is resumed.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.results import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.results"))
