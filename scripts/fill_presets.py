"""Fill the organs of the preset scenes with tetrahedra: writes spatula_env/geometry/filled/*.npz.

Needs Netgen: pip install -e '.[tissue]'. The meshes differ between releases of Netgen; those in the repository are
authoritative.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spatula_env import scenes
from spatula_env.geometry.tetrahedra import PRESETS, tetrahedralize

FOLDER = Path(__file__).parents[1] / "spatula_env" / "geometry" / "filled"

GRADINGS = {"seed": 0.1, "fissure": 0.3, "clamp": 0.3, "retract": 0.1}
"""Grading of each organ's mesh: the slowest growth of elements inwards with which there are at most about as many nodes
inside as on the surface."""


def main() -> None:
    """Write the files, and print the quality of the meshes."""
    FOLDER.mkdir(exist_ok=True)
    for name in PRESETS:
        organ = getattr(scenes, name)().organs[0].organ
        mesh = tetrahedralize(organ, GRADINGS[name])
        inside = mesh.nodes.copy()
        # Inner nodes need not match anything, so single precision suffices, which halves their size.
        inside[len(organ.vertices) :] = inside[len(organ.vertices) :].astype(np.float32)
        np.savez_compressed(
            FOLDER / f"{name}.npz",
            nodes=inside,
            tetrahedra=mesh.tetrahedra.astype(np.uint16),
            triangles=organ.triangles.astype(np.uint16),
        )
        print(
            f"{name}: {len(organ.vertices)} nodes of the surface, {len(mesh.nodes)} in all, {len(mesh.tetrahedra)} "
            f"tetrahedra; least altitude {mesh.altitudes.min():.3f} u, quality {mesh.qualities.min():.2f} at least and "
            f"{mesh.qualities.mean():.2f} in the mean; {(FOLDER / f'{name}.npz').stat().st_size} bytes"
        )


if __name__ == "__main__":
    main()
