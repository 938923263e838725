"""The random slides: can they be repeated, and are faults counted?"""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import slides
from benchmarks.inspection import Tally


def test_a_case_is_made_from_its_number_alone():
    drawn = [slides.draw(3, number) for number in range(300)]
    assert drawn == [slides.draw(3, number) for number in range(300)]
    assert len(set(drawn)) == 300
    rates = np.array([np.linalg.norm(slide.turning) for slide in drawn])
    assert 0.5 < (rates > 0.0).mean() < 0.8
    assert rates[rates > 0.0].min() >= slides.TURNING[0]
    assert rates.max() <= slides.TURNING[1] + 1e-9
    for name, (low, high) in (
        ("depth", slides.DEPTHS),
        ("speed", slides.SPEEDS),
        ("friction", slides.FRICTION),
    ):
        values = [getattr(slide, name) for slide in drawn]
        assert low <= min(values) < max(values) <= high
    assert {slide.scene for slide in drawn} == set(slides.SCENES)


def outcome(**seen):
    return slides.Outcome(slides.draw(0, seen.pop("number", 0)), Tally(**seen), crossed_at_end=False, dt=0.01)


@pytest.mark.parametrize(
    "seen", [{"deep": 1, "depth": 0.02}, {"wrong_side": 1}, {"diverged": True}, {"longest_crossed": 11}]
)
def test_what_goes_wrong_is_a_failure(seen):
    assert outcome(**seen).failed
    good = outcome(steps=5, longest_crossed=10)
    assert not good.failed
    summary = slides.summarise([good, replace(outcome(**seen), slide=slides.draw(0, 7))])
    assert (summary["cases"], summary["failed"], summary["failed_cases"]) == (2, 1, [7])
    assert summary["worst"][0]["slide"]["number"] == 7
    assert slides.describe(summary).startswith("1 of 2 slides failed")


def test_the_command_repeats_a_case_and_prints_one_line_of_json(monkeypatch, capsys):
    def run_main(*options):
        monkeypatch.setattr(sys, "argv", ["slides", *options])
        slides.main()
        output = capsys.readouterr().out.splitlines()
        return output, json.loads(output[-1])

    fast = max(range(40), key=lambda number: slides.draw(slides.SEED, number).speed)
    output, many = run_main("--cases", "1", "--first", str(fast), "--workers", "1", "--json")
    assert len(output) == 1
    output, one = run_main("--case", str(fast))
    assert one["slide"]["number"] == fast
    assert len(output) >= one["steps"]
    assert (many["steps"], many["depth"]["max"]) == (one["steps"], one["depth"])
    with pytest.raises(SystemExit):
        run_main("--cases", "0")
