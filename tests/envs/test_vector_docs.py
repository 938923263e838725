"""The code in docs/vector-environments.md runs; with fewer worlds and steps than there, to be quick."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "vector-environments.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
SMALLER = {
    "num_envs=64": "num_envs=4",
    '"Spatula/Press-v0", 64': '"Spatula/Press-v0", 4',
    "n_steps=32, batch_size=256": "n_steps=4, batch_size=16",
    "64 * 200": "4 * 200",
    "gradient_steps=16": "gradient_steps=1",
    "learn(20_000)": "learn(16)",
}


def test_all_that_is_made_smaller_is_there() -> None:
    assert all(any(name in block for block in BLOCKS) for name in SMALLER)


@pytest.mark.parametrize("index", range(len(BLOCKS)))
def test_a_block_runs_as_pasted(index: int, capsys: pytest.CaptureFixture[str]) -> None:
    code = BLOCKS[index]
    if "stable_baselines3" in code:
        pytest.importorskip("stable_baselines3")
    for name, smaller in SMALLER.items():
        code = code.replace(name, smaller)
    exec(compile(code, f"vector-environments.md, block {index}", "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out.splitlines()
    told = [told.replace("64", "4") for told in re.findall(r"print\(.*\)  # (.*)", BLOCKS[index])]
    assert printed[len(printed) - len(told) :] == told
