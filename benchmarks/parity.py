"""Does the batch engine do what PyBullet does?

free_body      The seed's sphere, pulled by twenty nodal forces while it falls. Compares the positions of all nodes in
               all steps with PyBullet's.
rest           The sphere falls half a unit onto the ground, sways and rolls under ground contact and friction; and, in
               a second run, lies there at rest. Both engines start from the same nodes.
press          The spatula comes down on the sphere, presses it a unit deep, waits and goes back. Compares the nodes,
               and the force on the tool relative to the greatest one. Each engine lets its sphere settle by itself. In
               addition, one of many worlds in `BatchSimulation` must equal `Simulation(engine="batch")` bit for bit.

Double precision must follow PyBullet; single precision, which is meant for learning, is shown for comparison. A soft
body amplifies differences of the initial state. The row of PyBullet itself shows by how much: it starts from nodes
rounded to single precision.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.measure import finish, parser, require_bullet
from spatula_env import Simulation, scenes
from spatula_env.scenes import PlacedOrgan, Scene
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.bullet import BulletWorld
from spatula_env.sim.simulation import SimulationState
from spatula_env.sim.soft_body import soft_body

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray


FREE_BODY_LIMIT = 1e-6
"""Greatest allowed difference of a node's coordinate, free body in double precision [u]."""

REST_LIMIT = 1e-3
"""Greatest allowed difference of a node's coordinate, body on the ground in double precision [u]."""

PRESS_LIMIT, FORCE_LIMIT = 0.02, 0.02
"""Greatest allowed difference of a node's coordinate in a press [u], and of the force on the tool relative to the
greatest one, both in double precision."""

ROUNDING = 1e-12
"""Allowed difference of the forces of a world and of a simulation, relative to the greatest one: they are averaged in
different ways."""

PULLED_NODES = 20
PULL = 5.0
"""Standard deviation of each component of the nodal forces [kg u/s2]: a twentieth of the organ's weight."""

SHOWN_STEPS = (1, 10, 50, 100, 200, 300, 400, 480, 960, 1920)

DROP = 0.5
"""Height of the fall [u]."""

OUT_OF_REACH = 50.0
"""How far the tools are moved up in the runs without a press [u]."""

CLEARANCE, ASIDE, DEPTH, SPEED, HOLD = 0.1, 0.1, 1.0, 2.0, 0.5
"""Parameters of the press: initial height above the organ and offset from its axis [u]; depth [u]; speed [u/s]; and how
long the tool waits [s]."""

WORLDS, SPREAD = 19, 0.02
"""Number of worlds in `BatchSimulation`, more than a block and not a whole number of blocks; and offset of the tool
from each world to the next [u]."""

REFERENCE, ROUNDED = "bullet", "bullet_rounded"

SIDES: dict[str, dict[str, Any]] = {
    REFERENCE: {"engine": "bullet"},
    ROUNDED: {"engine": "bullet"},
    "double": {"engine": "batch", "precision": "double"},
    "single": {"engine": "batch", "precision": "single"},
}
"""The sides that are compared, and their arguments of `Simulation`."""


@dataclass(frozen=True)
class Path:
    """Record of S steps of a simulation.

    Attributes:
        nodes: (S, V, 3) positions of the organs' nodes [u].
        node_velocities: (S, V, 3) velocities of the organs' nodes [u/s].
        tool_positions: (S, N, 3) positions of the tools [u].
        forces: (S, 3) force on the first tool [kg u/s2].
        ground_forces: (S, 3) force of the ground on the organs [kg u/s2].
    """

    nodes: FloatArray
    node_velocities: FloatArray
    tool_positions: FloatArray
    forces: FloatArray
    ground_forces: FloatArray


