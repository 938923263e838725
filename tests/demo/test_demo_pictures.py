from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from spatula_env import scenes
from spatula_env.demo.animation import episode_frames, film_frames
from spatula_env.demo.episode import Episode, Frame
from spatula_env.demo.pictures import BOTH, Caption, PressPainter, node_colors, side_by_side, with_caption
from spatula_env.demo.press import PressFilm, Snapshot
from spatula_env.render import palette
from spatula_env.render.films import encode_gif


def make_snapshot(time: float = 0.0, height: float = 6.2, force: float = 0.0) -> Snapshot:
    placed = scenes.seed()
    count = len(placed.tools[0].tool.nodes)
    return Snapshot(
        time=time,
        nodes=placed.organs[0].vertices,
        tool_position=np.array([0.0, 0.0, height]),
        tool_orientation=np.array([0.0, 0.0, 0.0, 1.0]),
        flags=np.zeros(count, dtype=np.bool_),
        unfeasible=np.zeros(count, dtype=np.bool_),
        force=np.array([0.0, 0.0, force]),
    )


def test_colours_say_what_a_node_is_doing() -> None:
    snapshot, opposite = make_snapshot(), scenes.seed().tools[0].tool.opposite
    snapshot.flags[[0, 1, opposite[1]]] = True
    snapshot.unfeasible[opposite[0]] = True
    colors = node_colors(snapshot, opposite)
    assert_allclose(colors[0], palette.FEASIBLE)
    assert_allclose(colors[opposite[0]], palette.UNFEASIBLE)
    assert_allclose(colors[[1, opposite[1]]], [BOTH, BOTH])
    assert_allclose(colors[2], palette.IDLE)
    assert_allclose(node_colors(snapshot, opposite, watched=True), np.tile(palette.IDLE, (len(opposite), 1)))


def test_the_picture_shows_organ_tool_nodes_and_arrow() -> None:
    painter = PressPainter(160, 120)
    above, inside = (painter.draw(make_snapshot(height=height)) for height in (6.2, 4.6))
    assert above.shape == (120, 160, 3)
    red, green = above[..., 0].astype(int), above[..., 1].astype(int)
    assert 0.1 < (red - green > 60).mean() < 0.6  # tissue
    assert (above != inside).any(axis=-1).sum() > 50
    plain = painter.draw(make_snapshot(height=4.6), nodes=False)
    assert (plain != inside).any()
    pushed = painter.draw(make_snapshot(height=4.6, force=6.0), nodes=False, arrow=True).astype(int)
    blue = pushed[..., 2] - pushed[..., 0] > 60
    assert blue.sum() > 20
    assert not (plain[..., 2].astype(int) - plain[..., 0] > 60).any()


def test_an_inset_lies_in_the_upper_right_corner() -> None:
    plain = PressPainter(160, 120).draw(make_snapshot(height=4.6))
    changed = (PressPainter(160, 120, inset=50).draw(make_snapshot(height=4.6)) != plain).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert changed.sum() > 1000
    assert rows.max() < 60
    assert columns.min() > 90


def test_a_caption_is_drawn_below_the_picture() -> None:
    picture = np.full((60, 640, 3), 128, dtype=np.uint8)
    page = np.asarray(with_caption(picture, Caption("Title", ("a line", "another"), ((BOTH, "both"),))))
    assert page.shape[1] == 640
    assert_allclose(page[:60], 128)
    words = page[60:].astype(int)
    assert (words.min(axis=-1) < 120).sum() > 50
    orange = (words[..., 0] > 200) & (words[..., 2] < 80)
    assert orange.any()


def test_pictures_side_by_side() -> None:
    pages = [Image.new("RGB", (30, 20), color) for color in ("red", "blue")]
    row = side_by_side(pages, gap=4)
    assert row.size == (64, 20)
    assert row.getpixel((10, 10)) == (255, 0, 0)
    assert row.getpixel((32, 10)) == (255, 255, 255)
    assert row.getpixel((50, 10)) == (0, 0, 255)


def test_a_gif_plays_all_frames_and_keeps_rare_colours() -> None:
    frames = []
    for index in range(5):
        # A gradient that would take the whole palette, and a small mark.
        across, down = np.meshgrid(np.arange(96), np.arange(64))
        frame = np.stack([across * 2, down * 3, across + down], axis=-1).astype(np.uint8)
        frame[10:14, 10 * index : 10 * index + 4] = [round(255 * part) for part in palette.FORCE]
        frames.append(frame)
    film = Image.open(io.BytesIO(encode_gif(frames, duration=70, last_duration=900)))
    assert film.n_frames == 5
    durations = []
    for index in range(5):
        film.seek(index)
        durations.append(film.info["duration"])
        mark = np.asarray(film.convert("RGB"))[11, 10 * index + 1]
        assert_allclose(mark / 255.0, palette.FORCE, atol=0.02)
    assert durations == [70, 70, 70, 70, 900]


def test_a_film_shows_the_force_over_time() -> None:
    forces = np.concatenate([np.zeros(10), np.full(30, 4.0)])
    snapshots = tuple(make_snapshot(time, 5.9, force) for time, force in ((0.025, 0.0), (0.1, 4.0)))
    first, last = film_frames(PressFilm(snapshots, forces, 0.0025, 20.0), width=200)
    assert first.size == last.size
    strip = round(0.72 * 200)
    blue = [
        (np.asarray(frame)[strip:, :, 2].astype(int) - np.asarray(frame)[strip:, :, 0] > 60).sum()
        for frame in (first, last)
    ]
    assert blue[0] > 0
    assert blue[1] > 2 * blue[0]


@pytest.mark.parametrize("highest", [0.0, 1e-6])
def test_a_film_without_force_can_be_drawn(highest: float) -> None:
    (frame,) = film_frames(PressFilm((make_snapshot(0.1),), np.full(40, highest), 0.0025, 20.0), width=120)
    assert np.ptp(np.asarray(frame)) > 100


@pytest.mark.parametrize(("width", "words"), [(200, 5), (360, 12)])
def test_an_episode_says_who_acts_below_its_pictures(width: int, words: int) -> None:
    def strip(policy: str) -> np.ndarray:
        picture = np.full((width, width, 3), 90, dtype=np.uint8)
        frames = tuple(Frame(picture, 0.4 * k, 0.001 * k, 0.1 * k) for k in range(2))
        episode = Episode(
            task="Spatula/Press-v0", policy=policy, origin="of " + words * "long " + "origin", seed=0, success=True,
            steps=8, time=0.4, total_reward=1.0, goal_depth=0.01, depth_error=0.0, peak_force=0.1, frames=frames,
            frame_time=0.4,
        )  # fmt: skip
        pages = [np.asarray(page).astype(int) for page in episode_frames(episode)]
        assert all((page[:width] == 90).all() for page in pages)
        # What is written of the moment changes.
        assert (pages[0] != pages[1]).any()
        return pages[1][width:]

    named, other = strip("trained policy"), strip("scripted expert")
    assert (named != other).any()
    # However long a line is, it ends before the picture's edge.
    assert (named[:, -width // 60 :] == 255).all()
    assert (named.min(axis=-1) < 140).sum() > 50
