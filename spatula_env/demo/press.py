"""The press: the seed's spatula driven into the seed's sphere and held there, with any of the contact models."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from spatula_env import scenes
from spatula_env.arrays import BoolArray, FloatArray
from spatula_env.demo.measure import footprint, is_inside, surface_heights
from spatula_env.demo.verdict import Verdict, judge
from spatula_env.sim.report import Report
from spatula_env.sim.simulation import ContactName, Simulation, SimulationDiverged

CONTACTS: tuple[ContactName, ...] = ("flags", "second_step", "bullet", "mujoco")
"""The contact models compared."""

SPEEDS = (0.2, 1.0, 5.0, 20.0, 60.0, 200.0, 400.0)
"""The speeds of descent compared [u/s]."""

GAP = 0.05
"""Between the tool's lower face and the organ's top at the start [u]."""

FILM_GAP = 0.4
"""The same at the start of a film [u]."""

FINAL_HEIGHT = 4.6
"""Of the tool's centre, where it is held [u]."""

USUAL_WAY = 1.45
"""About how far the tool descends [u]."""

WINDOW = 100
"""Steps at the end of a run over which force and surface are judged."""


SURFACE_STRIDE = 5
"""Of those steps, every so many is looked at with rays, the very last among them."""


@dataclass(frozen=True)
class PressCase:
    """One run of the comparison.

    Attributes:
        contact: The contact model.
        speed: Of the descent [u/s].
        hold_time: For how long the tool is then held [s].
        engine: Name of the engine; None: the default.
    """

    contact: ContactName
    speed: float
    hold_time: float = 2.0
    engine: str | None = None

    @property
    def expected_steps(self) -> int:
        """About how many physics steps it takes."""
        return math.ceil(USUAL_WAY / (self.speed * scenes.Scene.dt)) + round(self.hold_time / scenes.Scene.dt)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Organ and tool at one moment.

    Attributes:
        time: Since the start of the run [s].
        nodes: (V, 3) of the organ [u].
        tool_position: (3,) [u].
        tool_orientation: (4,) quaternion xyzw.
        flags: (n,) bool of the tool's contact nodes.
        unfeasible: (n,) bool, refused by the first step.
        force: (3,) on the tool [N].
    """

    time: float
    nodes: FloatArray
    tool_position: FloatArray
    tool_orientation: FloatArray
    flags: BoolArray
    unfeasible: BoolArray
    force: FloatArray


@dataclass(frozen=True, eq=False)
class PressResult:
    """The result of a case. Lengths are in u, forces in N; `force_scale` leads back to scene units.

    "The last steps" are the last `WINDOW` ones. The residual is the height of the organ's surface over the tool's
    lower face, measured in every fifth of them with vertical rays from above over the tool's footprint; where a ray
    meets nothing, there is no organ and nothing is counted.

    Attributes:
        case: What was run.
        verdict: See `verdict.CRITERIA`.
        residual_mean: Mean residual over the last steps [u]; None if no ray met the organ.
        residual_max: Greatest residual in the last steps [u]; None likewise.
        covered_share: Part of the rays that met the organ.
        force_mean: Mean of the upward force on the tool over the last steps [N].
        force_deviation: Its standard deviation over the last steps [N].
        force_peak: Greatest magnitude of the force in the last steps [N].
        force_peak_of_run: The same of the whole run [N].
        lower_nodes: Flagged nodes of the lower face in the last step.
        upper_nodes: Flagged nodes of the upper face in the last step.
        pairs_steps: Steps of the run in which both nodes of a pair were flagged.
        inside_share: Part of the held steps in which the tool's centre was inside the organ.
        steps: Physics steps of the run.
        diverged: Whether the run ended early because positions stopped being finite.
        wall_time: How long the run took on this machine [s].
        force_scale: Newtons in a scene unit of force.
        snapshot: The last moment.
    """

    case: PressCase
    verdict: Verdict
    residual_mean: float | None
    residual_max: float | None
    covered_share: float
    force_mean: float
    force_deviation: float
    force_peak: float
    force_peak_of_run: float
    lower_nodes: int
    upper_nodes: int
    pairs_steps: int
    inside_share: float
    steps: int
    diverged: bool
    wall_time: float
    force_scale: float
    snapshot: Snapshot

    def as_record(self) -> dict[str, Any]:
        """All numbers, by name, as JSON has them: forces in newtons and in scene units."""
        forces = ("force_mean", "force_deviation", "force_peak", "force_peak_of_run")
        left_out = ("case", "snapshot", "force_scale", *forces)
        record: dict[str, Any] = asdict(self.case)
        record["verdict"] = self.verdict
        for name in self.__dataclass_fields__:
            if name not in left_out:
                record[name] = getattr(self, name)
        for unit, scale in (("newtons", 1.0), ("scene_units", self.force_scale)):
            record[f"force_{unit}"] = {name.removeprefix("force_"): getattr(self, name) / scale for name in forces}
        return record


@dataclass(frozen=True, eq=False)
class PressFilm:
    """A press, hold and release, moment by moment.

    Attributes:
        snapshots: The moments shown.
        forces: (N,) upward force on the tool in each physics step [N].
        dt: Length of a physics step [s].
        speed: Of the descent [u/s].
    """

    snapshots: tuple[Snapshot, ...]
    forces: FloatArray
    dt: float
    speed: float


class _Recorder:
    """Gathers what the steps of a run tell."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        tool = simulation.scene.tools[0].tool
        self._opposite = tool.opposite
        self._low, self._high = tool.vertices.min(axis=0), tool.vertices.max(axis=0)
        self._triangles = simulation.triangles
        self.lower_face: BoolArray = tool.normals[:, 2] < 0.0
        self.forces: list[FloatArray] = []
        self.residuals: list[FloatArray] = []
        self.pairs_steps = 0
        self.inside_steps = 0
        self.last: Report | None = None

    def add(self, report: Report) -> None:
        """Any step."""
        self.last = report
        self.forces.append(report.force_newtons)
        flags = report.contacts.flags
        self.pairs_steps += bool((flags & flags[self._opposite]).any())

    def add_held(self) -> None:
        """Additionally, for a step in which the tool was held."""
        simulation = self._simulation
        self.inside_steps += is_inside(simulation.tool_position, simulation.nodes, self._triangles)

    def add_surface(self) -> None:
        """Additionally, for one of the last steps."""
        position = self._simulation.tool_position
        points = footprint(position[:2] + self._low[:2], position[:2] + self._high[:2])
        heights = surface_heights(points, self._simulation.nodes, self._triangles)
        self.residuals.append(heights - (position[2] + self._low[2]))


