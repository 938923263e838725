"""Every kind of damage to a dataset gives a clear error message, and other datasets are listed all the same."""

from __future__ import annotations

import json
import shutil

import pytest
from recording_helpers import ID, do_episode, make_pictures

from spatula_env.cli.main import main
from spatula_env.data import DatasetWriter, summarize
from spatula_env.data.checking import LINE, METADATA, OWN
from spatula_env.data.dataset import check_dataset_id, read_layout
from spatula_env.data.files import DatasetDamaged
from spatula_env.data.index import read_index
from spatula_env.data.replaying import open_dataset, read_entries, recorded_specs

pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")

GOOD = "spatula/test/good-v0"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    place = tmp_path_factory.mktemp("datasets")
    env = make_pictures()
    for name in (ID, GOOD):
        DatasetWriter(name, env, root=place).add(do_episode(env, 0))
    env.close()
    return place


@pytest.fixture
def root(made, tmp_path):
    shutil.copytree(made, tmp_path / "datasets")
    return tmp_path / "datasets"


def edit_line(root, content: bytes) -> None:
    """Replace the only line of the index, and tell its length."""
    data = root / ID / "data"
    (data / "index.jsonl").write_bytes(content)
    edit(root, own={"index_bytes": len(content)})


def edit(root, own=(), **changes) -> None:
    file = root / ID / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    metadata["spatula_env"] |= dict(own)
    file.write_text(json.dumps({**metadata, **changes}))


def check_told(root, capsys) -> None:
    """Check that everything that reads the dataset reports the damage, and that the other dataset is listed."""
    for call in (open_dataset, read_entries, recorded_specs, read_layout, summarize):
        try:
            call(ID, root)
        except DatasetDamaged as error:
            assert str(error)
    assert main(["datasets", "inspect", ID, "--root", str(root)]) == 1
    assert "Traceback" not in capsys.readouterr().err
    status = main(["datasets", "list", "--root", str(root)])
    told = capsys.readouterr()
    assert GOOD in told.out
    assert (status == 1) == (f"{ID} is damaged" in told.err)


LINES = {
    "attributes": [None, 5, [], {"operator": {"a": 1}}, {"device": []}],
    "total_reward": ["NaN", None, 10**400],
    "steps": ["x", -1, 10**300, None, 1.5, True],
    "spec": [7, -5, "os", None],
    "seed": ["x", -1, 2**63, 0.5],
    "size": ["x", -1, None],
    "peak_force": ["x", {}],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in LINES.items() for value in values])
def test_lines_of_the_index(root, name, value, capsys):
    assert set(LINES) == set(LINE)
    line = json.loads((root / ID / "data" / "index.jsonl").read_text())
    edit_line(root, json.dumps({**line, name: value}).encode() + b"\n")
    with pytest.raises(DatasetDamaged, match=r"index.jsonl, line 1"):
        read_index(root / ID / "data")
    check_told(root, capsys)
    assert main(["datasets", "list", "--root", str(root)]) == 1
    assert f"{ID} is damaged" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"[]\n", b"{}\n", b"5\n", b"\xff\n", b"[" * 100000, b'{"a": 1}\n', b"null\n"])
def test_lines_that_are_none(root, content, capsys):
    edit_line(root, content)
    with pytest.raises(DatasetDamaged, match=r"index.jsonl, line 1"):
        read_index(root / ID / "data")
    check_told(root, capsys)


VALUES = {
    "total_episodes": ["x", -1, None, True, 10**300, 2],
    "observation_space": ['{"type":"Nope"}', "[]", "", 5, '{"type":"Box"}'],
    "action_space": ['{"type":"Nope"}', "[]", "null"],
    "env_spec": [5, "[]", "", "{}", '{"id": 5}', "[" * 100000],
    "spatula_env": ["zzz", [], 5],
    "data_format": ["zzz", None, []],
    "author": [7, [7], {}],
    "description": [7, []],
    "last_seed": ["x", 2**70],
    "dataset_size": ["x", []],
}
OWN_VALUES = {
    "env_specs": [[1], [], "x", None, ["x"]],
    "index_bytes": ["x", -1],
    "observation_names": [[], {"a": 5}, {"a": [5]}],
    "action_names": ["x", [5]],
    "control_frequency": ["x", 0, []],
    "lerobot_names": [[], {"a": 5}],
    "workspace_low": ["x", ["x"]],
    "task": [5],
    "scene": [5],
}


