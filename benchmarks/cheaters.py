"""Does any policy that evades a task earn more than one that solves it?

Cheaters are policies that were found to do so, or might: they stay just short of success, damage the organ at once,
touch nothing, drag the tissue, or squeeze to an arbitrary width. Each plays the same episodes as the scripted expert,
once. Its return under every documented combination of reward, termination and limit is then computed from the recorded
episodes, with the package's own rule for how episodes end, both undiscounted and discounted. No cheater may earn as
much as the expert, or succeed as often.

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
"""Maps the observations of W worlds and the index of the control step within the episode to actions (W, A)."""

DISCOUNTS = (1.0, 0.99, 0.97)
"""Discount factors under which returns are compared."""

DAMAGE_LIMITS: Mapping[str, float] = {
    "Press": 60e3,
    "Retract": 2e3,
    "Fissure": 2e3,
    "Clamp": 2e3,
    "Palpate": 2e3,
}
"""The damage limit of those combinations that have one, by task [Pa s]: more than the dose of an expert that stays to
the end of the episode, and less than that of a policy that dives into the organ."""


def options_of(task: str) -> list[dict[str, Any]]:
    """All combinations of reward, termination on success and damage limit, as options of the environment."""
    return [
        {"reward": reward, "terminate_on_success": success, "damage_limit": limit}
        for reward in ("dense", "sparse")
        for success in (False, True)
        for limit in (None, DAMAGE_LIMITS[task])
    ]


RETREAT_AT, RETREAT_FOR = 0.55, 5
"""The hold progress at which the delaying policy retreats, and for how many control steps it does."""

ASIDE, LOW, PUSHING = 0.03, -0.045, 40
"""How the hovering policy pushes the sphere of the press aside: horizontal distance from which it starts [m], height
[m], and number of control steps."""

HOVER = 0.008
"""Height above the top of the organ at rest at which the policy then hovers [m]."""

CREST_SPEED = 0.015
"""Greatest speed at which the crest of the fold is dragged along [m/s]."""

FAINT = 1e-6
"""Returns that differ by no more than this count as equal."""


@dataclass(frozen=True)
class Played:
    """Record of one episode of T control steps in each of W worlds; all arrays are (T, W).

    Attributes:
        dense: The dense reward, as paid where nothing ends an episode early.
        sparse: The sparse reward.
        success: Whether the task was solved at this step, that is, the goal had been held.
        dose: Damage dose accumulated in the episode so far [Pa s].
    """

    dense: NDArray[np.float64]
    sparse: NDArray[np.float64]
    success: NDArray[np.bool_]
    dose: NDArray[np.float64]


def make(task: str, worlds: int, engine: str) -> Any:
    """The vectorised environment of a task, with options under which no episode ends early."""
    return gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=worlds, engine=engine, autoreset_mode="disabled")


def expert_of(env: Any, task: str) -> Expert:
    """The scripted expert of a task."""
    expert: Expert = getattr(experts, f"{task}Expert")(env)
    return expert


def act_of(expert: Expert) -> Act:
    """Wrap an expert for `play`; the expert ignores the step index."""
    return lambda observation, step: expert(observation)


def cheaters_of(env: Any, task: str, seed: int) -> dict[str, Act]:
    """All cheaters for a task, by name.

    Args:
        env: Vectorised environment of the task.
        task: Name of the task.
        seed: Seed of the cheaters' random choices.
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
    """Act as the expert does, but retreat shortly before success, again and again."""
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
    """Push the sphere aside, let go of it, and hover above the goal without touching it."""
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
    """Grip as the expert does, but squeeze to a random width."""
    expert: Any = expert_of(env, "Clamp")
    expert.squeeze, expert.minds_force = generator.uniform(0.125, 0.65, env.num_envs), False
    return {"squeeze": act_of(expert)}


def _from_half_the_depth(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Open the fissure as the expert does, but from half its depth, between the lips."""
    expert: Any = expert_of(env, "Fissure")
    expert.low, expert.wall = 0.013, 0.008
    return {"half": act_of(expert)}


def _level(env: Any, generator: np.random.Generator) -> dict[str, Act]:
    """Slide the spatula's middle along the path without ever tilting it."""
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
    """Play one whole episode in each world with a policy, and record it."""
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
    """Count how often one of the cheaters succeeds.

    Args:
        task: Name of the task.
        engine: "batch" or "bullet".
        name: Name of the cheater.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        worlds: Number of episodes played at a time.

    Returns:
        Counts: "episodes"; "successes"; "within", episodes with any control step within tolerance; and "at_reset",
        episodes that are within tolerance from the start.

    Raises:
        ValueError: If the task has no cheater of that name.
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
    """Returns of a policy where episodes may end early, computed from episodes that did not.

    Args:
        played: Record of the episodes, none of which ended early.
        options: One of the combinations of `options_of`.
        task: The environment's task, for its reward weights.
        horizon: Control steps of an episode.

    Returns:
        "success" (W,), and for each discount, formatted as a string, the discounted sum of rewards (W,).
    """
    settings = EnvSettings(**options)
    incentives = Incentives(settings, task)
    limit = np.inf if settings.damage_limit is None else settings.damage_limit
    badly = played.dose > limit
    over = badly | (played.success & settings.terminate_on_success)
    # An episode that has ended pays nothing in later steps.
    going = ~np.logical_or.accumulate(np.concatenate([np.zeros((1, over.shape[1]), dtype=np.bool_), over[:-1]]))
    reward = played.sparse if settings.reward == "sparse" else played.dense
    paid = np.where(going, incentives.pay(reward, badly, horizon), 0.0)
    steps = np.arange(len(paid))[:, None]
    return {
        "success": (played.success & going & ~badly).any(axis=0),
        **{f"{discount:g}": (discount**steps * paid).sum(axis=0) for discount in DISCOUNTS},
    }


def measure(tasks: Sequence[str], engines: Sequence[str], episodes: int, seed: int) -> list[dict[str, Any]]:
    """Play the expert and all cheaters.

    Returns:
        A row for each task, engine and combination of options: the expert's mean success and returns over the episodes,
        those of the best cheater in each respect, its name, and whether the expert is ahead of all cheaters.
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
    """Compare the expert with the best cheater in each quantity.

    Args:
        earned: Mean values by policy, "expert" among them, then by quantity: "success" or a discount.
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
