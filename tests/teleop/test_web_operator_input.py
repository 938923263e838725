"""Keys held on the pages, and the messages that a page may send."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop.keys import RATE_NAMES
from spatula_env.teleop.web.operator_input import AWAY, KEYS, SILENT, SLOW, OperatorInput, hints
from spatula_env.teleop.web.page_server import LARGEST_WORD, read_word


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def hands(clock):
    return OperatorInput(clock)


def test_every_rate_has_keys_for_both_directions():
    for name in RATE_NAMES:
        assert {share for rate, share in KEYS.values() if rate == name} == {-1.0, 1.0}


def test_keys_add_up(hands):
    hands.hear(1, ["KeyW", "KeyD", "Comma"])
    assert hands.rates() == {"y": 1.0, "x": 1.0, "jaw_speed": -1.0}
    hands.hear(1, ["KeyW", "ArrowUp"])
    assert hands.rates() == {"y": 1.0}
    hands.hear(1, ["KeyW", "ArrowUp", "KeyS"])
    assert hands.rates() == {"y": 1.0}
    hands.hear(1, ["KeyW", "ShiftLeft", "KeyZ"])
    assert hands.rates() == {"y": SLOW}


def test_opposite_keys_cancel(hands):
    hands.hear(1, ["KeyW"])
    hands.hear(2, ["KeyS"])
    assert hands.rates() == {"y": 0.0}
    hands.leave(2)
    assert hands.rates() == {"y": 1.0}


def test_only_keys_that_went_down_are_news(hands):
    assert hands.hear(1, ["Enter", "KeyW"]) == {"Enter", "KeyW"}
    assert hands.hear(1, ["Enter"]) == frozenset()
    assert hands.hear(2, ["Enter"]) == {"Enter"}
    hands.hear(1, [])
    assert hands.hear(1, ["Enter"]) == {"Enter"}


def test_a_silent_page_holds_nothing_and_then_is_gone(hands, clock):
    hands.hear(1, ["KeyW"])
    hands.drag(np.array([1.0, 2.0, 3.0]))
    clock.now += 0.9 * SILENT
    assert hands.rates() and hands.target is not None and hands.active
    clock.now += 0.2 * SILENT
    assert hands.rates() == {} and hands.target is None and not hands.active
    assert hands.present
    clock.now += AWAY
    assert not hands.present
    hands.hear(1, [])
    assert hands.present and hands.target is not None


def test_a_hidden_page_holds_nothing_and_is_not_looked_at(hands):
    hands.hear(1, ["KeyW"], hidden=True)
    assert hands.rates() == {} and not hands.present
    hands.hear(2, [])
    assert hands.present


def test_targets_are_copies(hands):
    hands.hear(1, [])
    place = np.zeros(3)
    hands.drag(place)
    place += 1.0
    assert np.array_equal(hands.target, np.zeros(3))
    hands.drag(None)
    assert hands.target is None


def test_waiting_ends_when_somebody_looks():
    hands = OperatorInput()
    assert not hands.wait(0.01)
    threading.Timer(0.05, hands.hear, (1, [])).start()
    assert hands.wait(30.0)


KNOWN = ("KeyW", "Enter")


@given(st.one_of(st.text(), st.binary(), st.recursive(st.none() | st.integers() | st.text(), st.lists).map(json.dumps)))
def test_nonsense_is_not_heard(word):
    assert read_word(word, KNOWN) is None


@given(st.lists(st.one_of(st.sampled_from(KNOWN), st.text(), st.none(), st.lists(st.integers()))), st.booleans())
def test_only_known_keys_are_heard(said, hidden):
    word = json.dumps({"keys": said, "hidden": hidden, "more": 1})
    if len(word) <= LARGEST_WORD:
        assert read_word(word, KNOWN) == ({key for key in said if key in KNOWN}, hidden, None)


def test_pages_tell_how_much_they_have_drawn(hands, clock):
    assert read_word('{"keys": [], "frames": 7}', KNOWN) == (frozenset(), False, 7)
    for wrong in ("-1", "true", "1.5", "1e999", "9" * 400, '"7"'):
        assert read_word(f'{{"keys": [], "frames": {wrong}}}', KNOWN) == (frozenset(), False, None)
    assert read_word('{"keys": [], "frames": "7"}', KNOWN) == (frozenset(), False, None)
    hands.hear(1, [], frames=7)
    hands.hear(2, [])
    hands.hear(3, [], hidden=True, frames=9)
    assert hands.frames == {1: 7, 2: None}
    clock.now += AWAY + 0.1
    assert hands.frames == {}


def test_long_words_are_not_heard():
    assert read_word(json.dumps({"keys": ["x" * LARGEST_WORD]}), KNOWN) is None
    assert read_word("[" * LARGEST_WORD, KNOWN) is None


def test_turning_and_gripping_by_mouse_are_commands_too(hands, clock):
    hands.hear(1, [])
    for command, said in ((hands.turn, np.array([0.0, 0.0, 0.0, 1.0])), (hands.open, 0.012)):
        assert not hands.active
        command(said)
        assert hands.active
        clock.now += 1.1 * SILENT
        # Nobody is there to let go.
        assert not hands.active
        hands.hear(1, [])
        assert hands.active
        hands.let_go()
    assert hands.orientation is None and hands.opening is None


def test_only_keys_that_move_something_are_named():
    moves = tuple(f"velocity_{axis}" for axis in "xyz")
    plain, tilting, gripping = hints(moves), hints((*moves, "rotation_x")), hints((*moves, "jaw_speed"))
    for code, (name, _) in KEYS.items():
        assert (f'"{code}"' in tilting) <= (name in "xyz" or name == "rotation_x")
    assert all(f'"Key{letter}"' in plain for letter in "WASDEQ")
    assert '"KeyU"' in tilting and '"KeyI"' not in tilting and '"Period"' not in tilting and "arc" in tilting
    assert '"Period"' in gripping and '"KeyU"' not in gripping and "slider" in gripping
    assert "arc" not in plain and "slider" not in plain
    assert "record" in hints(moves, (("Enter", "record"),)) and "record" not in plain


def test_every_rate_that_keys_command_is_explained():
    every = hints(
        tuple(f"velocity_{axis}" for axis in "xyz") + tuple(f"rotation_{axis}" for axis in "xyz") + ("jaw_speed",)
    )
    for code in KEYS:
        if not code.startswith(("Arrow", "Page")):
            assert f'data-code="{code}"' in every
