"""A brain's hemisphere is retracted at the fissure between the two: `python scripts/brain_example.py`.

The surfaces are the pial ones of fsaverage5 (B. Fischl et al., High-resolution intersubject averaging and a coordinate
system for the cortical surface, Human Brain Mapping 8(4), 1999), which the package nilearn brings along; the extra
anatomy reads and prepares them, and Netgen, of the extra tissue, fills them. The scripted expert of Spatula/Retract-v0
does the rest, in the engine of springs and in that of tissue. The pictures are docs/images/brain_retraction.png.
"""

from __future__ import annotations

import argparse
import gzip
import tempfile
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

import spatula_env
from spatula_env.anatomy import PrepareOptions, prepare_organ
from spatula_env.geometry.prepared import PreparedOrgan, write_prepared
from spatula_env.learning.experts import RetractExpert

if TYPE_CHECKING:
    from numpy.typing import NDArray

gym.register_envs(spatula_env)

SIDE = 420
"""Width and height of a picture [pixels]."""

NODES = 2000
"""Nodes of the surface of both hemispheres."""

BETWEEN = 0.015
"""Distance from the plane between the hemispheres within which a place counts as between them [m]."""


def data_folder() -> Path | None:
    """Folder of the surfaces within nilearn; None if it is not installed. The package is not imported."""
    found = find_spec("nilearn")
    if found is None or not found.submodule_search_locations:
        return None
    folder = Path(found.submodule_search_locations[0]) / "datasets" / "data" / "fsaverage5"
    return folder if folder.is_dir() else None


def both_hemispheres(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) [mm] and triangles (T, 3) of both pial surfaces."""
    import nibabel

    vertices: list[NDArray[np.float64]] = []
    triangles: list[NDArray[np.int64]] = []
    for side in ("left", "right"):
        text = gzip.decompress((folder / f"pial_{side}.gii.gz").read_bytes())
        points, faces = (array.data for array in nibabel.GiftiImage.from_bytes(text).darrays)
        triangles.append(faces.astype(np.int64) + sum(map(len, vertices)))
        vertices.append(points.astype(np.float64))
    return np.concatenate(vertices), np.concatenate(triangles)


def prepared_brain(folder: Path, nodes: int = NODES, fill: str = "auto") -> PreparedOrgan:
    """Both hemispheres as one organ, held below 30 mm, the fissure between them open."""
    import trimesh

    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "brain.ply"
        trimesh.Trimesh(*both_hemispheres(folder), process=False).export(file)
        options = PrepareOptions(units="mm", keep_islands=True, nodes=nodes, hold=("z<0.03",), fill=fill)
        return prepare_organ(file, options)[0]


def retract(file: Path, engine: str, episodes: int, *, draw: bool = False) -> tuple[dict[str, Any], Any]:
    """Let the expert retract at the first places of an organ.

    Args:
        file: File of the organ.
        engine: Name of an engine.
        episodes: Number of episodes, with the seeds 0 and following.
        draw: Whether there is to be a picture, of the first success between the hemispheres in the front half.

    Returns:
        Numbers of episodes, of successes, and of places between the hemispheres; the median
        time to success [s] and the greatest force [N]; and the picture (height, width, 3), None for none.
    """
    mode = "rgb_array" if draw else None
    env = gym.make("Spatula/Retract-v0", engine=engine, organ=file, render_mode=mode, width=SIDE, height=SIDE)
    expert, times, forces, between, picture = RetractExpert(env), [], [], 0, None
    made: Any = env.unwrapped
    rest, slices = made.task.setting.rest_nodes, made.observation_builder.slices
    middle = 0.5 * (rest.min(axis=0) + rest.max(axis=0))
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        aside, ahead = (observation[slices["patch_position"]] - middle)[:2]
        between += bool(abs(aside) < BETWEEN)
        for _ in range(120):
            observation, _, _, _, info = env.step(expert(observation))
            if info["is_success"]:
                break
        times.append(info["time"] if info["is_success"] else np.nan)
        forces.append(info["episode_peak_force"])
        if draw and picture is None and info["is_success"] and abs(aside) < BETWEEN and ahead < 0.0:
            picture = env.render()
    env.close()
    solved = np.isfinite(times)
    told = {
        "engine": engine,
        "episodes": episodes,
        "successes": int(solved.sum()),
        "time": float(np.median(np.array(times)[solved])) if solved.any() else None,
        "force": float(max(forces)),
        "between": between,
    }
    return told, picture


def main(arguments: Sequence[str] | None = None) -> int:
    """Prepare, retract, tell and draw; returns the exit status."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--engines", nargs="+", default=["batch", "tissue"], help="default: %(default)s")
    options.add_argument("--episodes", type=int, default=16, help="default: %(default)s")
    options.add_argument("--picture", type=Path, default=Path("docs/images/brain_retraction.png"))
    chosen = options.parse_args(arguments)
    folder = data_folder()
    if folder is None:
        print("needs nilearn, whose files it reads: pip install nilearn")
        return 2
    organ = prepared_brain(folder)
    print(f"{len(organ.vertices)} nodes, {0 if organ.filling is None else len(organ.filling.tetrahedra)} tetrahedra")
    pictures = []
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "brain.npz"
        write_prepared(file, organ)
        for engine in chosen.engines:
            with warnings.catch_warnings():
                # The surface is finer than springs bear, which docs/anatomy.md tells.
                warnings.simplefilter("ignore")
                told, picture = retract(file, engine, chosen.episodes, draw=True)
            if picture is not None:
                pictures.append(picture)
            print(
                f"{engine}: {told['successes']} of {told['episodes']} episodes, {told['between']} of them between the "
                f"hemispheres; {told['time']:.2f} s to success; {told['force']:.2f} N at most",
                flush=True,
            )
    from PIL import Image

    Image.fromarray(np.concatenate(pictures, axis=1)).save(chosen.picture, optimize=True)
    print(chosen.picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
