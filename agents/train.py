"""Trains agents.

    python -m agents.train --config press_sac
    python -m agents.train --config configs/press_sac.yaml --set network.layers=[64,64] --seed 1 2 3
    python -m agents.train --resume runs/press_sac

The last line of the output is where the run is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from agents.configuration import find_config, read_training, write_training


def main(arguments: Sequence[str] | None = None) -> int:
    """Train.

    Args:
        arguments: What follows the module's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    parser = argparse.ArgumentParser(prog="python -m agents.train", description="Train agents.")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--config", metavar="NAME", help="how to train: a YAML file, or the name of one in configs")
    what.add_argument("--resume", type=Path, metavar="DIR", help="go on with an interrupted run")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="changes",
        help="a change of the configuration, such as hyperparameters.gamma=0.9",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, nargs="+", help="one agent is trained for each; default: those of the file")
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/ and the file's name")
    parser.add_argument("--quiet", action="store_true", help="show nothing but where the run is")
    chosen = parser.parse_args(arguments)
    if chosen.resume is not None and (chosen.changes or chosen.seed or chosen.output):
        parser.error("--resume goes on as the run began: it takes neither --set, --seed nor --output")
    try:
        if chosen.resume is not None:
            output, config = chosen.resume, read_training(chosen.resume / "config.yaml")
        else:
            changes = list(chosen.changes)
            if chosen.seed:
                changes.append(f"seeds={chosen.seed}")
            file = find_config(chosen.config)
            config = read_training(file, changes)
            output = chosen.output or Path("runs") / file.stem
            if (output / "config.yaml").exists():
                raise ValueError(f"{output} holds a run already: go on with it (--resume) or name another (--output)")
    except (FileNotFoundError, ValueError, yaml.YAMLError) as error:
        return _fail(str(error))
    try:
        from agents.progress import ProgressView
        from agents.training import train
    except ImportError as error:
        return _fail(f"training needs {error.name}: pip install 'spatula-env[train]'")
    if chosen.resume is None:
        output.mkdir(parents=True, exist_ok=True)
        temporary = output / ".config.yaml.tmp"
        write_training(config, temporary)
        temporary.replace(output / "config.yaml")
    try:
        train(config, output, ProgressView(quiet=chosen.quiet))
    except KeyboardInterrupt:
        return _fail(f"interrupted; go on with: python -m agents.train --resume {output}", 130)
    except (TypeError, ValueError) as error:
        return _fail(str(error))
    print(output)
    return 0


def _fail(message: str, status: int = 1) -> int:
    print(f"agents.train: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
