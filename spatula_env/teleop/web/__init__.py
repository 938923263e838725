"""Teleoperation in a browser: a page with the organ, a tool to drag, and buttons to record.

Modules::

    access              access control: tokens, cookies, origins
    page_server         serves the page, relays viser's messages, and receives those of the page's script
    operator_input      keys and mouse of all open pages
    page                viser's server behind the page server
    pressure_contours   pressure on the organ as filled contours
    scene_display       organ, tools and goal in the 3D view
    panel               bars, plot and settings beside it
    device              all of this as a `TeleopDevice`
    recording           records a page's episodes into datasets
    session             the tasks to choose from, and the actions of the page's buttons

Importing this package loads neither viser nor any physics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spatula_env.teleop.web.device import WebDevice
    from spatula_env.teleop.web.session import WebSession, serve

__all__ = ["WebDevice", "WebSession", "serve"]


def __getattr__(name: str) -> Any:
    """Import a module when one of its names is first accessed."""
    if name in __all__:
        return getattr(import_module(f"{__name__}.{'device' if name == 'WebDevice' else 'session'}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