@pytest.mark.parametrize(
    ("own", "name", "value"),
    [(False, name, value) for name, values in VALUES.items() for value in values]
    + [(True, name, value) for name, values in OWN_VALUES.items() for value in values],
)
def test_metadata(root, own, name, value, capsys):
    assert set(VALUES) <= set(METADATA)
    assert set(OWN_VALUES) <= set(OWN)
    if own:
        edit(root, own={name: value})
    else:
        edit(root, **{name: value})
    check_told(root, capsys)


@pytest.mark.parametrize("content", ["", "[]", "5", "{}", "[" * 100000, "\0"])
def test_metadata_that_are_none(root, content, capsys):
    (root / ID / "data" / "metadata.json").write_text(content)
    check_told(root, capsys)
    assert main(["datasets", "list", "--root", str(root)]) == 1


def test_more_episodes_than_there_are(root):
    file = root / ID / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    del metadata["spatula_env"]["index_bytes"]
    file.write_text(json.dumps({**metadata, "total_episodes": 2**62}))
    with pytest.raises(DatasetDamaged, match="episode 1 is missing"):
        read_entries(ID, root)


def test_what_is_written_fits(root):
    """Numbers that have diverged, for instance, are kept."""
    env = make_pictures()
    episode = do_episode(env, 1)
    episode.rewards[-1] = float("nan")
    DatasetWriter(ID, env, root=root).add(episode)
    env.close()
    assert len(read_entries(ID, root)) == 2
    assert main(["datasets", "inspect", ID, "--root", str(root)]) == 0


EVIL = "\x1b]0;owned\x07\x1b[2Jred\nspatula: all is well\r\x9b1m\u202e"


def test_text_from_a_dataset_tells_the_terminal_nothing(root, capsys):
    line = json.loads((root / ID / "data" / "index.jsonl").read_text())
    line["attributes"] |= {"operator": EVIL, "author": EVIL, "device": EVIL}
    edit_line(root, json.dumps(line).encode() + b"\n")
    edit(root, description=EVIL, own={"observation_names": {"state": [EVIL] * 4}, "action_names": [EVIL] * 3})
    for words in (["inspect", ID], ["list"], ["statistics", ID]):
        assert main(["datasets", *words, "--root", str(root)]) == 0
        told = capsys.readouterr()
        assert not set(told.out + told.err) & set("\x1b\x07\x9b\r\u202e")
        assert "\\x1b[2Jred\\nspatula" in told.out
        assert not [row for row in told.out.splitlines() if row.startswith("spatula: all")]
    file = root / ID / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    spec = json.loads(metadata["env_spec"])
    edit(root, own={"env_specs": [json.dumps({**spec, "id": EVIL})]}, env_spec=json.dumps({**spec, "id": EVIL}))
    assert main(["replay", ID, "--root", str(root)]) == 1
    told = capsys.readouterr()
    assert not set(told.err) & set("\x1b\x07\x9b\r\u202e")
    assert len([row for row in told.err.splitlines() if row.startswith("spatula")]) == 1


@pytest.mark.parametrize(
    ("name", "reason", "better"),
    [
        ("x-v0/", "", "x-v0"),
        ("lab/x-v0/", "", "lab/x-v0"),
        ("t/base-v0", "a NAMESPACE of one letter", "base-v0"),
        ("a/b-v0", "a NAMESPACE of one letter", "b-v0"),
        ("mydata", "", "mydata-v0"),
    ],
)
def test_a_name_that_is_taken_is_told_with_the_reason(name, reason, better):
    with pytest.raises(ValueError, match="dataset must be named as") as caught:
        check_dataset_id(name)
    assert reason in str(caught.value)
    assert str(caught.value).endswith(f"say {better!r}")
    check_dataset_id(better)
