"""Organs that were prepared from a segmentation, and their files.

A file is a NumPy archive without pickles. It holds the surface in scene units, the length of such a unit in metres, the
held nodes, the tetrahedra if there are any, the lines that it names, and where all this came from.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.files import whole_file
from spatula_env.geometry.arrays import read_only
from spatula_env.geometry.meshes import Organ
from spatula_env.geometry.tetrahedra import TetrahedralMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    from spatula_env.arrays import FloatArray, Int32Array

FORMAT = 1
"""Version of the files' layout."""

PREPARED_SUFFIX = ".npz"
"""Ending of the files."""

UNIT_LENGTH = 0.02
"""Metres in a scene unit, as in the preset scenes."""

NEEDED = ("format", "vertices", "triangles", "held", "unit_length", "provenance")
"""Arrays that every file has; `nodes` and `tetrahedra` are there if the organ is filled, and `line_NAME` for each line
that it names."""

LINE = "line_"
"""Beginning of the names of arrays that are lines."""

FISSURE, RIDGE = "fissure", "ridge"
"""Names of lines that tasks ask for: the floor of a fissure, and the crest of a ridge."""


@dataclass(frozen=True, eq=False)
class PreparedOrgan(Organ):
    """An organ from a segmentation, ready to be put into a scene.

    Attributes:
        held: Nodes that do not move, ascending, for `fixed_nodes` of a `PlacedOrgan`.
        filling: Tetrahedra that fill the surface, which the engine "tissue" takes; None if there are none.
        unit_length: Metres in a scene unit.
        lines: Nodes along lines on the surface, from one end to the other, by name: "fissure" for the floor of one,
            "ridge" for the crest of one.
        provenance: Where it came from: source, units, options, version and the report. Plain values of JSON.
    """

    held: tuple[int, ...] = ()
    filling: TetrahedralMesh | None = field(default=None, repr=False)
    unit_length: float = UNIT_LENGTH
    lines: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Check the surface, the held nodes, the lines and the tetrahedra."""
        super().__post_init__()
        held = tuple(sorted({int(node) for node in self.held}))
        if held and not 0 <= held[0] <= held[-1] < len(self.vertices):
            raise ValueError(f"held must be nodes in 0..{len(self.vertices) - 1}, got {held[0]}..{held[-1]}")
        object.__setattr__(self, "held", held)
        lines = {str(name): tuple(int(node) for node in nodes) for name, nodes in dict(self.lines).items()}
        for name, nodes in lines.items():
            if (
                len(set(nodes)) != len(nodes)
                or len(nodes) < 2
                or not 0 <= min(nodes) <= max(nodes) < len(self.vertices)
            ):
                raise ValueError(
                    f"lines must be two or more different nodes in 0..{len(self.vertices) - 1} each, got {nodes} for "
                    f"{name!r}"
                )
        object.__setattr__(self, "lines", lines)
        object.__setattr__(self, "provenance", dict(self.provenance))
        if self.filling is not None:
            self.filling.check_fills(self)

    def scaled(self, factor: float, name: str | None = None) -> PreparedOrgan:
        """The same organ, larger or smaller.

        Args:
            factor: By which all lengths are multiplied.
            name: Another name for it.
        """
        scaled = self if factor == 1.0 else self._with(lambda points: points * factor)
        return scaled if name is None else replace(scaled, name=name)

    def moved(self, shift: ArrayLike) -> PreparedOrgan:
        """The same organ elsewhere.

        Args:
            shift: (3,) by how much it is moved [u].
        """
        by = np.asarray(shift, dtype=np.float64)
        return self._with(lambda points: points + by)

    def turned(self, angle: float) -> PreparedOrgan:
        """The same organ, turned about the vertical through the origin.

        Args:
            angle: Counter-clockwise as seen from above [rad].
        """
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return self._with(lambda points: points @ rotation.T)

    def line(self, name: str) -> FloatArray:
        """(K, 3) positions of the nodes of a line at rest [u].

        Args:
            name: Its name.

        Raises:
            ValueError: If the organ names no such line; the message says how it would.
        """
        if name not in self.lines:
            raise ValueError(
                f"organ must say where its {name} is, and {self.name!r} does not: it names "
                f"{', '.join(self.lines) or 'no lines'}; prepare it with `spatula organ prepare ... --{name} "
                '"X,Y,Z X,Y,Z"`'
            )
        return np.asarray(self.vertices[list(self.lines[name])])

    def _with(self, change: Callable[[FloatArray], FloatArray]) -> PreparedOrgan:
        """The same organ with other positions, of its surface and its filling alike."""
        filling = self.filling
        if filling is not None:
            filling = TetrahedralMesh(change(filling.nodes), filling.tetrahedra)
        return replace(self, vertices=change(self.vertices), filling=filling)


def write_prepared(path: Path, organ: PreparedOrgan) -> None:
    """Write an organ into a file, atomically.

    Args:
        path: The file, ending in .npz.
        organ: What it will hold.

    Raises:
        OSError: If it cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {
        "format": np.array(FORMAT),
        "vertices": organ.vertices,
        "triangles": organ.triangles,
        "held": np.array(organ.held, dtype=np.int32),
        "unit_length": np.array(organ.unit_length),
        "provenance": np.array(json.dumps({"name": organ.name, **organ.provenance})),
    }
    if organ.filling is not None:
        arrays |= {"nodes": organ.filling.nodes, "tetrahedra": organ.filling.tetrahedra}
    arrays |= {LINE + name: np.array(nodes, dtype=np.int32) for name, nodes in organ.lines.items()}
    with whole_file(path) as unfinished:
        # NumPy's own annotations take any keyword for its switch of pickles.
        np.savez_compressed(unfinished, **arrays)  # type: ignore[arg-type]


