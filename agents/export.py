"""Exports policies as a few arrays that act without torch.

    python -m agents.export RUN OUTPUT.npz --episodes 100

`export_policy` converts a policy trained by Stable-Baselines3, with its normalisation, to a
`spatula_env.policies.ExportedPolicy`. Its actions are those that `model.predict(..., deterministic=True)` gives, up to
rounding.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.export import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.export"))
