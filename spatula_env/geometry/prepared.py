"""Organs that were prepared from a segmentation, and their files.

A file is a NumPy archive without pickles. It holds the surface in scene units, the length of such a unit in metres, the
held nodes, the tetrahedra if there are any, and where all this came from.
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
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from spatula_env.arrays import Int32Array

FORMAT = 1
"""Version of the files' layout."""

PREPARED_SUFFIX = ".npz"
"""Ending of the files."""

UNIT_LENGTH = 0.02
"""Metres in a scene unit, as in the preset scenes."""

NEEDED = ("format", "vertices", "triangles", "held", "unit_length", "provenance")
"""Arrays that every file has; `nodes` and `tetrahedra` are there if the organ is filled."""


@dataclass(frozen=True, eq=False)
class PreparedOrgan(Organ):
    """An organ from a segmentation, ready to be put into a scene.

    Attributes:
        held: Nodes that do not move, ascending, for `fixed_nodes` of a `PlacedOrgan`.
        filling: Tetrahedra that fill the surface, which the engine "tissue" takes; None if there are none.
        unit_length: Metres in a scene unit.
        provenance: Where it came from: source, units, options, version and the report. Plain values of JSON.
    """

    held: tuple[int, ...] = ()
    filling: TetrahedralMesh | None = field(default=None, repr=False)
    unit_length: float = UNIT_LENGTH
    provenance: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        """Check the surface, the held nodes and the tetrahedra."""
        super().__post_init__()
        held = tuple(sorted({int(node) for node in self.held}))
        if held and not 0 <= held[0] <= held[-1] < len(self.vertices):
            raise ValueError(f"held must be nodes in 0..{len(self.vertices) - 1}, got {held[0]}..{held[-1]}")
        object.__setattr__(self, "held", held)
        object.__setattr__(self, "provenance", dict(self.provenance))
        if self.filling is not None:
            self.filling.check_fills(self)

    def scaled(self, factor: float, name: str | None = None) -> PreparedOrgan:
        """The same organ, larger or smaller.

        Args:
            factor: By which all lengths are multiplied.
            name: Another name for it.
        """
        filling = self.filling
        if filling is not None and factor != 1.0:
            filling = TetrahedralMesh(filling.nodes * factor, filling.tetrahedra)
        return PreparedOrgan(
            self.vertices * factor,
            self.triangles,
            self.name if name is None else name,
            held=self.held,
            filling=filling,
            unit_length=self.unit_length,
            provenance=self.provenance,
        )

    def moved(self, shift: ArrayLike) -> PreparedOrgan:
        """The same organ elsewhere.

        Args:
            shift: (3,) by how much it is moved [u].
        """
        filling = self.filling
        if filling is not None:
            filling = TetrahedralMesh(filling.nodes + np.asarray(shift), filling.tetrahedra)
        return replace(self, vertices=self.vertices + np.asarray(shift), filling=filling)


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
            held=tuple(_as_held(arrays["held"]).tolist()),
            filling=filling,
            unit_length=float(arrays["unit_length"]),
            provenance=provenance,
        )
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise ValueError(f"{path.name} cannot be read as an organ: {error}") from error


def _as_held(nodes: NDArray[Any]) -> Int32Array:
    if nodes.ndim != 1 or nodes.dtype.kind not in "iu":
        raise ValueError(f"held must be integers of shape (n,), got {nodes.dtype} of shape {nodes.shape}")
    held: Int32Array = read_only(nodes, np.int32).astype(np.int32)
    return held
