"""Converts runs of earlier versions, which kept pickles, to files that are read without running what they hold.

    python -m agents.convert runs/press_sac

To convert is to read the pickles once, and that runs whatever they hold. Convert what is your own, or from somebody
whom you would let run programs on this machine; nothing else does that.
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.convert import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.convert"))
