"""Options of devices, and an open device."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from spatula_env.changes import with_changes
from spatula_env.cli.acting import POLICY_HELP, Actor, find_actor
from spatula_env.cli.common import CommandError, at_least, engine_option, note, resolve_env
from spatula_env.cli.forces import HAPTIC, HELD, add_force_options, force_settings, read_buttons, tell_loop
from spatula_env.naming import same_environment
from spatula_env.teleop.web.access import find_token

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.teleop.device import TeleopDevice
    from spatula_env.teleop.recording import RecordingSummary
    from spatula_env.teleop.session import EpisodeSummary
    from spatula_env.teleop.web.recording import RecordingOptions

DEVICES = (
    "keyboard",
    "gamepad",
    "spacemouse",
    "falcon",
    "forcedimension",
    "emulated-falcon",
    "scripted",
    "scripted-falcon",
    "replay",
    "web",
)
"""Names that --device accepts. All but the last two are in `spatula_env.teleop.registry`."""
SCRIPTED = ("scripted", "scripted-falcon")
POSITIONS = ("falcon", "forcedimension", "emulated-falcon", "scripted-falcon")
"""Devices whose grip has a position; the others give a velocity."""
APPLICABLE: Mapping[str, tuple[Any, tuple[str, ...]]] = MappingProxyType(
    {
        "index": (0, ("gamepad", "spacemouse", "falcon")),
        "firmware": (None, ("falcon",)),
        "recording": (None, ("replay",)),
        "episode": (0, ("replay",)),
        "reaction_delay": (None, SCRIPTED),
        "tremor": (None, SCRIPTED),
        "gain": (None, SCRIPTED),
        "host": ("127.0.0.1", ("web",)),
        "port": (8080, ("web",)),
        "token": (None, ("web",)),
        "token_file": (None, ("web",)),
        "force_scale": (None, HAPTIC),
        "coupling": (None, HAPTIC),
        "grip_weight": (None, HAPTIC),
        "no_force": (False, HAPTIC),
        "haptics": (False, HAPTIC),
        "no_centring": (False, HELD),
        "buttons": (None, ("falcon", "forcedimension", "emulated-falcon", "gamepad", "spacemouse", "keyboard")),
    }
)
"""Options that apply to some devices only: their defaults, and those devices."""


def add_device_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of devices."""
    group = parser.add_argument_group("device")
    group.add_argument(
        "--device",
        required=True,
        choices=DEVICES,
        metavar="NAME",
        help=f"what the operator holds, or who acts instead: {', '.join(DEVICES)}",
    )
    group.add_argument(
        "--index", metavar="N", type=at_least(0), default=0, help="which one, if there are several (default: 0)"
    )
    group.add_argument(
        "--firmware", type=Path, metavar="FILE", help="the Falcon's firmware, if it has forgotten it (docs/falcon.md)"
    )
    group.add_argument("--recording", metavar="DATASET", help="what --device replay does again")
    group.add_argument("--episode", metavar="N", type=at_least(0), default=0, help="which episode of it (default: 0)")
    group.add_argument("--policy", help=f"what a scripted operator wants, or what acts in between: {POLICY_HELP}")
    group.add_argument("--reaction-delay", type=float, metavar="S", help="of a scripted operator")
    group.add_argument("--tremor", type=float, metavar="SHARE", help="of a scripted operator, of the greatest speed")
    group.add_argument("--gain", type=float, metavar="FACTOR", help="of a scripted operator, up to 1")
    web = parser.add_argument_group("web page (--device web)")
    web.add_argument("--host", default="127.0.0.1", help="address to serve at (default: %(default)s)")
    web.add_argument("--port", metavar="N", type=at_least(0, 65535), default=8080, help="(default: %(default)s)")
    secret = web.add_mutually_exclusive_group()
    secret.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="that holds what a visitor has to know; needed where other machines reach the page. The environment "
        "variable SPATULA_TOKEN does as well",
    )
    secret.add_argument("--token", help="the same as it is, for all who use this machine to see")
    add_force_options(parser)
    hand = parser.add_argument_group("from the hand to the tool")
    hand.add_argument(
        "--mode",
        choices=("auto", "position", "rate"),
        default="auto",
        help="whether the tool is where the grip is, or moves as fast as it is deflected (default: %(default)s)",
    )
    hand.add_argument(
        "--scale", metavar="FACTOR", type=float, default=1.0, help="way of the tool over way of the grip (default: 1)"
    )
    hand.add_argument(
        "--intervention",
        choices=("always", "button", "motion"),
        default="always",
        help="when the operator acts, and not --policy (default: %(default)s)",
    )
    hand.add_argument(
        "--no-wait", action="store_true", help="run as fast as the machine can, and not in time with the clock"
    )


def teleop_options(chosen: argparse.Namespace) -> dict[str, Any]:
    """The arguments with which `FalconTeleop` is made."""
    # Devices that no human holds need not run in real time.
    waits = not chosen.no_wait and chosen.device not in (*SCRIPTED, "replay")
    return {
        "mode": chosen.mode,
        "scale": chosen.scale,
        "intervention": chosen.intervention,
        "real_time": waits,
        "buttons": read_buttons(chosen),
        "centring": chosen.device in HELD and not chosen.no_centring and chosen.mode != "rate",
        "tell": note,
    }


