"""Does any policy that evades a task earn more than one that does it?

Cheaters are policies that were found to, or could: they stay short of success, damage the organ at once, touch nothing,
drag, or squeeze as it comes. Each plays the same episodes as the scripted expert, once; what it earns under every
documented combination of reward, termination and limit is reckoned from what happened, by the package's own rule for
the ends of episodes, undiscounted and with discounts. None may earn as much as the expert, nor succeed as often.

`python -m benchmarks.tasks --cheaters` prints the table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.envs.incentives import Incentives
from spatula_env.envs.settings import EnvSettings
from spatula_env.learning import experts
from spatula_env.learning.experts.base import Expert

Actions: TypeAlias = NDArray[np.float32]
Act: TypeAlias = Callable[[Any, int], Actions]
"""Takes the observations of W worlds, and which control step of an episode it is, and gives actions (W, A)."""

DISCOUNTS = (1.0, 0.99, 0.97)
"""Under which earnings are compared."""

DAMAGE_LIMITS: Mapping[str, float] = {
    "Press": 60e3,
    "Retract": 2e3,
    "Fissure": 2e3,
    "Clamp": 2e3,
    "Palpate": 2e3,
}
"""Those of the combinations that have one [Pa s]: more than the expert needs who stays to the end of the episode, and
less than who dives."""


def options_of(task: str) -> list[dict[str, Any]]:
    """The combinations of reward, termination and limit."""
    return [
        {"reward": reward, "terminate_on_success": success, "damage_limit": limit}
        for reward in ("dense", "sparse")
        for success in (False, True)
        for limit in (None, DAMAGE_LIMITS[task])
    ]


RETREAT_AT, RETREAT_FOR = 0.55, 5
"""From which progress of the hold on a delaying policy retreats, and for how many control steps."""

ASIDE, LOW, PUSHING = 0.03, -0.045, 40
"""How a hovering policy pushes the sphere of the press aside: from how far [m], at which height [m], for how long."""

HOVER = 0.008
"""How far above where the organ's top was it then hovers [m]."""

CREST_SPEED = 0.015
"""With which the crest of a fold is dragged along [m/s]."""

FAINT = 1e-6
"""Earnings that differ by less are the same."""


@dataclass(frozen=True)
class Played:
    """What happened in some episodes of T control steps; (T, W) each.

    Attributes:
        dense: The dense reward, as it is where nothing ends an episode.
        sparse: The sparse one.
        success: Whether the goal had been held.
        dose: Of the episode so far [Pa s].
    """

    dense: NDArray[np.float64]
    sparse: NDArray[np.float64]
    success: NDArray[np.bool_]
    dose: NDArray[np.float64]


def make(task: str, worlds: int, engine: str) -> Any:
    """The environment, in many worlds, whose episodes nothing ends."""
    return gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=worlds, engine=engine, autoreset_mode="disabled")


def expert_of(env: Any, task: str) -> Expert:
    """The scripted expert of a task."""
    expert: Expert = getattr(experts, f"{task}Expert")(env)
    return expert


def act_of(expert: Expert) -> Act:
    """An expert as what `play` takes: it needs no count of steps."""
    return lambda observation, step: expert(observation)


def cheaters_of(env: Any, task: str, seed: int) -> dict[str, Act]:
    """All cheaters that a task knows, by name.

    Args:
        env: Of the task, in many worlds.
        task: Its name.
        seed: Of what they do by chance.
    """
    generator = np.random.default_rng([seed, 3])
    size = env.single_action_space.shape[0]
    shape = (env.num_envs, size)
    vertical = np.zeros(shape, dtype=np.float32)
    vertical[:, 2] = 1.0
    found: dict[str, Act] = {
        "delay": _delay(expert_of(env, task), vertical),
        "dive": lambda observation, step: -vertical,
        "still": lambda observation, step: np.zeros_like(vertical),
        "random": lambda observation, step: generator.uniform(-1.0, 1.0, shape).astype(np.float32),
    }
    more = {"Press": _hover, "Retract": _drag, "Clamp": _squeeze, "Fissure": _from_half_the_depth, "Palpate": _level}
    return {**found, **more[task](env, generator)}


def _delay(expert: Expert, up: Actions) -> Act:
    """Do what the expert does, and retreat shortly before success, for ever."""
    retreating = np.zeros(len(up), dtype=np.int64)

    def act(observation: Any, step: int) -> Actions:
        if step == 0:
            retreating[:] = 0
        retreating[:] = np.maximum(retreating - 1, 0)
        held = expert.part(observation, "hold_progress")[..., 0]
        retreating[held >= RETREAT_AT] = RETREAT_FOR
        return np.where(retreating[:, None] > 0, up, expert(observation))

    return act


