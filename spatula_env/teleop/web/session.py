"""A session of playing and recording on a page, including the actions of the page's buttons."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium

from spatula_env.teleop.buttons import DISCARD, FINISH, QUIT
from spatula_env.teleop.recording import RecordingSummary
from spatula_env.teleop.session import EpisodeSummary, run_episode
from spatula_env.teleop.web.device import WebDevice
from spatula_env.teleop.web.readings import Status
from spatula_env.teleop.web.recording import PageEpisode, PageRecording, RecordingOptions
from spatula_env.teleop.wrapper import FalconTeleop

RECORD, SAVE, SUCCESS, RESET, TASK = "record", "save", "success", "reset", "task"
"""Requests of the page's buttons, besides "discard" and "quit"."""
VERDICTS = (SAVE, SUCCESS, DISCARD)
"""Possible decisions about a recorded episode."""

KEYS_WAITING = (("Enter", "record"),)
KEYS_RECORDING = (("Enter", "save"), ("Backspace", "discard"))
"""Keys that act as buttons, while nothing is being recorded and while something is."""

PRACTICE = "Nothing is recorded, and there is no limit of time."
MESSAGE_TIME = 8.0
"""Time for which the result of the last recording is shown [s]."""

LOOKING = 0.2
"""Interval at which a waiting session checks whether it is to end [s]."""


