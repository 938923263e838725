"""A device that replays a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.envs.steering import STEERING
from spatula_env.teleop.device import DeviceError, DeviceSample, TeleopDevice


class ReplayDevice(TeleopDevice):
    """Recorded actions as a rate device; at their end it stands still and holds "finish".

    If the tool was steered in every physics step, those commands are replayed rather than their mean per control step.

    Attributes:
        operator: Source of the recorded actions, "human" or "scripted".
    """

    kind = "rate"
    button_names = ("finish",)

    def __init__(self, actions: ArrayLike, operator: str = "human", tracks: ArrayLike | None = None) -> None:
        """Store the recording.

        Args:
            actions: (T, A) fractions of the greatest velocities.
            operator: Source of the actions.
            tracks: (T, S, A) actions of each physics step, NaN in control steps without steering; None if there was
                none.

        Raises:
            ValueError: If actions or tracks have another shape.
        """
        array = np.array(actions, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] < 3:
            raise ValueError(f"actions must have shape (T, A) with three columns at least, got {array.shape}")
        steered = None if tracks is None else np.array(tracks, dtype=np.float32)
        if steered is not None and (steered.ndim != 3 or steered[:, 0].shape != array.shape):
            raise ValueError(f"tracks must have shape (T, S, A) and fit actions {array.shape}, got {steered.shape}")
        self.name = "recording"
        self._tracks = steered
        self.operator = operator
        self._actions = array
        self._names: tuple[str, ...] = ()
        self._step = 0
        self._time = 0.0
        self._is_open = False

    @classmethod
    def from_dataset(cls, dataset_id: str, episode: int = 0, root: str | Path | None = None) -> ReplayDevice:
        """Make a device from an episode of a dataset.

        Args:
            dataset_id: Id of the dataset.
            episode: Number of the episode.
            root: Folder of all datasets; Minari's own by default.

        Raises:
            ImportError: If Minari is missing.
            FileNotFoundError: If there is no such dataset.
        """
        from spatula_env.data.replaying import open_dataset

        dataset = open_dataset(dataset_id, root)
        (recorded,) = dataset.iterate_episodes([episode])
        (metadata,) = dataset.storage.get_episode_metadata([episode])
        tracks = (recorded.infos or {}).get(STEERING)
        return cls(recorded.actions, str(metadata.get("operator", "human")), None if tracks is None else tracks[1:])

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._is_open

    def open(self) -> None:
        """See `TeleopDevice`; starts from the beginning."""
        self._is_open, self._step = True, 0

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """See `Watching`: a reset restarts the recording, and every step advances it."""
        made: Any = env.unwrapped
        self._names = made.control.names
        period = made.steps_per_action * made.simulation.dt
        self._step = round(made.simulation.time / period)
        self._time += period

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        if not self._is_open:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        over = self._step >= len(self._actions)
        buttons = frozenset({"finish"} if self._step >= len(self._actions) - 1 else ())
        rate = np.zeros(3) if over else self._actions[self._step, :3]
        return DeviceSample("rate", self._time, self._step + 1, None, rate, np.zeros(3), buttons)

    def steering(self) -> NDArray[np.float32] | None:
        """See `HasSteering`."""
        if self._tracks is None or self._step >= len(self._tracks) or np.isnan(self._tracks[self._step]).any():
            return None
        track: NDArray[np.float32] = self._tracks[self._step]
        return track

    def extra_rates(self) -> Mapping[str, float]:
        """See `HasExtraRates`."""
        if self._step >= len(self._actions):
            return {}
        return dict(zip(self._names[3:], self._actions[self._step, 3:].tolist(), strict=False))

    def close(self) -> None:
        """See `TeleopDevice`."""
        self._is_open = False

    def now(self) -> float:
        """The time of the episode [s]."""
        return self._time
