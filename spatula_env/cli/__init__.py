"""The `spatula` command: one module for each of its commands.

Modules::

    demo, envs, play, record, replay, datasets, falcon, view, bench, forward    the commands
    common      errors, shared options, printing of results
    devices     options of devices, and an open device
    acting      policies that act in place of an operator: experts, random actions, trained policies
    showing     windows, pictures, films

A command imports what it needs when it runs, so that the others start quickly and work without its extras.
"""

from __future__ import annotations

from spatula_env.cli.main import main

__all__ = ["main"]