def read_prepared(path: Path) -> PreparedOrgan:
    """Read an organ from a file that `write_prepared` has written.

    Args:
        path: The file.

    Raises:
        ValueError: If it is no such file, or what it holds is no organ.
    """
    try:
        # NumPy leaves a file open if it opened it itself and it is damaged.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        # What NumPy says of a file that is none of its own is how to load pickles.
        reason = "it is no archive of NumPy" if "pickle" in str(error) else error
        raise ValueError(f"{path.name} cannot be read as an organ: {reason}") from error
    missing = [name for name in NEEDED if name not in arrays]
    if missing:
        raise ValueError(f"{path.name} holds no organ of `spatula organ prepare`: it lacks {', '.join(missing)}")
    try:
        if int(arrays["format"]) != FORMAT:
            raise ValueError(f"its format is {int(arrays['format'])}, {FORMAT} is what this version reads")
        provenance = json.loads(str(arrays["provenance"]))
        filling = TetrahedralMesh(arrays["nodes"], arrays["tetrahedra"]) if "tetrahedra" in arrays else None
        return PreparedOrgan(
            arrays["vertices"],
            arrays["triangles"],
            str(provenance.pop("name", path.name)),
            held=tuple(_as_nodes(arrays["held"], "held").tolist()),
            filling=filling,
            unit_length=float(arrays["unit_length"]),
            lines={
                name.removeprefix(LINE): tuple(_as_nodes(nodes, name).tolist())
                for name, nodes in arrays.items()
                if name.startswith(LINE)
            },
            provenance=provenance,
        )
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise ValueError(f"{path.name} cannot be read as an organ: {error}") from error


def _as_nodes(nodes: NDArray[Any], name: str) -> Int32Array:
    if nodes.ndim != 1 or nodes.dtype.kind not in "iu":
        raise ValueError(f"{name} must be integers of shape (n,), got {nodes.dtype} of shape {nodes.shape}")
    found: Int32Array = read_only(nodes, np.int32).astype(np.int32)
    return found
