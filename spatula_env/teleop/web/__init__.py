"""Teleoperation in a browser: a page with the organ, a tool to drag, and buttons to record.

Modules::

    access              who may open the page
    page_server         serves it, passes viser's messages on, and takes what the page's script sends
    operator_input      keys and mouse on all pages that are open
    page                viser's server with the page server in front
    pressure_contours   pressure on the organ as filled contours
    scene_display       organ, tools and goal in the view
    panel               bars, plot and settings beside it
    device              all that as a `TeleopDevice`
    recording           episodes on their way into datasets
    session             tasks to choose from, and what the page's buttons ask for

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
    """Import a module when something of it is first asked for."""
    if name in __all__:
        return getattr(import_module(f"{__name__}.{'device' if name == 'WebDevice' else 'session'}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