def free_body(scene: Scene, steps: int, seed: int = 0) -> dict[str, Any]:
    """Pull a free body by constant nodal forces, in PyBullet and in the batch engine.

    Args:
        scene: Scene whose first organ is pulled.
        steps: Number of steps.
        seed: Seed of the choice of nodes and forces.

    Returns:
        Greatest difference of a node from PyBullet in any step [u], by side; the same by step; the greatest deformation
        of the organ in PyBullet, relative to its mean position [u]; the limit; and whether it has passed.
    """
    generator = np.random.default_rng(seed)
    placed = scene.organs[0]
    scene = dataclasses.replace(scene, organs=(placed,))
    body = soft_body(placed)
    forces = np.zeros_like(body.vertices)
    nodes = generator.choice(len(forces), PULLED_NODES, replace=False)
    forces[nodes] = generator.normal(scale=PULL, size=(PULLED_NODES, 3))
    changes = forces * body.inverse_masses[:, None] * float(np.float32(scene.dt))

    reference = _in_bullet(scene, changes, steps)
    paths = {ROUNDED: _in_bullet(scene, changes, steps, rounded=True)}
    for name, dtype in (("double", np.float64), ("single", np.float32)):
        paths[name] = _in_batch(placed, scene, changes, steps, dtype)
    differences = {name: _distances(path, reference) for name, path in paths.items()}
    strain = reference - reference.mean(axis=1, keepdims=True)
    return {
        "steps": steps,
        **_summary(differences),
        "deformation_u": float(np.abs(strain - strain[0]).max()),
        "limit_u": FREE_BODY_LIMIT,
        "passed": bool(differences["double"].max() <= FREE_BODY_LIMIT),
    }


def rest(scene: Scene, steps: int, height: float, batch_scene: Scene | None = None) -> dict[str, Any]:
    """Let the organs fall onto the ground, or lie there.

    Args:
        scene: Scene with ground; its tools are put out of reach.
        steps: Number of steps.
        height: Height from which the organs are dropped, above where they rest; 0 to let them lie [u].
        batch_scene: Scene for the batch engine in place of `scene`, to test that a difference is detected.

    Returns:
        Greatest difference of a node from PyBullet [u], by side, in any step, by step and at the end; of PyBullet's
        run, the greatest force of the ground [kg u/s2], the share of steps with such a force, and the greatest velocity
        component of a node at the end [u/s]; the limit; and whether it has passed.
    """
    up = np.array([0.0, 0.0, 1.0])
    start = _at_rest(scene).nodes + height * up
    paths: dict[str, Path] = {}
    for name, arguments in SIDES.items():
        simulation = Simulation(_scene_of(arguments, scene, batch_scene), **arguments)
        try:
            state = simulation.save()
            nodes = _rounded(start) if name == ROUNDED else start
            away = state.tool_positions + OUT_OF_REACH * up
            simulation.restore(dataclasses.replace(state, nodes=nodes, tool_positions=away))
            paths[name] = _follow(simulation, np.zeros((steps, 3)))
        finally:
            simulation.close()
    reference = paths.pop(REFERENCE)
    differences = {name: _distances(path.nodes, reference.nodes) for name, path in paths.items()}
    ground = reference.ground_forces[:, 2]
    return {
        "steps": steps,
        "height_u": height,
        **_summary(differences),
        "difference_at_end_u": {name: float(values[-1]) for name, values in differences.items()},
        "greatest_ground_force": float(ground.max()),
        "ground_share": float((ground > 0.0).mean()),
        "speed_at_end": float(np.abs(reference.node_velocities[-1]).max()),
        "limit_u": REST_LIMIT,
        "passed": bool(differences["double"].max() <= REST_LIMIT),
    }


def press_velocities(dt: float, way: float = CLEARANCE + DEPTH, hold: float = HOLD) -> FloatArray:
    """Velocities of the tool in a press: down, still, and up again.

    Args:
        dt: Length of a step [s].
        way: Distance that it goes down [u].
        hold: How long it waits there [s].

    Returns:
        (S, 3) velocity in each step [u/s].
    """
    moving, waiting = round(way / (SPEED * dt)), round(hold / dt)
    speeds = np.concatenate([np.full(moving, -SPEED), np.zeros(waiting), np.full(moving, SPEED)])
    return np.column_stack([np.zeros((len(speeds), 2)), speeds])