def _hover(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Push the sphere aside, let go of it, and hover above the place without a touch."""
    expert = expert_of(env, "Press")
    angle = generator.uniform(0.0, 2.0 * np.pi, env.num_envs)
    away = np.column_stack([np.cos(angle), np.sin(angle)])
    top = float(env.task.setting.rest_nodes[:, 2].max())

    def act(observation: Any, step: int) -> Actions:
        place, goal = expert.part(observation, "tool_position"), expert.goal(observation)
        begin, push = step < PUSHING // 2, step < PUSHING
        target = np.column_stack([ASIDE * away, np.full(len(place), LOW if begin else place[:, 2])])
        if begin and step < PUSHING // 4:
            target[:, 2] = place[:, 2]
        elif not begin and push:
            target[:, :2] = -ASIDE * away
        elif not push:
            height = top + HOVER
            risen = place[:, 2] > height - 0.002
            target = np.column_stack([np.where(risen[:, None], goal[:, :2], place[:, :2]), np.full(len(place), height)])
        return np.clip(10.0 * (target - place) / expert.max_speed, -1.0, 1.0).astype(np.float32)

    return {"hover": act}


def _drag(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Press on the fold's crest from above, and drag it along."""
    expert = expert_of(env, "Retract")
    wanted = generator.uniform(0.05, 0.5, env.num_envs)

    def act(observation: Any, step: int) -> Actions:
        tool, shift = expert.part(observation, "tool_position"), expert.part(observation, "patch_shift")
        rest = expert.part(observation, "patch_position") - shift
        goal, down = expert.goal(observation), expert.part(observation, "contact_force")[:, 2]
        start = -0.004 * np.sign(goal[:, 0])
        touching, there = down > 0.5 * wanted, np.abs(tool[:, 0] - start) < 0.002
        velocity = np.column_stack(
            [
                np.where(touching, np.clip(4.0 * (goal[:, 0] - shift[:, 0]), -CREST_SPEED, CREST_SPEED),
                         8.0 * (start - tool[:, 0])),
                8.0 * (rest[:, 1] - tool[:, 1]),
                np.where(there | touching, np.clip(-0.2 * (wanted - down), -0.03, 0.03), 0.0),
            ]
        )  # fmt: skip
        return np.clip(velocity / expert.max_speed, -1.0, 1.0).astype(np.float32)

    return {"drag": act}


def _squeeze(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Grip as the expert does, but to any width."""
    expert: Any = expert_of(env, "Clamp")
    expert.squeeze = generator.uniform(0.125, 0.65, env.num_envs)
    return {"squeeze": act_of(expert)}


def _from_half_the_depth(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Open the fissure between its lips."""
    expert: Any = expert_of(env, "Fissure")
    expert.low, expert.wall = 0.013, 0.008
    return {"half": act_of(expert)}


def _level(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Slide the spatula's middle along the path, and leave it level."""
    expert = expert_of(env, "Palpate")

    def act(observation: Any, step: int) -> Actions:
        action = expert(observation)
        action[:, 3:] = 0.0
        ahead = expert.part(observation, "path_ahead")
        place = ahead[:, :2] + 0.4 * (ahead[:, 3:5] - ahead[:, :2])
        action[:, :2] = np.clip(6.0 * place / expert.max_speed, -1.0, 1.0)
        return action

    return {"level": act}


def play(env: Any, act: Act, seeds: Sequence[int]) -> Played:
    """Let a policy act in whole episodes, one in each world."""
    observation, _ = env.reset(seed=list(seeds))
    rows: dict[str, list[Any]] = {"dense": [], "sparse": [], "success": [], "dose": []}
    for step in range(env.max_episode_steps):
        observation, rewards, _, _, infos = env.step(act(observation, step))
        rows["dense"].append(rewards)
        rows["sparse"].append(infos["within_tolerance"] - 1.0)
        rows["success"].append(infos["is_success"])
        rows["dose"].append(infos["episode_dose"])
    return Played(**{name: np.array(values) for name, values in rows.items()})


def count_successes(task: str, engine: str, name: str, episodes: int, seed: int, worlds: int = 50) -> dict[str, int]:
    """How often one of the cheaters succeeds.

    Args:
        task: Its name.
        engine: "batch" or "bullet".
        name: Of the cheater.
        episodes: How many.
        seed: Of the first one.
        worlds: How many are played together.

    Returns:
        "episodes", "successes", "within", the episodes in which any control step was within tolerance, and "at_reset",
        those that began so.

    Raises:
        ValueError: If the task knows no such cheater.
    """
    found = {"episodes": 0, "successes": 0, "within": 0, "at_reset": 0}
    for first in range(seed, seed + episodes, worlds):
        count = min(worlds, seed + episodes - first)
        env = make(task, count, engine)
        try:
            known = cheaters_of(env, task, first)
            if name not in known:
                raise ValueError(f"{task} must have the cheater, one of {sorted(known)}; got {name!r}")
            _, infos = env.reset(seed=list(range(first, first + count)))
            found["at_reset"] += int(infos["within_tolerance"].sum())
            played = play(env, known[name], range(first, first + count))
        finally:
            env.close()
        found["episodes"] += count
        found["successes"] += int(played.success.any(axis=0).sum())
        found["within"] += int((played.sparse == 0.0).any(axis=0).sum())
    return found


def earnings(played: Played, options: Mapping[str, Any], task: Any, horizon: int) -> dict[str, NDArray[Any]]:
    """What a policy earns where episodes may end.

    Args:
        played: What happened without.
        options: One of `options_of`.
        task: The environment's, for its weights.
        horizon: Control steps of an episode.

    Returns:
        "success" (W,), and under each discount the sum of rewards (W,).
    """
    settings = EnvSettings(**options)
    incentives = Incentives(settings, task)
    limit = np.inf if settings.damage_limit is None else settings.damage_limit
    badly = played.dose > limit
    over = badly | (played.success & settings.terminate_on_success)
    # Nothing is paid after the step that ends an episode.
    going = ~np.logical_or.accumulate(np.concatenate([np.zeros((1, over.shape[1]), dtype=np.bool_), over[:-1]]))
    reward = played.sparse if settings.reward == "sparse" else played.dense
    paid = np.where(going, incentives.pay(reward, badly, horizon), 0.0)
    steps = np.arange(len(paid))[:, None]
    return {
        "success": (played.success & going & ~badly).any(axis=0),
        **{f"{discount:g}": (discount**steps * paid).sum(axis=0) for discount in DISCOUNTS},
    }


def measure(tasks: Sequence[str], engines: Sequence[str], episodes: int, seed: int) -> list[dict[str, Any]]:
    """Let the expert and all cheaters play.

    Returns:
        A row for each task, engine and combination of options: means over the episodes of what the expert earns and of
        what the best cheater does, which that is, and whether the expert is ahead of all.
    """
    rows = []
    for task in tasks:
        for engine in engines:
            env = make(task, episodes, engine)
            try:
                seeds = range(seed, seed + episodes)
                acts = {"expert": act_of(expert_of(env, task))}
                acts.update(cheaters_of(env, task, seed))
                played = {name: play(env, act, seeds) for name, act in acts.items()}
                for options in options_of(task):
                    earned = {
                        name: {
                            key: float(values.mean())
                            for key, values in earnings(each, options, env.task, env.max_episode_steps).items()
                        }
                        for name, each in played.items()
                    }
                    rows.append({"task": task, "engine": engine, "options": dict(options), **compared(earned)})
            finally:
                env.close()
    return rows


def compared(earned: dict[str, dict[str, float]]) -> dict[str, Any]:
    """The expert's earnings beside those of the best cheater in each respect.

    Args:
        earned: By policy, "expert" among them, then by respect.
    """
    expert = earned["expert"]
    others = {name: values for name, values in earned.items() if name != "expert"}
    best: dict[str, tuple[str, float]] = {}
    for key in expert:
        name = max(others, key=lambda each: others[each][key])
        best[key] = name, others[name][key]
    return {
        "expert": expert,
        "best": {key: {"policy": name, "value": value} for key, (name, value) in best.items()},
        "cheaters": others,
        "ahead": all(expert[key] > value + FAINT for key, (_, value) in best.items()),
    }


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a table."""
    keys = ["success", *(f"{discount:g}" for discount in DISCOUNTS)]
    heads = "".join(f" {('return ' + key if key != 'success' else key):>24}" for key in keys)
    print(f"{'task':8} {'engine':6} {'reward':6} {'success ends':12} {'damage ends':11}{heads}")
    for row in rows:
        options = row["options"]
        cells = "".join(
            f" {row['expert'][key]:8.2f} {row['best'][key]['value']:7.2f} {row['best'][key]['policy']:>7}"
            for key in keys
        )
        print(
            f"{row['task']:8} {row['engine']:6} {options['reward']:6} {options['terminate_on_success']!s:12} "
            f"{options['damage_limit'] is not None!s:11}{cells}{'' if row['ahead'] else '  <- beaten'}"
        )
