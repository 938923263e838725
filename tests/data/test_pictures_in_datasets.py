"""Pictures in datasets are stored without loss, and every version of Minari reads them."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recording_helpers import do_episode, make_pictures

minari = pytest.importorskip("minari", reason="the extra data is not installed")
Image = pytest.importorskip("PIL.Image")

from spatula_env.data import pictures  # noqa: E402
from spatula_env.data.catalog import copy_episodes  # noqa: E402
from spatula_env.data.dataset import DatasetWriter, check_target  # noqa: E402
from spatula_env.data.pictures import can_be_encoded, encode_pictures, reads_plain_pictures  # noqa: E402
from spatula_env.data.replaying import open_dataset  # noqa: E402

ID = "spatula/pictures/all-v0"


def image_space(*shape):
    return gym.spaces.Box(0, 255, shape, np.uint8)


@pytest.fixture
def env():
    made = make_pictures()
    yield made
    made.close()


def metadata_file(root, dataset_id=ID):
    return root / dataset_id / "data" / "metadata.json"


SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40)).flatmap(
    lambda size: st.sampled_from([size, *((*size, channels) for channels in pictures.CHANNELS)])
)


@given(SHAPES.flatmap(lambda shape: arrays(np.uint8, st.integers(1, 4).map(lambda count: (count, *shape)))))
def test_a_picture_comes_back_as_it_was(given):
    encoded = encode_pictures(given)
    assert encoded.dtype == np.uint8
    for content, picture in zip(encoded, given, strict=True):
        # As Minari reads it, what fills it up included.
        np.testing.assert_array_equal(np.array(Image.open(io.BytesIO(content)), dtype=np.uint8), picture)


@pytest.mark.parametrize("shape", [(40, 33), (40, 33, 2), (40, 33, 3), (40, 33, 4)])
@pytest.mark.parametrize("nested", [False, True])
def test_minari_reads_pictures_of_any_kind(shape, nested, tmp_path, monkeypatch, env):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    space = image_space(*shape)
    space = (
        gym.spaces.Dict({"left": gym.spaces.Dict({"eye": space}), "x": gym.spaces.Box(-1, 1, (2,))})
        if nested
        else space
    )
    space.seed(0)
    told = SimpleNamespace(spec=env.spec, observation_space=space, action_space=env.action_space)
    episode = do_episode(env, 0)
    seen = [space.sample() for _ in range(len(episode) + 1)]
    stacked = (
        {"left": {"eye": np.stack([each["left"]["eye"] for each in seen])}, "x": np.stack([each["x"] for each in seen])}
        if nested
        else np.stack(seen)
    )
    object.__setattr__(episode, "observations", stacked)
    DatasetWriter(ID, told).add(episode)
    (found,) = minari.load_dataset(ID).iterate_episodes()
    if nested:
        np.testing.assert_array_equal(found.observations["left"]["eye"], stacked["left"]["eye"])
        np.testing.assert_array_equal(found.observations["x"], stacked["x"])
    else:
        np.testing.assert_array_equal(found.observations, stacked)


def make_plain(root, env, monkeypatch):
    """A dataset with plain arrays of pictures, as earlier versions wrote them."""
    with monkeypatch.context() as changed:
        changed.setattr("spatula_env.data.dataset.check_pictures", lambda env: False)
        writer = DatasetWriter(ID, env, root=root)
    writer.add(do_episode(env, 0))
    assert json.loads(metadata_file(root).read_text())["jpeg_encoding"] is False


@pytest.mark.skipif(not reads_plain_pictures(), reason="Minari 0.5.3, the last for Python 3.10, does not read them")
def test_datasets_of_plain_pictures_are_added_to_and_copied(tmp_path, monkeypatch, env):
    make_plain(tmp_path, env, monkeypatch)
    DatasetWriter(ID, env, root=tmp_path).add(do_episode(env, 1))
    assert json.loads(metadata_file(tmp_path).read_text())["jpeg_encoding"] is False
    copy_episodes([ID], "spatula/pictures/copy-v0", root=tmp_path)
    for name in (ID, "spatula/pictures/copy-v0"):
        for seed, found in enumerate(open_dataset(name, tmp_path).iterate_episodes()):
            np.testing.assert_array_equal(found.observations["image"], do_episode(env, seed).observations["image"])
    assert json.loads(metadata_file(tmp_path, "spatula/pictures/copy-v0").read_text())["jpeg_encoding"] is True


def test_a_minari_that_does_not_read_plain_pictures_says_so(tmp_path, monkeypatch, env):
    make_plain(tmp_path, env, monkeypatch)
    for module in ("dataset", "replaying"):
        monkeypatch.setattr(f"spatula_env.data.{module}.reads_plain_pictures", lambda: False)
    with pytest.raises(ValueError, match=r"has pictures that Minari 0\.5\.4 reads, which needs Python 3\.11"):
        open_dataset(ID, tmp_path)
    many = SimpleNamespace(spec=env.spec, observation_space=image_space(40, 40, 5), action_space=env.action_space)
    with pytest.raises(ValueError, match="pictures must have 2 to 4 channels, or no axis for channels"):
        check_target("spatula/pictures/other-v0", many, tmp_path)
    assert not (tmp_path / "spatula/pictures/other-v0").exists()


def test_what_is_no_picture_to_minari_is_kept_as_it_is():
    assert can_be_encoded(image_space(40, 40, 3), gym.spaces.Box(-1, 1, (3,)), image_space(8, 8, 7))
    assert not can_be_encoded(gym.spaces.Dict({"a": gym.spaces.Tuple([image_space(40, 40, 5)])}))