class WebSession:
    """A page on which tasks are played and episodes recorded.

    Physics runs in a thread of its own. It pauses while no page is visible, so that nothing is lost when a browser
    disconnects in the middle of an episode.

    There is no time limit while an episode is not recorded.

    Attributes:
        env_id: Id of the current task.
        env: Environment of the current task; None while there is none.
        recording: The episodes recorded so far.
    """

    def __init__(
        self,
        env_id: str,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        token: str | None = None,
        dataset: str | Path | None = None,
        seed: int | None = None,
        env_kwargs: Mapping[str, Any] | None = None,
        real_time: bool = True,
        root: Path | None = None,
        recording: RecordingOptions | None = None,
        progress: Callable[[str, EpisodeSummary], None] | None = None,
    ) -> None:
        """Store the settings of the session; `start` serves the page.

        Args:
            env_id: Id of the first task, one of `task_ids`.
            host: Address at which the page is served.
            port: Port to listen on; 0 for any that is free.
            token: Token required to open the page; None for none, which is allowed on a loopback address only.
            dataset: A string is the id of the dataset to add to, in which ``{task}`` stands for the task's name;
                without ``{task}``, it is used for the first task only. A `Path` is the folder of all datasets. By
                default, ``spatula/{task}/web-v0`` in Minari's own folder.
            seed: Seed of the first episode; the others continue from it.
            env_kwargs: Arguments with which all environments are made.
            real_time: Whether simulated time is limited to the speed of real time.
            root: Folder of all datasets, if `dataset` is an id; Minari's own by default.
            recording: How episodes are recorded; None for the defaults.
            progress: Called after each episode with its outcome, "recorded", "discarded" or "practice"; in the
                session's thread.

        Raises:
            ImportError: If viser is missing.
            ValueError: If the task does not exist, a token is required and missing, or Minari does not accept the
                dataset's name.
        """
        self.env_id = find_task(env_id)
        self.env: Any = None
        self._first_id = self.env_id
        self.recording = PageRecording(
            self.env_id,
            RecordingOptions() if recording is None else recording,
            dataset=dataset if isinstance(dataset, str) else None,
            root=dataset if isinstance(dataset, Path) else root,
            seed=0 if seed is None else seed,
        )
        self._progress: Callable[[str, EpisodeSummary], None] = progress or (lambda fate, summary: None)
        self._first_seed = seed
        self._options = dict(env_kwargs or {})
        self._real_time = real_time
        keys: dict[str, Callable[[], None]] = {"Enter": self._on_enter, "Backspace": partial(self._ask, DISCARD)}
        self._device = WebDevice(host=host, port=port, token=token, shortcuts=keys)
        self._asked = Asked()
        self._stopping = threading.Event()
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()
        self._status = Status("Waiting")
        self._recording = self._moved = False
        self._said = ""

    @property
    def url(self) -> str:
        """URL to open in a browser on this machine, with the token."""
        return self._device.url

    @property
    def saved(self) -> int:
        """Number of episodes added to datasets."""
        return self.recording.recorded

    @property
    def device(self) -> WebDevice:
        """The page as a device."""
        return self._device

    def start(self) -> None:
        """Serve the page, and begin to play when it is visible in a browser.

        Raises:
            ImportError: If viser is missing.
            DeviceBusy: If the port is taken.
        """
        self._device.open()
        self._furnish()
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name="web session", daemon=True)
        self._thread.start()

    def wait(self, timeout: float | None = None) -> None:
        """Wait until the session ends by itself, which happens only after an error or when all is recorded.

        Args:
            timeout: Longest time to wait [s].

        Raises:
            Exception: The error that ended it.
        """
        # Not by joining: up to Python 3.12, Ctrl-C in a join leaves the thread marked as ended while it still runs.
        if self._thread is not None:
            self._ended.wait(timeout)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End the session. An episode that is being recorded is saved up to this point. Stopping twice is allowed."""
        self._stopping.set()
        self._asked.put(QUIT)
        if self._thread is not None:
            self._thread.join()
        self._device.close()

    def __enter__(self) -> WebSession:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # The page's controls. Their callbacks run in other threads, and only put requests.

    def _furnish(self) -> None:
        panel = self._device.panel
        assert panel is not None
        with panel.commands:
            self._choice = panel.gui.add_dropdown("Task", task_ids(), initial_value=self.env_id)

        self._choice.on_update(self._on_choice)
        buttons = (
            (RECORD, "● Record an episode", "red", "A new one begins (Enter)"),
            (SAVE, "Save", "blue", "The episode ends here, and is kept (Enter)"),
            (SUCCESS, "Success", "green", "It ends, is kept, and was a success"),
            (DISCARD, "Discard", "gray", "It ends, and counts for nothing (Backspace)"),
            (RESET, "New episode", "gray", "Without recording it"),
        )
        self._buttons = {
            what: panel.add_command(label, partial(self._ask, what), color=color, hint=hint)
            for what, label, color, hint in buttons
        }
        self._offer()

    def _ask(self, what: str) -> None:
        # Ignore a second click on a button that is about to disappear.
        if (what in VERDICTS) == self._recording:
            self._asked.put(what)

    def _on_choice(self, event: Any) -> None:
        if event.client is not None:
            self._ask(TASK)

    def _on_enter(self) -> None:
        self._ask(SAVE if self._recording else RECORD)

    def _offer(self) -> None:
        """Show the buttons that apply now."""
        for name, button in self._buttons.items():
            button.visible = (name in VERDICTS) == self._recording
        self._choice.visible = not self._recording
        assert self._device.panel is not None
        self._device.panel.hint(KEYS_RECORDING if self._recording else KEYS_WAITING)

    def _say(self, text: str, detail: str = "") -> None:
        self._status = Status(text, detail, self._recording)
        assert self._device.panel is not None
        self._device.panel.say(self._status)

    def _tell(self, title: str, text: str, color: str | None = None) -> None:
        self._said = text
        if self._device.page is not None:
            self._device.page.notify(title, text, color=color)

    # The following run in the session's thread.

    def _run(self) -> None:
        try:
            with ExitStack() as claims:
                while not self._stopping.is_set():
                    self._play_task(claims)
        except BaseException as error:
            self._failure = error
            with suppress(Exception):
                self._say("It has ended", f"{type(error).__name__}: {error}")
        finally:
            self._ended.set()

    def _play_task(self, claims: ExitStack) -> None:
        self._say("Getting ready", f"{self.env_id} is being loaded; the first time, this takes a minute or two.")
        try:
            self.env = gymnasium.make(self.env_id, **self._options)
        except Exception as error:
            if self.env_id == self._first_id:
                raise
            self._tell(self.env_id, str(error), "red")
            self.env_id = self._choice.value = self._first_id
            return
        try:
            if self.recording.options.exclusive and not self.recording.claimed:
                claims.enter_context(self.recording.claim(self.env))
            # Practice has no time limit: neither Gymnasium's nor the environment's own.
            practice, timed = (
                FalconTeleop(env, self._device, real_time=self._real_time) for env in (self.env.unwrapped, self.env)
            )
            seed = self._first_seed
            while not self._stopping.is_set():
                assert self._device.page is not None
                self._device.page.take_focus()
                asked = self._asked.take()
                if asked == RECORD:
                    self._record(timed)
                    continue
                if asked == TASK and self._take_choice():
                    break
                self._say("Practice", self._said or PRACTICE)
                with _Mishaps(self), _no_limit(self.env.unwrapped):
                    ends = self.recording.options.end_on_success
                    practised = run_episode(practice, seed=seed, end_on_success=ends, after_step=self._after_practice)
                    self._progress("practice", practised)
                    # The message is about the episode before this one.
                    self._said = ""
                seed = None
        finally:
            env, self.env = self.env, None
            env.close()

    def _take_choice(self) -> bool:
        """Switch to the task chosen on the page, if it is one of those offered."""
        # The page's data are untrusted, and `gymnasium.make` imports the module named before a colon.
        chosen = str(self._choice.value)
        if chosen not in task_ids():
            # Reset the choice before the refusal is shown, as the user may then choose again.
            self._choice.value = self.env_id
            self._tell("Not a task", f"There is no task {chosen[:80]!r} here.", "red")
            return False
        self.env_id = chosen
        return True

    def _after_practice(self, observation: Any, info: dict[str, Any]) -> None:
        self._pause()
        if self._said and info["time"] > MESSAGE_TIME:
            self._said = ""
            self._say("Practice", PRACTICE)
        self._press_if_asked(QUIT, info)

    def _pause(self) -> None:
        """Wait while no page is visible."""
        page = self._device.page
        assert page is not None
        if page.operator_input.present:
            return
        before = self._status
        self._say("Paused", "Nobody looks at the page.")
        while not (self._stopping.is_set() or page.operator_input.wait(LOOKING)):
            pass
        self._say(before.text, before.detail)

    # Recording.

    def _record(self, env: FalconTeleop) -> None:
        # ImportError if Minari is missing, ValueError if the dataset belongs to another environment, OSError if it
        # cannot be written or if another program records into it.
        with (
            _Mishaps(self, ImportError, OSError, ValueError),
            self.recording.episode(env, self.env_id) as episode,
        ):
            self._recording, self._moved = True, False
            self._asked.take()
            self._offer()
            try:
                summary = run_episode(
                    env,
                    seed=episode.seed,
                    recorder=episode.recorder,
                    end_on_success=self.recording.options.end_on_success,
                    after_step=self._after_recorded,
                )
                self._judge(episode, summary)
            finally:
                self._recording = False
                self._offer()
        if self.recording.done:
            self._tell("Done", f"All is recorded: {self.saved} episodes were saved.", "green")
            self._stopping.set()
            self._asked.put(QUIT)

    def dataset_id(self, env_id: str) -> str:
        """The dataset that episodes of a task are added to."""
        return self.recording.dataset_id(env_id)

    def _after_recorded(self, observation: Any, info: dict[str, Any]) -> None:
        limit = getattr(self.env.spec, "max_episode_steps", None)
        made = self.env.unwrapped
        end = "" if limit is None else f" of {limit * made.steps_per_action * made.simulation.dt:.0f}"
        if info["time"] == 0.0:
            self._say("Ready", "The episode begins when you move the tool.")
            self._until_moved()
        limit_said = "" if limit is None else f"It ends after{end.removeprefix(' of')} s, or with a button. "
        self._say(f"Recording {info['time']:.1f}{end} s", f"{limit_said}It goes to {self.dataset_id(self.env_id)}.")
        self._pause()
        self._press_if_asked(FINISH, info)

    def _press_if_asked(self, button: str, info: dict[str, Any]) -> None:
        """End the episode if there is a request, so that a control step includes only what was requested before it.

        Not before the first step: a button that ended the last episode counts only after a step in which it is
        released.
        """
        if self._asked.what is not None and info["time"] > 0.0:
            self._device.press(button)

    def _until_moved(self) -> None:
        page = self._device.page
        assert page is not None
        while not (self._stopping.is_set() or page.operator_input.active or self._asked.what is not None):
            self._asked.wait(0.02)
        self._moved = page.operator_input.active

    def _verdict(self) -> str:
        """Wait for the decision about the episode that has just ended."""
        self._device.refresh()
        while True:
            asked = self._asked.take()
            if asked in (*VERDICTS, QUIT):
                return asked
            self._say("The episode is over", "It is recorded to its end, and not saved yet: Save, Success or Discard?")
            self._asked.wait(LOOKING)

    def _judge(self, episode: PageEpisode, summary: EpisodeSummary) -> None:
        """Save or discard the episode that has just ended."""
        verdict = self._verdict()
        said = ""
        if verdict == DISCARD or not self._moved:
            episode.discard()
            self._tell("Discarded", "The episode was not kept.")
        else:
            said = episode.save(summary, operator_success=verdict == SUCCESS, interrupted=verdict == QUIT)
            if said:
                self._tell("Saved", said, "green")
            else:
                self._tell("Discarded", "The episode did not reach its goal, and only those that do are kept.")
        self._progress("recorded" if said else "discarded", summary)


class Asked:
    """The latest request of the page's buttons."""

    def __init__(self) -> None:
        """Start without a request."""
        self._condition = threading.Condition()
        self._what: str | None = None

    @property
    def what(self) -> str | None:
        """The request; None if there is none."""
        with self._condition:
            return self._what

    def put(self, what: str) -> None:
        """Put a request. No other request replaces "quit"."""
        with self._condition:
            if self._what != QUIT:
                self._what = what
            self._condition.notify_all()

    def take(self) -> str | None:
        """Return the request and remove it, unless it is "quit"."""
        with self._condition:
            what = self._what
            if what != QUIT:
                self._what = None
            return what

    def wait(self, timeout: float) -> None:
        """Wait until there is a request, or some time has passed [s]."""
        with self._condition:
            if self._what is None:
                self._condition.wait(timeout)


