"""Replay of recorded episodes: by their actions, which checks them, or by their states, which needs no physics."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.data.dataset import dataset_folder, read_layout, require_minari
from spatula_env.data.episode import STATE, physics_state
from spatula_env.data.files import DatasetDamaged
from spatula_env.data.index import SPECS, EpisodeEntry, check_harmless, read_index, read_metadata
from spatula_env.data.layout import KEY, Layout
from spatula_env.data.pictures import ENCODED, has_pictures, reads_plain_pictures
from spatula_env.data.specs import make_recorded, spec_from_json
from spatula_env.definitions import tell_definition
from spatula_env.envs.steering import STEERING
from spatula_env.files import checksum

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from spatula_env.arrays import FloatArray


TOLERANCE = 1e-9
"""Greatest difference of a position that counts as the same [u]."""


@dataclass(frozen=True)
class EpisodeReplay:
    """How a replay by actions compares with the recording.

    Attributes:
        episode: Number of the episode.
        steps: Number of steps.
        difference: Greatest difference from a recorded position or quaternion, beyond the precision in which it was
            recorded [u]; NaN if no states were recorded.
        reward_difference: Greatest difference from a recorded reward.
        matches: Whether both are within the tolerance; without states, the rewards.
        success: Whether the goal was reached in the replay.
    """

    episode: int
    steps: int
    difference: float
    reward_difference: float
    matches: bool
    success: bool


def open_dataset(dataset_id: str, root: str | Path | None = None) -> Any:
    """Open a recorded dataset, as ``minari.load_dataset`` does.

    Nothing outside the dataset is read: the file of an episode is checked when it is first read, so that opening a
    large dataset takes no longer than going through the list of its episodes.

    The dataset's ``recover_environment`` makes whatever environment the dataset names, and so may run code that the
    dataset chooses; `make_recorded` does not.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such dataset.
        ValueError: If it has pictures that the installed Minari does not read.
        DatasetDamaged: If it cannot be read, or not without running code or reading files outside it. Reading an
            episode or its metadata also raises this, if it applies to the episode.
    """
    minari, _ = require_minari()
    data = data_folder(dataset_id, root)
    unchecked = check_harmless(data)
    try:
        found = minari.MinariDataset(data)
    # Minari may raise any exception.
    except Exception as error:
        raise DatasetDamaged(f"{data} cannot be read: {error}") from error
    if not found.storage.metadata.get(ENCODED, True) and not reads_plain_pictures():
        if has_pictures(found.observation_space, found.action_space):
            raise ValueError(f"{dataset_id!r} has pictures that Minari 0.5.4 reads, which needs Python 3.11")
    if not unchecked:
        return found
    from spatula_env.data.reading import CheckedStorage

    return minari.MinariDataset(CheckedStorage(found.storage, unchecked))


def read_entries(dataset_id: str, root: str | Path | None = None) -> list[EpisodeEntry]:
    """Read the index's records of a dataset's episodes, without opening any.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
        DatasetDamaged: If a part of it is missing.
    """
    return read_index(data_folder(dataset_id, root))


def recorded_specs(dataset_id: str, root: str | Path | None = None) -> list[EnvSpec]:
    """The specifications of the environments of a dataset's episodes; `EpisodeEntry.spec` is an index into them.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
        DatasetDamaged: If its metadata cannot be read.
    """
    metadata = read_metadata(data_folder(dataset_id, root))
    return [spec_from_json(text) for text in (metadata.get(KEY) or {}).get(SPECS, [metadata.get("env_spec")])]


def replay(
    dataset_id: str,
    *,
    root: str | Path | None = None,
    episodes: Sequence[int] | None = None,
    tolerance: float = TOLERANCE,
    render_mode: str | None = None,
    env_id: str | None = None,
    wrappers: Sequence[type[gymnasium.Wrapper[Any, Any, Any, Any]]] = (),
    organ: str | Path | None = None,
    steering: bool = True,
    after_step: Callable[[gymnasium.Env[Any, Any], int], None] | None = None,
    progress: Callable[[EpisodeReplay], None] | None = None,
) -> list[EpisodeReplay]:
    """Repeat the recorded actions from the recorded seeds, and compare the results with the recording.

    With the same engine and the same version the results are the same; Bullet is deterministic. Each episode is
    repeated in the environment in which it was recorded, with the options it had.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.
        episodes: Numbers of the episodes; all by default.
        tolerance: Greatest difference that counts as the same [u].
        render_mode: Render mode of the environment; None: the recorded one, if its wrappers need pictures.
        env_id: The environment as "module:id", if it is one of your own that is not registered yet.
        wrappers: Wrappers that are allowed with whatever arguments the dataset gives, in addition to those of Gymnasium
            and of this package that write nothing.
        organ: The file of the organ on which the episodes were recorded; None: it is where it was then.
        steering: Whether to repeat the motion of each physics step, where that was recorded. False: only the actions
            that learners see, its mean in each control step, with which the results differ a little.
        after_step: Called with the environment and the step's number after the reset (0) and every step.
        progress: Called after each episode with its comparison.

    Returns:
        The comparison of each episode.

    Raises:
        ImportError: If Minari is missing, or PyBullet is and the episodes were recorded with it.
        FileNotFoundError: If there is no such dataset, or no file of the organ.
        DatasetDamaged: If the dataset cannot be read, or refers to data outside of it.
        ValueError: If an episode has no seed, its environment is not known here, a wrapper is not allowed, or the
            organ is another one than that of the episodes.
    """
    dataset = open_dataset(dataset_id, root)
    numbers = list(range(dataset.total_episodes)) if episodes is None else [int(number) for number in episodes]
    entries, specs = read_entries(dataset_id, root), recorded_specs(dataset_id, root)
    layout = read_layout(dataset_id, root)
    results = []
    env: gymnasium.Env[Any, Any] | None = None
    made: EnvSpec | None = None
    try:
        for number in numbers:
            spec = _spec_of(entries[number], specs)
            if env is None or spec != made:
                if env is not None:
                    env.close()
                definition = layout.definition_of(spec.id)
                here = _on_organ(spec, layout, organ)
                env, made = make_recorded(here, render_mode, env_id, wrappers, definition), spec
                tell_definition(f"dataset {dataset_id!r}", spec.id, definition)
                if env.action_space != dataset.action_space:
                    raise ValueError(f"the episodes of {dataset_id!r} have other actions than those of {spec.id}")
            (metadata,) = dataset.storage.get_episode_metadata([number])
            (recorded,) = dataset.iterate_episodes([number])
            _check_states(recorded, number)
            results.append(
                _repeat(
                    env, number, recorded, {**metadata, "seed": entries[number].seed}, tolerance, after_step, steering
                )
            )
            if progress is not None:
                progress(results[-1])
    finally:
        if env is not None:
            env.close()
    return results


def _on_organ(spec: EnvSpec, layout: Layout, organ: str | Path | None) -> EnvSpec:
    """The specification with the file of its organ here, which is checked to be that of the recording."""
    recorded = spec.kwargs.get("organ")
    if recorded is None:
        if organ is not None:
            raise ValueError(f"organ must be None: the episodes are of the task's own organ; got {str(organ)!r}")
        return spec
    path = Path(recorded if organ is None else organ)
    if not path.is_file():
        raise FileNotFoundError(
            f"organ must name the file of the organ on which the episodes were recorded, then {str(recorded)!r}; there "
            f"is no file {str(path)!r}"
        )
    if layout.organ and checksum(path) != layout.organ:
        raise ValueError(
            f"organ must be the file on which the episodes were recorded, with the checksum {layout.organ[:12]}...; "
            f"{str(path)!r} has {checksum(path)[:12]}..."
        )
    changed = copy.copy(spec)
    changed.kwargs = {**spec.kwargs, "organ": str(path)}
    return changed


def recorded_states(
    dataset_id: str, episode: int = 0, *, root: str | Path | None = None
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Iterate over the states of a recorded episode, for viewing without physics.

    Args:
        dataset_id: Its id.
        episode: Number of the episode.
        root: Folder of all datasets; Minari's own by default.

    Yields:
        Nodes (V, 3) of the organ, and positions and quaternions (N, 7) of the tools, in the scene [u].

    Raises:
        ValueError: If no states were recorded.
    """
    dataset = open_dataset(dataset_id, root)
    (recorded,) = dataset.iterate_episodes([episode])
    if STATE not in recorded.infos:
        raise ValueError(f"episode {episode} of {dataset_id!r} was recorded without states")
    states = recorded.infos[STATE]
    yield from zip(states["nodes"], states["tools"], strict=True)


