"""Trains an agent with RLlib, on a Ray cluster or on this machine alone.

    python -m agents.train_rllib --config rllib_press
    python -m agents.train_rllib --config rllib_press --address auto --set env_runners.count=16
    python -m agents.train_rllib --resume runs/rllib_press

The last line of the output is the folder of the run; pass its `policy.npz` to `agents.evaluate --policy`.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.train_rllib import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.train_rllib"))
