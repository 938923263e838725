"""`spatula play`."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import (
    CommandError,
    Stopped,
    add_environment_options,
    add_json_option,
    add_root_option,
    at_least,
    count_of,
    make_environment,
    new_parser,
    note,
    print_json,
    resolve_env,
)
from spatula_env.cli.devices import (
    SCRIPTED,
    add_device_options,
    check_device,
    check_page,
    opened_device,
    serve_page,
    teleop_options,
)
from spatula_env.cli.showing import Film, has_window
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.teleop.session import EpisodeSummary

DESCRIPTION = """Do a task by hand, without recording.

The tool follows what the operator holds: a Novint Falcon, whose grip is pushed by the organ, a
SpaceMouse, a gamepad, the keyboard, or a page in a browser (--device web). A program can hold it
too (--device scripted), or a recording can be done again (--device replay). docs/teleoperation.md
says which keys and buttons do what; return finishes an episode, backspace discards it, escape quits.

examples:
  spatula play press --device keyboard
  spatula play fissure --device falcon --firmware falcon.bin
  spatula play press --device web
  spatula play clamp --device scripted --episodes 1 --film clamp.gif"""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "play", "do a task by hand", DESCRIPTION)
    add_environment_options(parser)
    add_device_options(parser)
    add_root_option(parser)
    parser.add_argument("--episodes", metavar="N", type=at_least(1), help="how many; until you quit if it is not given")
    parser.add_argument("--end-on-success", action="store_true", help="end an episode when its goal is reached")
    add_view_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """Add --view and --film."""
    parser.add_argument(
        "--view",
        choices=("auto", "window", "none"),
        default="auto",
        help="whether a window shows what happens; auto: if there is a display (default: %(default)s)",
    )
    parser.add_argument("--film", type=Path, metavar="FILE", help="write a film, .gif or .mp4, instead of a window")


def render_mode(chosen: argparse.Namespace) -> str | None:
    """The render mode of the environment for the options of `add_view_options`."""
    if chosen.film is not None:
        if chosen.view == "window":
            raise CommandError("--film and --view window do not go together")
        return "rgb_array"
    if chosen.view == "none":
        return None
    if chosen.view == "auto" and not has_window():
        if chosen.device not in (*SCRIPTED, "replay"):
            note(
                f"There is nothing to see: no display, or no pyglet ({install_hint('window')}). "
                "--device web shows a page in a browser, --film FILE writes a film."
            )
        return None
    return "human"


def run(chosen: argparse.Namespace) -> int:
    """Play."""
    if chosen.root is not None and chosen.device not in ("replay", "web"):
        raise CommandError(f"--root does not go with --device {chosen.device}: nothing is recorded when playing")
    if chosen.device == "web":
        return _on_page(chosen)
    if chosen.episodes is None and chosen.device in (*SCRIPTED, "replay"):
        chosen.episodes = 1
    actor = check_device(chosen)
    env_id = resolve_env(chosen.env)
    mode = render_mode(chosen)
    from spatula_env.teleop.session import play

    told: list[dict[str, Any]] = []
    env = make_environment(chosen, actor.options if actor is not None else None, render_mode=mode)
    film = None if chosen.film is None else Film(chosen.film, env.metadata["render_fps"])

    def tell(summary: EpisodeSummary) -> None:
        told.append({"env": env_id, **asdict(summary)})
        if not chosen.json:
            print(f"episode {len(told)}: {describe(summary)}", flush=True)

    def after_step(*_: Any) -> None:
        if film is not None:
            film.take(env)

    try:
        with opened_device(chosen, env, actor, chosen.seed) as device:
            policy = actor.make(env, chosen.seed) if actor is not None and chosen.device not in SCRIPTED else None
            play(
                env,
                device,
                episodes=chosen.episodes,
                seed=chosen.seed,
                policy=policy,
                end_on_success=chosen.end_on_success,
                progress=tell,
                after_step=after_step,
                **teleop_options(chosen),
            )
    except KeyboardInterrupt:
        raise Stopped(f"stopped after {count_of(len(told), 'episode')}; playing records nothing") from None
    finally:
        env.close()
        # The film is also written after an interruption.
        if film is not None and film.frames:
            note(f"wrote {film.write()}")
    if chosen.json:
        print_json({"env": env_id, "device": chosen.device, "episodes": told})
    return 0


def _on_page(chosen: argparse.Namespace) -> int:
    """Play on the web page."""
    from spatula_env.teleop.web.recording import RecordingOptions

    check_page(chosen)
    if chosen.episodes is not None:
        raise CommandError("--episodes does not go with play --device web, where you play until Ctrl-C")
    env_id = resolve_env(chosen.env)
    told: list[dict[str, Any]] = []

    def tell(fate: str, summary: EpisodeSummary) -> None:
        told.append({"env": env_id, "fate": fate, **asdict(summary)})
        if not chosen.json and fate != "practice":
            print(f"{fate}: {describe(summary)}", flush=True)

    summary = serve_page(chosen, RecordingOptions(end_on_success=chosen.end_on_success), tell)
    note(
        f"{count_of(summary.recorded, 'episode')} recorded on the page"
        + (f", in {summary.path} and beside it" if summary.recorded else "")
    )
    if chosen.json:
        print_json({"env": env_id, "device": chosen.device, "episodes": told})
    return 0


def describe(summary: EpisodeSummary) -> str:
    """Describe an episode in a line."""
    fate = "success" if summary.success else "no success"
    return (
        f"{fate} after {summary.steps} steps, return {summary.total_reward:.1f}, greatest force "
        f"{summary.peak_force:.2f} N"
        + (f", seed {summary.seed}" if summary.seed is not None else "")
        + ("" if summary.kept else ", discarded")
    )