def _spec_of(entry: EpisodeEntry, specs: Sequence[EnvSpec]) -> EnvSpec:
    """The specification with which the environment of an episode was made."""
    spec, engine = specs[entry.spec], entry.attributes.get("engine")
    if spec.kwargs.get("engine") is not None or engine is None:
        return spec
    # Older datasets do not name the engine in the specification, and the default here may be another one.
    named = copy.copy(spec)
    named.kwargs = {**spec.kwargs, "engine": engine}
    return named


def _check_states(recorded: Any, number: int) -> None:
    """Check that there are states of all steps of an episode, if there are any."""
    states = (recorded.infos or {}).get(STATE)
    if states is None:
        return
    rows = len(recorded.rewards) + 1
    kept: dict[str, Any] = states if isinstance(states, dict) else {}
    shapes = [getattr(kept.get(name), "shape", ()) for name in ("nodes", "tools")]
    if len(recorded.actions) != rows - 1 or any(shape[:1] != (rows,) for shape in shapes):
        raise DatasetDamaged(f"episode {number} is damaged: it has {rows - 1} steps, and states of another number")


def _repeat(
    env: gymnasium.Env[Any, Any],
    number: int,
    recorded: Any,
    metadata: dict[str, Any],
    tolerance: float,
    after_step: Callable[[gymnasium.Env[Any, Any], int], None] | None,
    steering: bool,
) -> EpisodeReplay:
    if metadata.get("seed") is None:
        raise ValueError(f"episode {number} has no seed, it cannot be repeated")
    simulation: Any = getattr(env.unwrapped, "simulation", None)
    states = recorded.infos.get(STATE) if recorded.infos and simulation is not None else None
    _, info = env.reset(seed=int(metadata["seed"]), options=metadata.get("options"))
    difference = _difference(simulation, states, 0)
    rewards = []
    if after_step is not None:
        after_step(env, 0)
    tracks = _tracks(recorded, env) if steering else None
    for step, action in enumerate(recorded.actions, start=1):
        track = None if tracks is None or np.isnan(tracks[step]).any() else tracks[step]
        _, reward, _, _, info = env.step(action) if track is None else _steered(env, action, track)
        rewards.append(float(reward))
        difference = max(difference, _difference(simulation, states, step))
        if after_step is not None:
            after_step(env, step)
    apart = float(np.abs(np.array(rewards) - recorded.rewards).max())
    return EpisodeReplay(
        episode=number,
        steps=len(rewards),
        difference=difference if states is not None else float("nan"),
        reward_difference=apart,
        matches=difference <= tolerance and apart <= tolerance,
        success=bool(info.get("is_success", False)),
    )