def run_press(case: PressCase) -> PressResult:
    """Press down at the case's speed, hold, and measure.

    The tool starts `GAP` over the organ's top and descends until its centre is at `FINAL_HEIGHT`; the last step is
    shortened so that it ends exactly there.
    """
    began = time.perf_counter()
    simulation = Simulation(scenes.seed(), engine=case.engine, contact=case.contact)
    try:
        recorder = _Recorder(simulation)
        held = max(1, round(case.hold_time / simulation.dt))
        diverged = False
        try:
            _place_above(simulation, GAP)
            for report in _descend(simulation, case.speed):
                recorder.add(report)
            for index in range(held):
                recorder.add(simulation.step())
                recorder.add_held()
                left = held - 1 - index
                if left < WINDOW and left % SURFACE_STRIDE == 0:
                    recorder.add_surface()
        except SimulationDiverged:
            diverged = True
        return _summarise(case, simulation, recorder, held, diverged, time.perf_counter() - began)
    finally:
        simulation.close()


def film_press(
    *,
    engine: str | None = None,
    contact: ContactName = "flags",
    speed: float = 20.0,
    release_speed: float = 5.0,
    hold_time: float = 0.5,
    rest_time: float = 0.35,
    stride: int = 4,
) -> PressFilm:
    """Press, hold, release, and keep every so many moments.

    Args:
        engine: Name of the engine; None: the default.
        contact: The contact model.
        speed: Of the descent [u/s].
        release_speed: Of the way up, to where the tool started [u/s].
        hold_time: For how long the tool is held [s].
        rest_time: For how long it is watched after the release [s].
        stride: Physics steps between two moments.

    Returns:
        The film.
    """
    simulation = Simulation(scenes.seed(), engine=engine, contact=contact)
    try:
        _place_above(simulation, FILM_GAP)
        start = float(simulation.tool_position[2])
        snapshots, forces = [], []
        reports = _chain(
            _descend(simulation, speed),
            _wait(simulation, hold_time),
            _descend(simulation, -release_speed, start),
            _wait(simulation, rest_time),
        )
        for index, report in enumerate(reports):
            forces.append(float(report.force_newtons[2]))
            if index % stride == 0:
                snapshots.append(_snapshot(simulation, report))
        return PressFilm(tuple(snapshots), np.array(forces), simulation.dt, speed)
    finally:
        simulation.close()


