"""The command that trains an agent with RLlib: `python -m agents.train_rllib`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import yaml

from spatula_env.files import check_can_write, write_text
from spatula_env.installing import install_hint
from spatula_env.learning.commands.common import choose_run, fail, run_parser, warn
from spatula_env.learning.configuration import to_mapping
from spatula_env.learning.rllib_configuration import read_rllib

PROGRAM = "python -m spatula_env.learning.commands.train_rllib"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the command.

    Args:
        arguments: Arguments after the module's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = run_parser(program, "Train an agent with RLlib.", "env_runners.count=4")
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
        return fail(program, str(error))
    try:
        import ray

        from spatula_env.learning.rllib_training import RLlibTrainer
    except ImportError as error:
        return fail(program, f"training with RLlib needs {error.name}: {install_hint('ray')}")
    if chosen.resume is not None:
        warn(
            program,
            "RLlib's checkpoints are pickles, which run whatever they hold: go on with runs of your own only",
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
        return fail(program, f"interrupted; go on with: {program} --resume {output}", 130)
    except ValueError as error:
        return fail(program, str(error))
    finally:
        if trainer is not None:
            trainer.close()
        if started:
            ray.shutdown()
    print(output)
    return 0


def _say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
