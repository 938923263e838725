"""Trains an agent with RLlib, on a cluster of Ray or on this machine alone.

    python -m agents.train_rllib --config rllib_press
    python -m agents.train_rllib --config rllib_press --address auto --set env_runners.count=16
    python -m agents.train_rllib --resume runs/rllib_press

The last line of the output is where the run is; `policy.npz` in it is what `agents.evaluate --policy` takes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import yaml

from agents.command_line import choose_run, run_parser
from agents.configuration import to_mapping
from agents.rllib_configuration import read_rllib
from agents.saving import write_text
from spatula_env.data.files import check_can_write
from spatula_env.installing import install_hint


def main(arguments: Sequence[str] | None = None) -> int:
    """Train.

    Args:
        arguments: What follows the module's name; None takes them from the command line.

    Returns:
        The exit status: 0 if all went well.
    """
    parser = run_parser("python -m agents.train_rllib", "Train an agent with RLlib.", "env_runners.count=4")
    parser.add_argument(
        "--address", help="of a cluster of Ray, 'auto' for one that runs here; default: one is started for the run"
    )
    chosen = parser.parse_args(arguments)
    if chosen.resume is not None and (chosen.changes or chosen.output):
        parser.error("--resume goes on as the run began: it takes neither --set nor --output")
    try:
        output, config = choose_run(chosen, read_rllib, chosen.changes, "env_runners")
        check_can_write(output)
    except (OSError, ValueError, yaml.YAMLError) as error:
        return _fail(str(error))
    try:
        import ray

        from agents.rllib_training import RLlibTrainer
    except ImportError as error:
        return _fail(f"training with RLlib needs {error.name}: {install_hint('ray')}")
    if chosen.resume is not None:
        print(
            "agents.train_rllib: RLlib's checkpoints are pickles, which run whatever they hold: go on with runs of "
            "your own only",
            file=sys.stderr,
        )
    else:
        write_text(output / "config.yaml", yaml.safe_dump(to_mapping(config), sort_keys=False))
    started = not ray.is_initialized()
    if started:
        ray.init(address=chosen.address, log_to_driver=False, logging_level="ERROR", include_dashboard=False)
    trainer: RLlibTrainer | None = None
    try:
        trainer = RLlibTrainer(config, output, (lambda text: None) if chosen.quiet else _say)
        trainer.run()
    except KeyboardInterrupt:
        return _fail(f"interrupted; go on with: python -m agents.train_rllib --resume {output}", 130)
    except ValueError as error:
        return _fail(str(error))
    finally:
        if trainer is not None:
            trainer.close()
        if started:
            ray.shutdown()
    print(output)
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


def _fail(message: str, status: int = 1) -> int:
    print(f"agents.train_rllib: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
