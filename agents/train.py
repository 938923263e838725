"""Trains agents.

    python -m agents.train --config press_sac
    python -m agents.train --config configs/press_sac.yaml --set network.layers=[64,64] --seed 1 2 3
    python -m agents.train --resume runs/press_sac

The last line of the output is where the run is.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import yaml

from agents.command_line import choose_run, run_parser
from agents.configuration import read_training


def main(arguments: Sequence[str] | None = None) -> int:
    """Train.

    Args:
        arguments: What follows the module's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    parser = run_parser("python -m agents.train", "Train agents.", "hyperparameters.gamma=0.9")
    parser.add_argument("--seed", type=int, nargs="+", help="one agent is trained for each; default: those of the file")
    chosen = parser.parse_args(arguments)
    if chosen.resume is not None and (chosen.changes or chosen.seed or chosen.output):
        parser.error("--resume goes on as the run began: it takes neither --set, --seed nor --output")
    seeds = [f"seeds={chosen.seed}"] if chosen.seed else []
    try:
        output, config = choose_run(chosen, read_training, [*chosen.changes, *seeds])
    except (FileNotFoundError, ValueError, yaml.YAMLError) as error:
        return _fail(str(error))
    try:
        from agents.progress import ProgressView
        from agents.training import train, write_config
    except ImportError as error:
        return _fail(f"training needs {error.name}: pip install 'spatula-env[train]'")
    if chosen.resume is None:
        output.mkdir(parents=True, exist_ok=True)
        write_config(output, config)
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
