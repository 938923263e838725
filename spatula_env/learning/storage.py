"""Storage of trained models in files that are read without running any code in them.

Stable-Baselines3 writes everything but numbers as pickles, and reading a pickle runs whatever code its writer put
there. Its own ``model.zip`` is still written, for its `load`; but only arrays, JSON and torch's weights are read here.
The model is built from the configuration of the run, as at the beginning of training, and then gets its weights.

    model.zip       Stable-Baselines3's file, of which the weights and the number of steps are read
    spaces.npz      spaces of observations and actions
    normalizer.npz  running estimates, if observations or rewards are normalised
    buffer.npz      in a checkpoint: the replay buffer's content
    state.json      in a checkpoint: the state of all random generators, and the progress of training

Needs the extra "train".
"""

from __future__ import annotations

import dataclasses
import io
import json
import random
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from spatula_env.learning.configuration import PPOConfig, TrainingConfig
from spatula_env.learning.models import make_model
from spatula_env.learning.networks import keep_pictures
from spatula_env.learning.replay import DemonstrationReplayBuffer

MODEL, SPACES, NORMALIZER = "model.zip", "spaces.npz", "normalizer.npz"
BUFFER, STATE = "buffer.npz", "state.json"
PICKLES = ("normalizer.pkl", "buffer.pkl", "state.pkl")
"""Files of earlier versions."""

COUNTERS = ("num_timesteps", "_total_timesteps", "_num_timesteps_at_start", "_episode_num", "_n_updates")
"""Counters of a model, which are plain numbers in Stable-Baselines3's file."""
LIMITS = ("clip_obs", "clip_reward", "gamma", "epsilon", "norm_obs", "norm_reward")
"""Constant settings of a normalisation, as opposed to its running estimates."""

Arrays = Mapping[str, NDArray[Any]]


class SpacesOnly(VecEnv):
    """An environment that only has spaces, to build a model where nothing is to be stepped."""

    def __init__(self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]) -> None:
        """Set the spaces."""
        super().__init__(1, observation_space, action_space)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Raise an error, as there are no worlds; except for the render mode, which Stable-Baselines3 asks for."""
        if attr_name == "render_mode":
            return [None]
        raise AttributeError(attr_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Always False, as there are no wrappers."""
        return [False]

    def close(self) -> None:
        """Nothing to do."""

    def reset(self) -> Any:
        """Not possible."""
        raise NotImplementedError

    def step_async(self, actions: Any) -> None:
        """Not possible."""
        raise NotImplementedError

    def step_wait(self) -> Any:
        """Not possible."""
        raise NotImplementedError

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible."""
        raise NotImplementedError

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **more: Any) -> list[Any]:
        """Not possible."""
        raise NotImplementedError


def write_model(place: Path, model: BaseAlgorithm, normalizer: VecNormalize | None) -> None:
    """Write what is needed to act.

    Args:
        place: A folder.
        model: The model in training.
        normalizer: Normalisation of its observations; None for none.
    """
    model.save(place / MODEL)
    arrays: dict[str, Any] = {}
    for name, space in _boxes(model.observation_space, "observation").items():
        arrays |= {f"{name}/low": space.low, f"{name}/high": space.high}
    assert isinstance(model.action_space, spaces.Box)
    arrays |= {"action/low": model.action_space.low, "action/high": model.action_space.high}
    np.savez_compressed(place / SPACES, **arrays)
    if normalizer is not None:
        write_normalizer(place, normalizer)


def read_model(folder: Path, config: TrainingConfig, env: VecEnv | None = None) -> BaseAlgorithm:
    """Rebuild a saved model, and load its weights.

    Args:
        folder: Folder of a policy or checkpoint.
        config: Configuration with which it was trained.
        env: Environment to train in; None to act only.

    Raises:
        ValueError: If the files are of an earlier version, or do not fit the configuration.
    """
    check_readable(folder)
    if env is None:
        env = keep_pictures(SpacesOnly(*read_spaces(folder)))
        chosen = config.hyperparameters
        # A model that only acts needs no space for experience.
        small: dict[str, Any] = {"n_steps": 2, "batch_size": 2} if isinstance(chosen, PPOConfig) else {"buffer_size": 1}
        config = dataclasses.replace(config, hyperparameters=dataclasses.replace(chosen, **small))
    model = make_model(config, env, config.seeds[0])
    weights, variables, counters = _read_archive(folder / MODEL)
    names, others = model._get_torch_save_params()
    try:
        if set(weights) != set(names) or not set(variables) <= set(others):
            raise ValueError(f"it has {sorted({*weights, *variables})}, not {sorted({*names, *others})}")
        model.set_parameters(weights, exact_match=True, device=model.device)
        for name, value in variables.items():
            if isinstance(value, torch.Tensor):
                getattr(model, name).data.copy_(value.data)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{folder / MODEL} does not fit its configuration: {error}") from error
    for name, count in counters.items():
        if hasattr(model, name):
            setattr(model, name, count)
    return model


def read_steps(folder: Path) -> int:
    """Number of steps for which a saved model was trained."""
    return _read_archive(folder / MODEL)[2].get("num_timesteps", 0)


def read_spaces(folder: Path) -> tuple[spaces.Space[Any], spaces.Box]:
    """The spaces of a saved model's observations and actions."""
    check_readable(folder)
    arrays = _read_arrays(folder / SPACES)
    boxes: dict[str, spaces.Box] = {}
    for name in (each.removesuffix("/low") for each in arrays if each.endswith("/low")):
        low, high = arrays[f"{name}/low"], arrays[f"{name}/high"]
        dtype: Any = low.dtype
        boxes[name] = spaces.Box(low, high, dtype=dtype)
    action = boxes.pop("action")
    if set(boxes) == {"observation"}:
        return boxes["observation"], action
    return spaces.Dict({name.partition("/")[2]: box for name, box in boxes.items()}), action


