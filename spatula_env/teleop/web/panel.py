"""The page's side panel: task, status, measurements and settings."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import Any

from spatula_env.render.palette import FORCE
from spatula_env.teleop.web.gauges import Bars, Plot
from spatula_env.teleop.web.operator_input import hints
from spatula_env.teleop.web.readings import Reading, Status, colors_in_words, criteria_table

PLOT_EVERY = 2
"""Number of updates of the bars for each update of the plot."""
KEY_SPEED = 0.03
"""Initial speed of the tool when moved by keys [m/s]."""
TITLE = "Spatula"


class Panel:
    """Side panel of a page.

    Attributes:
        gui: viser's interface, for adding further elements.
        commands: Folder for buttons, between the goal and the instruments.
        view: Folder for settings of the view.
        jaws: Slider for the free width between the jaws [mm]; visible only if the tool has jaws.
    """

    def __init__(self, server: Any) -> None:
        """Add the panel to a page.

        Args:
            server: viser's server.
        """
        self.gui = gui = server.gui
        gui.set_panel_label(TITLE)
        theme(gui)
        gui.main_panel.dock_right()
        self._top = gui.add_html("")
        self.commands = gui.add_folder(None)
        self.jaws = gui.add_slider("Jaws [mm]", 0.0, 40.0, 0.5, 40.0, visible=False, hint="How far apart the jaws are")
        self._instruments = gui.add_html("")
        self._plot = Plot(gui)
        self.view = gui.add_folder("View and speed", expand_by_default=False)
        with self.view:
            self.speed = gui.add_slider("Key speed [mm/s]", 5, 100, 5, round(1e3 * KEY_SPEED))
            self.gizmo = gui.add_checkbox("Handles to drag by", True)
            self.see_through = gui.add_checkbox("See through the organ", False)
            self.home = gui.add_button("First view")
        self._hints = gui.add_html("")
        self._bars = Bars()
        self._shown = 0
        self._status = Status("Getting ready", "The first time, this takes a minute or two.")
        self._task = self._instruction = ""
        self._names: tuple[str, ...] = ()
        self._roles: tuple[str, ...] = ()
        self._buttons: tuple[tuple[str, str], ...] = ()
        self._reading = Reading(0.0, 0.0, 0.0)
        self._write()
        self._measure()

    @property
    def key_speed(self) -> float:
        """Speed of the tool when moved by keys [m/s]."""
        return 1e-3 * float(self.speed.value)

    def add_command(self, label: str, on_click: Callable[[], None], *, color: Any = None, hint: str = "") -> Any:
        """Add a button.

        Args:
            label: Text of the button.
            on_click: Called in one of viser's threads.
            color: Name of one of viser's colours.
            hint: Tooltip.

        Returns:
            viser's handle.
        """
        with self.commands:
            button = self.gui.add_button(label, color=color, hint=hint or None)

        button.on_click(lambda _: on_click())
        return button

    def explain(
        self,
        task: str,
        instruction: str,
        names: tuple[str, ...],
        roles: tuple[str, ...] = (),
        opening: tuple[float, float] | None = None,
    ) -> None:
        """Show what the task is, and how to do it.

        Args:
            task: Name of the task.
            instruction: The task in one sentence.
            names: Names of the action's components.
            roles: Roles of the marks in the picture; see `colors_in_words`.
            opening: Least and greatest width between the jaws [m]; None without jaws.
        """
        self._task, self._instruction, self._names, self._roles = task, instruction, names, roles
        self.jaws.visible = opening is not None
        if opening is not None:
            self.jaws.min, self.jaws.max = (1e3 * end for end in opening)
        self._write()
        self.hint(self._buttons)

    def hint(self, buttons: tuple[tuple[str, str], ...]) -> None:
        """Show which keys currently act as which buttons.

        Args:
            buttons: Names of keys with their descriptions.
        """
        self._buttons = buttons
        if self._names:
            content = hints(self._names, buttons)
            if content != self._hints.content:
                self._hints.content = content

    def say(self, status: Status) -> None:
        """Show the current status."""
        if status != self._status:
            self._status = status
            self._write()

    def add(self, reading: Reading) -> None:
        """Add a measurement, once per control step."""
        self._plot.add(reading)
        self._reading = reading

    def show(self) -> None:
        """Update bars and plot with the measurements so far."""
        if self._bars.grow(self._reading.force):
            self._plot.scale(self._bars.force_end)
        self._write()
        self._measure()
        self._shown += 1
        if self._shown % PLOT_EVERY == 0:
            self._plot.show()

    def show_opening(self) -> None:
        """Set the jaws' slider to their current width."""
        if self._reading.opening is None:
            return
        shown = round(2e3 * self._reading.opening) / 2.0
        shown = min(max(shown, float(self.jaws.min)), float(self.jaws.max))
        if shown != self.jaws.value:
            self.jaws.value = shown

    def _write(self) -> None:
        status = self._status
        dot = '<span class="dot">●</span> ' if status.recording else ""
        text, detail, instruction = (html.escape(each) for each in (status.text, status.detail, self._instruction))
        title = " – ".join(each for each in (f"● {status.text}" if status.recording else "", self._task, TITLE) if each)
        content = (
            f'<div class="sp sp-top" data-title="{html.escape(title)}">'
            f'<div class="state" role="status">{dot}{text}</div><div class="small">{detail}</div>'
        )
        if instruction:
            content += f'<div class="task">{instruction}</div>'
        if self._task:
            content += colors_in_words(self._roles) + criteria_table(self._reading)
        content += "</div>"
        if content != self._top.content:
            self._top.content = content

    def _measure(self) -> None:
        content = f'<div class="sp">{self._bars.content(self._reading)}</div>'
        if content != self._instruments.content:
            self._instruments.content = content


def theme(gui: Any, *, dark: bool = False) -> None:
    """Choose the colour theme.

    Args:
        gui: viser's interface, of all pages or of one.
        dark: Whether to use dark colours.
    """
    gui.configure_theme(
        control_width="medium",
        show_logo=False,
        show_share_button=False,
        dark_mode=dark,
        brand_color=tuple(round(255.0 * value) for value in FORCE),
    )
