"""`python -m benchmarks.starting`."""

from __future__ import annotations

from benchmarks import starting


def test_each_script_runs_and_is_compared(monkeypatch, capsys):
    wanted = ("import gymnasium", "spatula envs")
    monkeypatch.setattr(starting, "SCRIPTS", {name: starting.SCRIPTS[name] for name in wanted})
    monkeypatch.setattr(starting, "RATIOS", {"spatula envs": "import gymnasium"})
    result = starting.measure(1, quiet=False)
    assert set(result["seconds"]) == set(wanted)
    assert all(seconds > 0.0 for seconds in result["seconds"].values())
    assert set(result["ratios"]) == {"spatula envs / import gymnasium"}
    assert "spatula envs" in capsys.readouterr().out