def press(
    scene: Scene,
    depth: float = DEPTH,
    hold: float = HOLD,
    worlds: int = WORLDS,
    batch_scene: Scene | None = None,
) -> dict[str, Any]:
    """Press the organ and go back.

    Args:
        scene: Scene whose first tool presses from above.
        depth: Depth of the press [u].
        hold: How long the tool waits there [s].
        worlds: Number of worlds of `BatchSimulation`.
        batch_scene: Scene for the batch engine in place of `scene`, to test that a difference is detected.

    Returns:
        Greatest difference from PyBullet, by side, of a node [u], and of the force relative to PyBullet's greatest; of
        the force also the mean over all steps and the greatest during the hold; the share of steps in contact; how a
        world among others compares with a simulation, by precision; the limits; and whether it has passed.
    """
    velocities = press_velocities(scene.dt, CLEARANCE + depth, hold)
    holding = ~velocities.any(axis=1)
    place = place_above(scene, _at_rest(scene).nodes)
    paths: dict[str, Path] = {}
    for name, arguments in SIDES.items():
        simulation = Simulation(_scene_of(arguments, scene, batch_scene), **arguments)
        try:
            if name == ROUNDED:
                state = simulation.save()
                simulation.restore(dataclasses.replace(state, nodes=_rounded(state.nodes)))
            simulation.place_tool(place)
            paths[name] = _follow(simulation, velocities)
        finally:
            simulation.close()
    reference = paths.pop(REFERENCE)
    magnitudes = np.linalg.norm(reference.forces, axis=1)
    nodes = {name: _distances(path.nodes, reference.nodes) for name, path in paths.items()}
    forces = {
        name: np.linalg.norm(path.forces - reference.forces, axis=1) / magnitudes.max() for name, path in paths.items()
    }
    batch = {
        name: _compare_world(batch_scene or scene, place, velocities, worlds, dtype, paths[name])
        for name, dtype in (("double", np.float64), ("single", np.float32))
    }
    return {
        "steps": len(velocities),
        "depth_u": depth,
        **_summary(nodes),
        "force_difference": {name: float(values.max()) for name, values in forces.items()},
        "force_difference_mean": {name: float(values.mean()) for name, values in forces.items()},
        "force_difference_hold": {name: float(values[holding].max()) for name, values in forces.items()},
        "greatest_force": float(magnitudes.max()),
        "contact_share": float((magnitudes > 0.0).mean()),
        "batch_simulation": batch,
        "limit_u": PRESS_LIMIT,
        "force_limit": FORCE_LIMIT,
        "passed": bool(
            nodes["double"].max() <= PRESS_LIMIT
            and forces["double"].max() <= FORCE_LIMIT
            and all(row["passed"] for row in batch.values())
        ),
    }


def place_above(scene: Scene, nodes: FloatArray, clearance: float = CLEARANCE) -> FloatArray:
    """Initial position of the first tool for a press: lying flat, its underside above the organ's top.

    Args:
        scene: Scene with the organ and the tool.
        nodes: (V, 3) of the organ at rest [u].
        clearance: Gap between the tool's underside and the organ's top [u].

    Returns:
        (3,) position [u], a little off the organ's axis, to break the symmetry.
    """
    x, y, _ = scene.organs[0].position
    underside = nodes[:, 2].max() + clearance
    return np.array([x + ASIDE, y, underside + 0.5 * scene.tools[0].tool.size[2]])


