"""The command that converts runs of earlier versions: `spatula convert`, or `python -m agents.convert`."""

from __future__ import annotations

import argparse
import pickle
import random
import shutil
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from spatula_env.learning.saving import write_folder

PROGRAM = "spatula convert"

MOVED = ("networks", "replay")
"""Modules whose classes such runs refer to by their former place under `agents`."""


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the command.

    Args:
        arguments: Arguments after the command's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = argparse.ArgumentParser(
        prog=program, description="Convert runs of earlier versions. This runs whatever code their files hold."
    )
    parser.add_argument("run", type=Path, nargs="+", help="folder of a run, or of one of its policies or checkpoints")
    parser.add_argument("--yes", action="store_true", help="do not ask whether the files are to be trusted")
    chosen = parser.parse_args(arguments)
    try:
        folders = [folder for run in chosen.run for folder in find_pickled(run)]
    except FileNotFoundError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    if not folders:
        print("nothing to convert")
        return 0
    print("\n".join(str(folder) for folder in folders))
    if not chosen.yes:
        print(
            "To convert these runs whatever code they hold. Do you trust whoever made them? [y/N] ", end="", flush=True
        )
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            print("nothing was read", file=sys.stderr)
            return 1
    for folder in folders:
        convert(folder)
        print(f"converted {folder}")
    return 0


def find_pickled(run: Path) -> list[Path]:
    """Folders of policies and checkpoints that earlier versions wrote.

    Raises:
        FileNotFoundError: If there is no such folder.
    """
    from spatula_env.learning.storage import MODEL, SPACES

    if not run.is_dir():
        raise FileNotFoundError(f"there is no folder {run}")
    found = [file.parent for file in sorted(run.rglob(MODEL)) if not (file.parent / SPACES).exists()]
    return [folder for folder in found if not any(part.startswith(".") for part in folder.relative_to(run).parts)]


def convert(folder: Path) -> None:
    """Convert a policy or a checkpoint atomically. This runs whatever code its files hold.

    Args:
        folder: Folder of the policy or checkpoint.
    """
    import numpy as np
    import torch
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    import spatula_env.learning
    from spatula_env.learning.models import algorithm_class
    from spatula_env.learning.saving import read_saved_config
    from spatula_env.learning.storage import MODEL, PICKLES, write_model, write_progress

    sys.modules.setdefault("agents", spatula_env.learning)
    for name in MOVED:
        sys.modules.setdefault(f"agents.{name}", import_module(f"spatula_env.learning.{name}"))
    # The model is only needed to act: no replay buffer is needed, and hindsight replay could not be set up without
    # worlds.
    acting: dict[str, Any] = {"buffer_size": 1, "replay_buffer_class": None, "replay_buffer_kwargs": {}}
    model: Any = algorithm_class(read_saved_config(folder)).load(folder / MODEL, device="cpu", custom_objects=acting)
    loaded = {name: pickle.loads((folder / name).read_bytes()) for name in PICKLES if (folder / name).exists()}

    def fill(place: Path) -> None:
        for file in folder.iterdir():
            if file.is_file() and file.name not in PICKLES:
                shutil.copy2(file, place / file.name)
        write_model(place, model, loaded.get("normalizer.pkl"))
        # Keep the original file, from which Stable-Baselines3 can load the model.
        shutil.copy2(folder / MODEL, place / MODEL)
        state = loaded.get("state.pkl")
        if state is None:
            return
        if isinstance(model, OffPolicyAlgorithm):
            model.replay_buffer = loaded["buffer.pkl"]
        before = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002 - that is what is kept
        try:
            torch.set_rng_state(state["torch"])
            np.random.set_state(state["numpy"])  # noqa: NPY002
            random.setstate(state["python"])
            model.action_space = state["action_space"]
            write_progress(place, model, state["progress"])
        finally:
            torch.set_rng_state(before[0])
            np.random.set_state(before[1])  # noqa: NPY002
            random.setstate(before[2])

    write_folder(folder, fill)