def _chain(*parts: Iterator[Report]) -> Iterator[Report]:
    for part in parts:
        yield from part


def _place_above(simulation: Simulation, gap: float) -> None:
    """Put the tool over the organ's top, with a gap between them [u]."""
    simulation.reset(seed=0)
    tool = simulation.scene.tools[0].tool
    top = float(simulation.nodes[:, 2].max())
    simulation.place_tool((0.0, 0.0, top + gap - float(tool.vertices[:, 2].min())))


def _descend(simulation: Simulation, speed: float, end: float = FINAL_HEIGHT) -> Iterator[Report]:
    """Move the tool down (up, if `speed` is negative) until its centre is at the height `end`."""
    longest = speed * simulation.dt
    while True:
        left = float(simulation.tool_position[2]) - end
        if left * math.copysign(1.0, speed) <= 1e-9:
            return
        step = min(left, longest) if speed > 0.0 else max(left, longest)
        yield simulation.step(linear_velocity=(0.0, 0.0, -step / simulation.dt))


def _wait(simulation: Simulation, duration: float) -> Iterator[Report]:
    for _ in range(round(duration / simulation.dt)):
        yield simulation.step()


def _snapshot(simulation: Simulation, report: Report | None) -> Snapshot:
    count = len(simulation.scene.tools[0].tool.nodes)
    nothing = np.zeros(count, dtype=np.bool_)
    return Snapshot(
        time=simulation.time,
        nodes=simulation.nodes,
        tool_position=simulation.tool_position,
        tool_orientation=simulation.tool_orientation,
        flags=nothing if report is None else report.contacts.flags,
        unfeasible=nothing if report is None else report.contacts.unfeasible,
        force=np.zeros(3) if report is None else report.force_newtons,
    )


def _summarise(
    case: PressCase, simulation: Simulation, recorder: _Recorder, held: int, diverged: bool, wall_time: float
) -> PressResult:
    forces = np.array(recorder.forces) if recorder.forces else np.zeros((1, 3))
    upward, magnitude = forces[-WINDOW:, 2], np.linalg.norm(forces, axis=1)
    residuals = np.array(recorder.residuals)
    met = np.isfinite(residuals)
    snapshot = _snapshot(simulation, recorder.last)
    mean, deviation = float(upward.mean()), float(upward.std())
    residual = float(residuals[met].max()) if met.any() else None
    inside_share = recorder.inside_steps / held
    return PressResult(
        case=case,
        verdict=judge(
            residual=residual,
            force_mean=mean,
            force_deviation=deviation,
            pairs_steps=recorder.pairs_steps,
            inside_share=inside_share,
            diverged=diverged,
        ),
        residual_mean=float(residuals[met].mean()) if met.any() else None,
        residual_max=residual,
        covered_share=float(met.mean()) if met.size else 0.0,
        force_mean=mean,
        force_deviation=deviation,
        force_peak=float(magnitude[-WINDOW:].max()),
        force_peak_of_run=float(magnitude.max()),
        lower_nodes=int(snapshot.flags[recorder.lower_face].sum()),
        upper_nodes=int(snapshot.flags[~recorder.lower_face].sum()),
        pairs_steps=recorder.pairs_steps,
        inside_share=inside_share,
        steps=len(recorder.forces),
        diverged=diverged,
        wall_time=wall_time,
        force_scale=simulation.scene.scale.force,
        snapshot=snapshot,
    )