def _compare_world(
    scene: Scene, place: FloatArray, velocities: FloatArray, worlds: int, dtype: type, alone: Path
) -> dict[str, Any]:
    """Compare the last of many worlds with the record of a simulation."""
    batch = BatchSimulation(scene, worlds, dtype=dtype)
    positions = np.repeat(batch.tool_positions[:1], worlds, axis=0)
    positions[:, 0] = place
    # The other worlds press elsewhere.
    positions[:, 0, 1] += SPREAD * np.arange(worlds)[::-1]
    batch.place_tools(positions)
    rows = []
    for velocity in velocities:
        loads = batch.advance(np.broadcast_to(velocity, positions.shape))
        state = (batch.nodes[-1], batch.node_velocities[-1], batch.tool_positions[-1])
        rows.append((*state, loads.forces[-1, 0], loads.ground_forces[-1]))
    found = _path(rows)
    equal = all(
        np.array_equal(getattr(found, name), getattr(alone, name))
        for name in ("nodes", "node_velocities", "tool_positions")  # not forces, see ROUNDING
    )
    difference, greatest = np.abs(found.forces - alone.forces).max(), np.abs(alone.forces).max()
    return {
        "worlds": worlds,
        "equal": bool(equal),
        "force_difference": float(difference / greatest) if greatest > 0.0 else float(difference),
        "passed": bool(equal and difference <= ROUNDING * greatest),
    }


def _scene_of(arguments: dict[str, Any], scene: Scene, batch_scene: Scene | None) -> Scene:
    return batch_scene if batch_scene is not None and arguments["engine"] == "batch" else scene


def _at_rest(scene: Scene) -> SimulationState:
    """State of the scene after PyBullet has let it settle."""
    simulation = Simulation(scene, **SIDES[REFERENCE])
    try:
        return simulation.save()
    finally:
        simulation.close()


def _follow(simulation: Simulation, velocities: FloatArray) -> Path:
    """Move the tool with the given velocities (S, 3), and record."""
    rows = []
    for velocity in velocities:
        report = simulation.step(velocity)
        state = (simulation.nodes, simulation.node_velocities, simulation.tool_positions)
        rows.append((*state, report.force, report.ground_force.copy()))
    return _path(rows)


def _path(rows: Sequence[tuple[FloatArray, ...]]) -> Path:
    return Path(*(np.array(values) for values in zip(*rows, strict=True)))


def _rounded(nodes: FloatArray) -> FloatArray:
    return nodes.astype(np.float32).astype(np.float64)


def _distances(path: FloatArray, reference: FloatArray) -> FloatArray:
    """(S,) greatest difference of a coordinate of a node in each step [u]; infinite where one is not finite."""
    distances: FloatArray = np.nan_to_num(np.abs(path - reference).max(axis=(1, 2)), nan=np.inf)
    return distances


def _summary(differences: dict[str, FloatArray]) -> dict[str, Any]:
    """From the differences (S,) of each side: the greatest, and the greatest up to each of `SHOWN_STEPS`."""
    return {
        "difference_u": {name: float(values.max()) for name, values in differences.items()},
        "difference_by_step_u": {
            name: {str(step): float(values[:step].max()) for step in SHOWN_STEPS if step <= len(values)}
            for name, values in differences.items()
        },
    }


def _in_bullet(scene: Scene, changes: np.ndarray, steps: int, *, rounded: bool = False) -> np.ndarray:
    """Positions (steps, V, 3) in PyBullet."""
    world = BulletWorld(scene)
    try:
        positions, velocities = scene.organs[0].vertices, np.zeros_like(changes)
        if rounded:
            positions = _rounded(positions)
            world.set_state(positions)

        def step() -> np.ndarray:
            nonlocal positions, velocities
            positions, velocities = world.step(positions, velocities + changes)
            return positions

        return _record(step, steps)
    finally:
        world.close()


