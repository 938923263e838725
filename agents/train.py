"""Trains agents.

    python -m agents.train --config press_sac
    python -m agents.train --config configs/press_sac.yaml --set network.layers=[64,64] --seed 1 2 3
    python -m agents.train --resume runs/press_sac
    python -m agents.train --resume runs/press_sac --set total_steps=1_000_000

Everything is checked before anything is written. The last line of the output is the folder of the run.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.train import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.train"))
