"""Converts runs of earlier versions, which used pickles, to files that are read without running code in them.

    python -m agents.convert runs/press_sac

Conversion reads the pickles once, which runs whatever code they hold. Convert only your own runs, or those of people
whose programs you would run on this machine; nothing else reads pickles.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.convert import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.convert"))
