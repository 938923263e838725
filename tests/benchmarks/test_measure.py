"""What the benchmarks share."""

from __future__ import annotations

import argparse

import pytest

from benchmarks.measure import output_file


def test_a_file_that_can_be_written_is_taken_and_not_made(tmp_path):
    file = tmp_path / "picture.png"
    assert output_file(str(file)) == file
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "message"),
    [(".", "is a folder"), ("missing/picture.png", "there is no folder"), ("file/x.png", "no folder")],
)
def test_a_file_that_cannot_is_refused_before_the_work(tmp_path, name, message):
    (tmp_path / "file").write_text("")
    with pytest.raises(argparse.ArgumentTypeError, match=message):
        output_file(str(tmp_path / name))
