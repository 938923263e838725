"""Every kind of damage to a policy's file gives a clear error message when it is read."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import pytest

from spatula_env.cli.main import main
from spatula_env.learning.configuration import load_yaml
from spatula_env.policies import ExportedPolicy, pretrained_path, read_provenance

SOURCE = pretrained_path("Spatula/Press-v0")


@pytest.fixture(scope="module")
def arrays():
    with np.load(SOURCE) as found:
        return dict(found)


def write(path, arrays, header=None, **changes):
    kept = {**arrays, **changes}
    if header is not None:
        kept["header"] = np.array(header)
    np.savez(path, **kept)
    return path


HEADERS = {
    "activation": ["__import__", None, [], {}],
    "metadata": ["x", None, [], {"env_id": 5}, {"env_kwargs": "x"}, {"parts": "x"}, {"parts": [5]}],
    "layers": [0, -1, 10**9, "x", None, True],
    "entries": [5, [5], None, ["nothing"] * 100],
    "clip": ["x", None, []],
    "squash": ["x", None],
    "format": [0, "x", None, []],
}


@pytest.mark.parametrize(("name", "value"), [(name, each) for name, values in HEADERS.items() for each in values])
def test_headers(arrays, tmp_path, name, value):
    header = {**json.loads(str(arrays["header"])), name: value}
    with pytest.raises(ValueError, match="holds no exported policy"):
        ExportedPolicy.load(write(tmp_path / "x.npz", arrays, json.dumps(header)))


@pytest.mark.parametrize("header", ["", "x", "[]", "{}", "5", "[" * 100000])
def test_headers_that_are_none(arrays, tmp_path, header):
    with pytest.raises(ValueError, match="holds no exported policy"):
        ExportedPolicy.load(write(tmp_path / "x.npz", arrays, header))


@pytest.mark.parametrize("name", ["low", "high", "mean_0", "scale_0", "weights_0", "biases_0"])
@pytest.mark.parametrize("value", [np.zeros(2), np.zeros((2, 2)), np.float64(0), np.array("x"), np.zeros(0)])
def test_arrays_that_do_not_fit(arrays, tmp_path, name, value):
    with pytest.raises(ValueError, match="holds no exported policy"):
        ExportedPolicy.load(write(tmp_path / "x.npz", arrays, **{name: value}))


def huge(path):
    """Weights whose declared size is larger than any memory."""
    with zipfile.ZipFile(SOURCE) as whole, zipfile.ZipFile(path, "w") as changed:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "weights_0.npy":
                head = io.BytesIO()
                told = {"descr": "<f4", "fortran_order": False, "shape": (10**15,)}
                np.lib.format.write_array_header_1_0(head, told)
                content = head.getvalue() + b"\0" * 1000
            changed.writestr(name, content)


def truncated(path):
    path.write_bytes(SOURCE.read_bytes()[:3000])


def empty(path):
    path.write_bytes(b"")


def no_archive(path):
    path.write_bytes(b"zzz" * 1000)


def one_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


@pytest.mark.parametrize("make", [huge, truncated, empty, no_archive, one_array])
def test_files_that_are_none(tmp_path, make, capsys):
    make(tmp_path / "x.npz")
    with pytest.raises(ValueError, match="holds no exported policy"):
        ExportedPolicy.load(tmp_path / "x.npz")
    assert main(["evaluate", "--env", "press", "--policy", str(tmp_path / "x.npz"), "--episodes", "1"]) == 1
    assert "holds no exported policy" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["[" * 3000, "a: [", "\0"])
def test_configurations(tmp_path, content, capsys):
    (tmp_path / "config.yaml").write_text(content)
    (tmp_path / "model.zip").write_bytes(b"")
    with pytest.raises(ValueError, match="this is not YAML"):
        load_yaml(tmp_path / "config.yaml")
    pytest.importorskip("stable_baselines3", reason="pip install 'spatula-env[train]'")
    assert main(["evaluate", "--env", "press", "--policy", str(tmp_path), "--episodes", "1"]) == 1
    assert "this is not YAML" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["[]", "x", "[" * 100000])
def test_provenance(tmp_path, content):
    (tmp_path / "x.json").write_text(content)
    with pytest.raises(ValueError, match=r"x\.json"):
        read_provenance(tmp_path / "x.npz")


def test_those_that_come_with_the_package_are_whole():
    for file in SOURCE.parent.glob("*.npz"):
        assert ExportedPolicy.load(file).layers