def check_device(chosen: argparse.Namespace) -> Actor | None:
    """Check the options of a device before anything is loaded.

    Returns:
        The policy that acts, if there is one.

    Raises:
        CommandError: If an option is missing, or one would have no effect.
    """
    check_applicable(chosen)
    read_buttons(chosen)
    if chosen.device == "replay" and chosen.recording is None:
        raise CommandError("--device replay needs --recording DATASET")
    if chosen.policy is not None and chosen.device not in SCRIPTED and chosen.intervention == "always":
        raise CommandError(
            f"--policy with --device {chosen.device} needs --intervention button or motion: with "
            f"{chosen.intervention!r} the operator acts all the time"
        )
    if chosen.intervention != "always" and chosen.policy is None:
        raise CommandError(f"--intervention {chosen.intervention} needs --policy: who acts otherwise")
    name = chosen.policy if chosen.policy is not None else "expert" if chosen.device in SCRIPTED else None
    return None if name is None else find_actor(name, resolve_env(chosen.env))


def check_applicable(chosen: argparse.Namespace) -> None:
    """Check that no option is given that does not apply to the device.

    Raises:
        CommandError: If one is; says to which devices it applies.
    """
    for name, (default, devices) in APPLICABLE.items():
        if getattr(chosen, name, default) != default and chosen.device not in devices:
            option = f"--{name.replace('_', '-')}"
            raise CommandError(f"{option} does not go with --device {chosen.device}, only with {', '.join(devices)}")
    if chosen.mode == "position" and chosen.device not in POSITIONS:
        raise CommandError(
            f"--mode position does not go with --device {chosen.device}, which tells how fast to move, not where to, "
            f"only with {', '.join(POSITIONS)}"
        )
    if chosen.scale != 1.0 and (chosen.mode == "rate" or chosen.device not in POSITIONS):
        raise CommandError(
            "--scale is the way of the tool over the way of the grip: it goes with --mode position and one of "
            f"{', '.join(POSITIONS)}"
        )
    if not 0.0 < chosen.scale < math.inf:
        raise CommandError(f"--scale must be positive, got {chosen.scale:g}")


@contextmanager
def opened_device(
    chosen: argparse.Namespace, env: gymnasium.Env[Any, Any], actor: Actor | None, seed: int
) -> Iterator[TeleopDevice]:
    """The device that the command line names, open and calibrated during a ``with`` block.

    Args:
        chosen: Arguments of `add_device_options`.
        env: The environment in which it acts.
        actor: Result of `check_device`.
        seed: Seed of the first episode.
    """
    with _make(chosen, env, actor, seed) as device:
        if not device.is_calibrated:
            device.calibrate(note)
        try:
            yield device
        finally:
            tell_loop(device)


def _make(chosen: argparse.Namespace, env: gymnasium.Env[Any, Any], actor: Actor | None, seed: int) -> TeleopDevice:
    from spatula_env.teleop.registry import make_device

    if chosen.device == "replay":
        from spatula_env.teleop.replay_device import ReplayDevice

        _check_recording(chosen, env)
        return ReplayDevice.from_dataset(chosen.recording, chosen.episode, chosen.root)
    options: dict[str, Any] = {"index": chosen.index, "firmware": chosen.firmware}
    if chosen.device in HAPTIC:
        options["settings"] = force_settings(chosen, env)
    if chosen.device in SCRIPTED:
        import numpy as np

        assert actor is not None
        options["policy"] = actor.make(env, seed)
        options["generator"] = np.random.default_rng(seed)
        for name in ("reaction_delay", "tremor", "gain"):
            if getattr(chosen, name) is not None:
                options[name] = getattr(chosen, name)
    return make_device(chosen.device, **options)


def _check_recording(chosen: argparse.Namespace, env: gymnasium.Env[Any, Any]) -> None:
    """Check that a recording fits the environment, so that its numbers have the same meaning."""
    from spatula_env.data.replaying import open_dataset

    dataset = open_dataset(chosen.recording, chosen.root)
    wanted = resolve_env(chosen.env)
    if not same_environment(dataset.spec.env_spec.id, wanted):
        raise CommandError(f"{chosen.recording!r} was recorded in {dataset.spec.env_spec.id}, not in {wanted}")
    if chosen.episode >= dataset.total_episodes:
        raise CommandError(f"{chosen.recording!r} has {dataset.total_episodes} episodes, there is no {chosen.episode}")
    if dataset.action_space.shape != env.action_space.shape:
        raise CommandError(f"{chosen.recording!r} was recorded with other actions; give the same --set control=...")


def check_page(chosen: argparse.Namespace) -> None:
    """Check the options of a command with --device web.

    Raises:
        CommandError: If one does not go with it.
    """
    check_applicable(chosen)
    if chosen.policy is not None or chosen.intervention != "always":
        raise CommandError("--policy and --intervention do not go with --device web: on the page the operator acts")
    if chosen.film is not None:
        raise CommandError(
            "--film does not go with --device web; spatula replay DATASET --film FILE makes one of what was recorded"
        )
    if chosen.view == "window":
        raise CommandError("--view window does not go with --device web: the page shows what happens")


def serve_page(
    chosen: argparse.Namespace,
    recording: RecordingOptions,
    progress: Callable[[str, EpisodeSummary], None],
    dataset: str | None = None,
) -> RecordingSummary:
    """Serve the page on which a task is played and recorded, until Ctrl-C or until all episodes are recorded.

    Args:
        chosen: The command line, checked by `check_page`.
        recording: How episodes are recorded.
        progress: Called after each episode, with what became of it and its summary.
        dataset: Dataset to which episodes are added; None: the page's own choice.

    Returns:
        What was recorded.
    """
    from spatula_env.teleop.web import serve

    return serve(
        resolve_env(chosen.env),
        host=chosen.host,
        port=chosen.port,
        token=find_token(chosen.token, chosen.token_file),
        dataset=dataset,
        root=chosen.root,
        seed=chosen.seed,
        env_kwargs={**engine_option(chosen), **with_changes({}, chosen.changes)},
        real_time=not chosen.no_wait,
        recording=recording,
        progress=progress,
        on_ready=lambda url: note(f"Open {url} in a browser. Ctrl-C ends it."),
    )
