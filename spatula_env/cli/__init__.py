"""The `spatula` command: one module for each of its commands.

Modules::

    demo, envs, play, record, replay, datasets, falcon, view, bench, forward    the commands
    common      errors, options that several have, how results are printed
    devices     options of devices, and an open device
    acting      what acts where no operator does: experts, chance, trained policies
    showing     windows, pictures, films

A command imports what it needs when it runs, so that the others start quickly and work without its extras.
"""

from __future__ import annotations

from spatula_env.cli.main import main

__all__ = ["main"]