class _Mishaps:
    """Context in which errors are shown on the page instead of ending the session."""

    def __init__(self, session: WebSession, *kinds: type[Exception]) -> None:
        self._session, self._kinds = session, kinds

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> bool:
        from spatula_env.sim.simulation import SimulationDiverged

        if isinstance(error, (SimulationDiverged, *self._kinds)):
            if self._session._stopping.is_set():
                # No page is visible any more, so the error has to end the session.
                self._session._failure = error
            self._session._tell("Something went wrong", str(error), "red")
            return True
        return False


@contextmanager
def _no_limit(made: Any) -> Iterator[None]:
    """Remove an environment's own time limit while a context is active."""
    limit, made._max_episode_steps = made._max_episode_steps, None
    try:
        yield
    finally:
        made._max_episode_steps = limit


def task_ids() -> list[str]:
    """Ids of all registered tasks."""
    return [name for name in gymnasium.registry if name.startswith("Spatula/")]


def find_task(env_id: str) -> str:
    """Id of a task, without the module that registers it.

    Args:
        env_id: Id as `gymnasium.make` takes it.

    Raises:
        ValueError: If the task does not exist.
    """
    name = env_id.rpartition(":")[2]
    if name not in task_ids():
        raise ValueError(f"env_id must be one of {task_ids()}, got {env_id!r}")
    return name