def write_normalizer(place: Path, normalizer: VecNormalize) -> None:
    """Write running estimates into a folder."""
    arrays: dict[str, Any] = {name: np.array(getattr(normalizer, name)) for name in LIMITS}
    if normalizer.norm_obs_keys is not None:
        arrays["norm_obs_keys"] = np.array(normalizer.norm_obs_keys, dtype=np.str_)
    for name, running in _estimates(normalizer).items():
        arrays |= {
            f"{name}/mean": running.mean,
            f"{name}/var": running.var,
            f"{name}/count": np.array(running.count, dtype=np.float64),
        }
    np.savez_compressed(place / NORMALIZER, **arrays)


def read_normalizer(folder: Path, env: VecNormalize | None = None) -> VecNormalize | None:
    """Read running estimates.

    Args:
        folder: Folder of a policy or checkpoint.
        env: Receives the estimates; None for a new normalisation without worlds.

    Returns:
        The normalisation; None if nothing was normalised.

    Raises:
        ValueError: If the files are of an earlier version, or do not fit.
    """
    check_readable(folder)
    if not (folder / NORMALIZER).exists():
        return None
    arrays = _read_arrays(folder / NORMALIZER)
    try:
        if env is None:
            keys = arrays.get("norm_obs_keys")
            env = VecNormalize(
                SpacesOnly(*read_spaces(folder)),
                training=False,
                norm_obs=bool(arrays["norm_obs"]),
                norm_reward=bool(arrays["norm_reward"]),
                norm_obs_keys=None if keys is None else [str(key) for key in keys],
            )
        for name in ("clip_obs", "clip_reward", "gamma", "epsilon"):
            setattr(env, name, float(arrays[name]))
        for name, running in _estimates(env).items():
            mean, variance = arrays[f"{name}/mean"], arrays[f"{name}/var"]
            if mean.shape != np.shape(running.mean) or variance.shape != np.shape(running.var):
                raise ValueError(f"{name} must have the shape {np.shape(running.mean)}, got {mean.shape}")
            running.mean, running.var, running.count = mean, variance, float(arrays[f"{name}/count"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{folder / NORMALIZER} does not fit its model: {error}") from error
    return env


def write_progress(place: Path, model: BaseAlgorithm, progress: Mapping[str, Any]) -> None:
    """Write what is needed to resume: replay buffer, state of all random generators, and progress."""
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None
        # Not compressed: it may be large, and is written often.
        np.savez(place / BUFFER, **buffer_arrays(model.replay_buffer))  # type: ignore[arg-type]
    version, words, place_in_words, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 - what batches are drawn with
    state = {
        "progress": dict(progress),
        "torch": torch.get_rng_state().tolist(),
        "numpy": [version, np.asarray(words).tolist(), place_in_words, has_gauss, gauss],
        "python": random.getstate(),
        "action_space": model.action_space.np_random.bit_generator.state,
    }
    (place / STATE).write_text(json.dumps(state, default=_plain), encoding="utf-8")


def read_progress(checkpoint: Path, model: BaseAlgorithm) -> dict[str, Any]:
    """Restore a model's replay buffer and the state of all random generators.

    Returns:
        The further values that were saved.

    Raises:
        ValueError: If the files are of an earlier version, or do not fit the model.
    """
    check_readable(checkpoint)
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None
        fill_from_arrays(model.replay_buffer, _read_arrays(checkpoint / BUFFER), str(checkpoint / BUFFER))
    try:
        state = json.loads((checkpoint / STATE).read_text(encoding="utf-8"))
        version, words, place_in_words, has_gauss, gauss = state["numpy"]
        python_version, python_words, python_gauss = state["python"]
        torch.set_rng_state(torch.tensor(state["torch"], dtype=torch.uint8))
        np.random.set_state(  # noqa: NPY002 - what batches are drawn with
            (version, np.array(words, dtype=np.uint32), place_in_words, has_gauss, gauss)
        )
        random.setstate((python_version, tuple(python_words), python_gauss))
        model.action_space.np_random.bit_generator.state = state["action_space"]
        progress: dict[str, Any] = state["progress"]
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{checkpoint / STATE} is no state of a training: {error}") from error
    return progress


def buffer_arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """Content of a replay buffer: all its numeric arrays, by name."""
    found: dict[str, NDArray[Any]] = {"pos": np.array(buffer.pos), "full": np.array(buffer.full), **_held(buffer)}
    if isinstance(buffer, DemonstrationReplayBuffer):
        if buffer.demonstrations is not None:
            shown = buffer_arrays(buffer.demonstrations)
            found |= {f"demonstrations/{name}": values for name, values in shown.items()}
        if buffer.imitated is not None:
            found |= {f"imitated/{name}": each for name, each in zip(("seen", "done"), buffer.imitated, strict=True)}
    return found


def fill_from_arrays(buffer: ReplayBuffer, arrays: Arrays, source: str) -> None:
    """Fill a replay buffer with the content of another one.

    Args:
        buffer: A buffer of the same size and kind.
        arrays: Arrays from `buffer_arrays`.
        source: Where they come from, for error messages.

    Raises:
        ValueError: If they do not fit.
    """
    for name, values in _held(buffer).items():
        given = arrays.get(name)
        if given is None or given.shape != values.shape or given.dtype != values.dtype:
            got = "nothing" if given is None else f"{given.dtype} {given.shape}"
            raise ValueError(f"{source} does not fit: {name} must be {values.dtype} {values.shape}, got {got}")
        values[...] = given
    buffer.pos, buffer.full = int(arrays["pos"]), bool(arrays["full"])
    if isinstance(buffer, DemonstrationReplayBuffer):
        shown = {
            name.partition("/")[2]: values for name, values in arrays.items() if name.startswith("demonstrations/")
        }
        if shown:
            transitions = shown["rewards"].shape[0] * buffer.n_envs
            fill_from_arrays(buffer.make_room(transitions), shown, source)
        if "imitated/seen" in arrays:
            buffer.imitated = (arrays["imitated/seen"], arrays["imitated/done"])


def check_readable(folder: Path) -> None:
    """Check that a folder was written by a version that uses no pickles.

    Raises:
        ValueError: If it was not; the message says how to convert it.
    """
    if not (folder / SPACES).exists():
        raise ValueError(
            f"{folder} was saved by an earlier version, as pickles, which run whatever they hold when they are read. "
            f"If it is your own, or you trust whoever made it: spatula convert {folder}"
        )


def _read_archive(file: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, int]]:
    """Read Stable-Baselines3's file: weights and optimiser states, other tensors, and counters."""
    weights: dict[str, Any] = {}
    variables: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(file) as archive:
            data = json.loads(archive.read("data"))
            for name in archive.namelist():
                if not name.endswith(".pth"):
                    continue
                content = torch.load(io.BytesIO(archive.read(name)), map_location="cpu", weights_only=True)
                if name == "pytorch_variables.pth":
                    variables = dict(content or {})
                else:
                    weights[name.removesuffix(".pth")] = content
    # Torch passes on errors of its weights reader: pickle's, and its own.
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{file} holds more than weights, or is damaged: {error}") from error
    counters = {name: data[name] for name in COUNTERS if isinstance(data, dict) and isinstance(data.get(name), int)}
    return weights, variables, counters


def _read_arrays(file: Path) -> dict[str, NDArray[Any]]:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except FileNotFoundError:
        raise
    except (EOFError, MemoryError, OSError, RuntimeError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{file} holds more than numbers, or is damaged: {error}") from error


def _boxes(space: spaces.Space[Any], name: str) -> dict[str, spaces.Box]:
    if isinstance(space, spaces.Dict):
        return {key: box for entry, one in space.spaces.items() for key, box in _boxes(one, f"{name}/{entry}").items()}
    assert isinstance(space, spaces.Box)
    return {name: space}


def _estimates(normalizer: VecNormalize) -> dict[str, Any]:
    """Running estimates of a normalisation, by name."""
    found: dict[str, Any] = {"returns": normalizer.ret_rms}
    if normalizer.norm_obs:
        observed: Any = normalizer.obs_rms
        found |= (
            {f"observations/{key}": each for key, each in observed.items()}
            if isinstance(observed, dict)
            else {"observations": observed}
        )
    return found


def _held(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """The numeric arrays of a buffer, not copied."""
    found: dict[str, NDArray[Any]] = {}
    for name, value in vars(buffer).items():
        entries = {f"{name}/{key}": each for key, each in value.items()} if isinstance(value, dict) else {name: value}
        found |= {key: each for key, each in entries.items() if isinstance(each, np.ndarray) and each.dtype != object}
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} cannot be kept")
