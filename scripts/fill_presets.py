"""Fill the organs of the preset scenes with tetrahedra: writes spatula_env/geometry/filled/*.npz.

Needs Netgen: pip install -e '.[tissue]'. The meshes are Netgen's, and differ from release to release of it; what is in
the repository decides.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spatula_env import scenes
from spatula_env.geometry.tetrahedra import PRESETS, tetrahedralize

FOLDER = Path(__file__).parents[1] / "spatula_env" / "geometry" / "filled"

GRADINGS = {"seed": 0.1, "fissure": 0.3, "clamp": 0.3, "retract": 0.1}
"""Of each organ: as slow as leaves it about as many nodes inside as on the surface, or fewer."""


def main() -> None:
    """Write the files, and tell how good the meshes are."""
    FOLDER.mkdir(exist_ok=True)
    for name in PRESETS:
        organ = getattr(scenes, name)().organs[0].organ
        mesh = tetrahedralize(organ, GRADINGS[name])
        inside = mesh.nodes.copy()
        # Positions inside are free: single precision is enough, and half as long.
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
