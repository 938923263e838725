"""The code in docs/engines.md runs as pasted, and the page shows numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "engines.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("index", range(len(BLOCKS)))
def test_a_block_runs_as_pasted(index, capsys):
    exec(compile(BLOCKS[index], f"engines.md, block {index}", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.startswith("[")


def test_there_is_a_block():
    assert BLOCKS