def serve(
    env_id: str,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    dataset: str | Path | None = None,
    seed: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    on_ready: Callable[[str], None] | None = None,
    real_time: bool = True,
    root: Path | None = None,
    recording: RecordingOptions | None = None,
    progress: Callable[[str, EpisodeSummary], None] | None = None,
) -> RecordingSummary:
    """Serve a page on which a task is played and recorded, until Ctrl-C or until all requested episodes are recorded.

    An episode that is being recorded at that time is saved up to this point.

    Args:
        env_id: Id of the first task.
        host: Address at which the page is served.
        port: Port to listen on; 0 for any that is free.
        token: Token required to open the page; None for none, which is allowed on a loopback address only.
        dataset: See `WebSession`.
        seed: Seed of the first episode; the others continue from it.
        env_kwargs: Arguments with which the environments are made.
        on_ready: Called with the address when the page can be opened.
        real_time: Whether simulated time is limited to the speed of real time.
        root: Folder of all datasets, if `dataset` is an id.
        recording: How episodes are recorded; None for the defaults.
        progress: See `WebSession`.

    Returns:
        Summary of the recording.

    Raises:
        ImportError: If viser is missing.
        ValueError: If the task does not exist, a token is required and missing, or the dataset does not accept the
            task's episodes.
        DeviceBusy: If the port is taken.
        DatasetBusy: If another program records into the dataset.
        OSError: If the dataset cannot be written to.
    """
    session = WebSession(
        env_id,
        host=host,
        port=port,
        token=token,
        dataset=dataset,
        seed=seed,
        env_kwargs=env_kwargs,
        real_time=real_time,
        root=root,
        recording=recording,
        progress=progress,
    )
    with session, suppress(KeyboardInterrupt):
        if on_ready is not None:
            on_ready(session.url)
        session.wait()
    # Raises an error that kept an episode from being saved.
    session.wait(0.0)
    return session.recording.summary()