def _tracks(recorded: Any, env: gymnasium.Env[Any, Any]) -> NDArray[np.float32] | None:
    """(T + 1, S, A) motion in each physics step, if that was recorded."""
    tracks = (recorded.infos or {}).get(STEERING)
    if tracks is None or not hasattr(env.unwrapped, "steer"):
        return None
    made: Any = env.unwrapped
    wanted = (len(recorded.rewards) + 1, made.steps_per_action, made.control.size)
    if np.shape(tracks) != wanted:
        raise DatasetDamaged(f"{STEERING} must have shape {wanted}, it has {np.shape(tracks)}")
    return np.asarray(tracks, dtype=np.float32)


def _steered(env: gymnasium.Env[Any, Any], action: Any, track: NDArray[np.float32]) -> tuple[Any, ...]:
    """Make a control step in which the tools repeat the recorded motion of each physics step."""
    rows = iter(track)
    made: Any = env.unwrapped
    stop = made.steer(lambda _: next(rows))
    try:
        return env.step(action)
    finally:
        stop()


def _difference(simulation: Any, states: Any, step: int) -> float:
    if states is None:
        return 0.0
    now = physics_state(simulation)
    return max(_beyond_rounding(now[name], states[name][step]) for name in now)


def _beyond_rounding(now: FloatArray, recorded: NDArray[Any]) -> float:
    """The greatest difference of two arrays, less the rounding error of the recorded one."""
    rounding = 0.5 * np.spacing(np.abs(recorded)).astype(np.float64)
    apart = np.abs(now - recorded) - rounding
    # NaN in both counts as equal: both have diverged.
    apart[np.isnan(now) & np.isnan(recorded)] = 0.0
    return max(0.0, float(np.nan_to_num(apart, nan=np.inf).max()))


def data_folder(dataset_id: str, root: str | Path | None = None) -> Path:
    """The folder with the data of a dataset.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
    """
    data = dataset_folder(dataset_id, root) / "data"
    if not (data / "metadata.json").exists():
        raise FileNotFoundError(f"there is no dataset {dataset_id!r} in {data.parent}")
    return data