def _in_batch(placed: PlacedOrgan, scene: Scene, changes: np.ndarray, steps: int, dtype: type) -> np.ndarray:
    """Positions (steps, V, 3) in the batch engine."""
    batch = BatchBody(soft_body(placed), dt=scene.dt, gravity=scene.gravity, dtype=dtype)

    def step() -> np.ndarray:
        batch.step(changes[None])
        positions: np.ndarray = batch.positions[0]
        return positions

    return _record(step, steps)


def _record(step: Callable[[], np.ndarray], steps: int) -> np.ndarray:
    return np.array([step() for _ in range(steps)])


def run(scene: Scene, steps: int, rest_steps: int) -> dict[str, Any]:
    """Run all parts.

    Args:
        scene: The seed's scene, or a similar one.
        steps: Steps of the free body.
        rest_steps: Steps of the fall, and as many of lying at rest.

    Returns:
        Results of each part, and whether all have passed.
    """
    falling, lying = (rest(scene, rest_steps, height) for height in (DROP, 0.0))
    parts: dict[str, Any] = {
        "free_body": free_body(scene, steps),
        "rest": {"falling": falling, "lying": lying, "passed": falling["passed"] and lying["passed"]},
        "press": press(scene),
    }
    return {**parts, "passed": all(part["passed"] for part in parts.values())}


def _print_rows(title: str, row: dict[str, Any]) -> None:
    """Print how far every side is from PyBullet, step by step."""
    print(f"{title}: greatest difference of a node from PyBullet [u]")
    shown = list(row["difference_by_step_u"]["double"])
    print(f"  {'until step':16}" + "".join(f"{step:>9}" for step in shown) + f"{'all':>9}")
    for name, by_step in row["difference_by_step_u"].items():
        values = [*(by_step[step] for step in shown), row["difference_u"][name]]
        print(f"  {name:16}" + "".join(f"{value:9.0e}" for value in values))
    print(f"  limit for double {row['limit_u']:.0e} u: {'passed' if row['passed'] else 'FAILED'}\n")


def _print(result: dict[str, Any]) -> None:
    free, falling, pressing = result["free_body"], result["rest"]["falling"], result["press"]
    _print_rows(f"free body, {free['steps']} steps, deformed by up to {free['deformation_u']:.2f} u", free)
    _print_rows(
        f"fall of {falling['height_u']:g} u, {falling['steps']} steps, in {100 * falling['ground_share']:.0f} % of them"
        f" on the ground, in the end at {falling['speed_at_end']:.2f} u/s",
        falling,
    )
    _print_rows(f"lying, {result['rest']['lying']['steps']} steps", result["rest"]["lying"])
    _print_rows(
        f"press of {pressing['depth_u']:g} u, {pressing['steps']} steps, in {100 * pressing['contact_share']:.0f} % of"
        " them in contact",
        pressing,
    )
    print(f"press: difference of the force relative to the greatest, {pressing['greatest_force']:.0f} kg u/s2")
    print(f"  {'':16}{'all steps':>10}{'hold':>10}{'mean':>10}")
    for name, greatest in pressing["force_difference"].items():
        hold, mean = pressing["force_difference_hold"][name], pressing["force_difference_mean"][name]
        print(f"  {name:16}{greatest:10.0e}{hold:10.0e}{mean:10.0e}")
    print(f"  limit for double, all steps {pressing['force_limit']:g}")
    for name, row in pressing["batch_simulation"].items():
        same = "equal to the last bit" if row["equal"] else "DIFFERENT"
        print(f"  {name}, a world of {row['worlds']} beside a simulation: {same}, force {row['force_difference']:.0e}")
    print(f"\nall: {'passed' if result['passed'] else 'FAILED'}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--steps", type=int, default=200, help="of the free body")
    options.add_argument("--rest-steps", type=int, default=480, help="of falling, and of lying")
    given = options.parse_args(arguments)
    require_bullet("parity")
    result = run(scenes.seed(), given.steps, given.rest_steps)
    if not given.json:
        _print(result)
    finish({"benchmark": "parity", **result})


if __name__ == "__main__":
    main()
