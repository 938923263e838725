"""What the documentation says of training: runs, evaluations, and the page that is made of them.

    python -m agents.results                                             what `configs/results.yaml` plans
    python -m agents.results --tasks press --algorithms sac --seeds 0 1  a part of it
    python -m agents.results --page                                      the page alone, of what there is

What is finished is not done again; a run that was killed is gone on with.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.results import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.results"))
