"""What a visitor's messages can do: change the values of enabled controls, and move movable handles."""

from __future__ import annotations

import contextlib
import logging
import math
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from web_helpers import Script, until

from spatula_env.teleop.web import WebDevice, WebSession

viser = pytest.importorskip("viser", reason="the extra web is not installed")
msgspec = pytest.importorskip("msgspec", reason="the extra web is not installed")

from spatula_env.teleop.web import messages  # noqa: E402

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "fov": 1.0, "near": 0.1, "far": 9.0,
    "image_height": 10, "image_width": 10, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 1.0, 0.0),
}  # fmt: skip
DRAG = {
    "type": "SceneNodeDragMessage", "phase": "start", "name": "/thing", "instance_index": None,
    "start_position": (0.0, 0.0, 0.0), "start_screen_pos": (0.5, 0.5),
    "end_position": (0.0, 0.0, 0.0), "end_screen_pos": (0.5, 0.5),
    "button": "left", "modifier": None, "owner": "",
}  # fmt: skip
KINDS = {
    "ViewerCameraMessage",
    "GuiUpdateMessage",
    "TransformControlsDragStartMessage",
    "TransformControlsUpdateMessage",
    "TransformControlsDragEndMessage",
    "SceneNodeDragMessage",
}


class Line:
    """A connection as a page's own, without a page."""

    def __init__(self, device, *, camera: bool = True):
        from websockets.sync.client import connect

        self._device = device
        options = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None, "max_queue": None, "proxy": None}
        before = set(device.page.server.get_clients())
        self.socket = connect(f"ws://{urlsplit(device.url).netloc}/", **options)
        self.client = None
        if camera:
            self.send(CAMERA)
            new = until(lambda: set(device.page.server.get_clients()) - before, "a page")
            self.client = device.page.server.get_clients()[min(new)]

    def send(self, message) -> None:
        self.socket.send(message if isinstance(message, bytes) else msgspec.msgpack.encode(message))

    def use(self, control, value) -> None:
        self.send({"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": {"value": value}})

    def refused(self, *said) -> None:
        """Say something that is dropped."""
        for message in said:
            before = self._device.page.messages.dropped
            self.send(message)
            until(lambda before=before: self._device.page.messages.dropped > before, f"{message} is dropped")

    def close_code(self) -> int:
        """Wait until the other end has closed, and say how."""
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while True:
                self.socket.recv(timeout=100)
        return self.socket.close_code

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


@pytest.fixture(scope="module")
def device():
    with WebDevice(port=0) as opened:
        yield opened


@pytest.fixture(autouse=True)
def nothing_is_wrong(caplog):
    yield
    assert [each for each in caplog.records if each.levelno >= logging.ERROR] == []


@pytest.fixture
def line(device):
    with Line(device) as opened:
        yield opened


def state(device):
    """All that there is to know of the controls of all pages, but when they were used."""
    handles = device.page.server.gui._gui_input_handle_from_uuid
    return {
        uuid: {key: _copied(value) for key, value in vars(handle._impl).items() if key != "update_timestamp"}
        for uuid, handle in list(handles.items())
    }


def _copied(value):
    return list(value) if isinstance(value, list) else dict(vars(value)) if hasattr(value, "__dict__") else value


def update(control, **updates):
    return {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": updates}


def test_nobody_sets_an_attribute_of_a_control(device, line):
    button = device.panel.home
    clicked = []
    button.on_click(lambda event: clicked.append(event.client_id))
    before = state(device)
    for name in [*vars(button._impl), *vars(button._impl.props), "value2", "__class__"]:
        if name != "value":
            for value in ([], False, {}, 1):
                line.send(update(button, **{name: value}))
                line.send(update(button, value=True, **{name: value}))
    line.refused({"type": "GuiUpdateMessage", "uuid": button._impl.uuid, "updates": {}})
    assert state(device) == before and clicked == []
    line.use(button, True)
    until(lambda: len(clicked) == 1, "a click")
    with Line(device) as other:
        other.use(button, True)
        until(lambda: clicked[1:] == [other.client.client_id], "a click of another page")


def test_a_session_goes_on_recording(tmp_path):
    pytest.importorskip("minari", reason="the extra data is not installed")
    made = WebSession("Spatula/Press-v0", port=0, dataset=tmp_path, seed=0, real_time=False)
    with made as session, Script(session.url), Line(session.device) as line:
        until(lambda: session._status.text == "Practice", "practice")
        buttons = session._buttons
        for button in buttons.values():
            line.refused(update(button, update_cb=[]), update(button, is_button=False))
        # One that is hidden cannot be clicked, and a choice that is disabled cannot be made.
        line.refused(update(buttons["save"], value=True))
        line.use(buttons["record"], True)
        until(lambda: session._status.text == "Ready", "recording")
        line.refused(update(buttons["record"], value=True), update(session._choice, value="Spatula/Fissure-v0"))
        with Line(session.device) as other:
            other.use(buttons["discard"], True)
            until(lambda: session._status.text == "Practice", "practice")
        assert session.recording.discarded == 1 and session.env_id == "Spatula/Press-v0"


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("speed", [4, 101, 1e300, 2**63, math.nan, math.inf, -math.inf, True, "20", None, [20], {"a": 1}, b"x"]),
        ("see_through", [1, 0, "yes", None, [], 1.0]),
        ("home", [False, 1, "", None, [True]]),
    ],
)
def test_values_have_their_type_and_limits(device, line, name, values):
    control = getattr(device.panel, name)
    before = state(device)
    line.refused(*(update(control, value=value) for value in values))
    assert state(device) == before


def test_allowed_values_get_through(device, line):
    panel = device.panel
    for value in (5, 100, 35.0, 40):
        line.use(panel.speed, value)
        until(lambda value=value: panel.speed.value == value, "a speed")
        assert type(panel.speed.value) is int
    line.use(panel.speed, 100.0000001)
    until(lambda: panel.speed.value == 100, "a slider's end")
    for value in (True, False):
        line.use(panel.see_through, value)
        until(lambda value=value: panel.see_through.value is value, "a switch")
    # Each page has a switch of its own, and nobody else's.
    handles = line.client.gui._gui_input_handle_from_uuid
    (switch,) = until(lambda: list(handles.values()), "a switch")
    with Line(device) as other:
        other.refused(update(switch, value=True))
    line.use(switch, True)
    until(lambda: switch.value is True, "dark colours")


def test_choices_are_those_that_are_offered(device, line):
    choice = device.panel.gui.add_dropdown("Choice", ("one", "two"))
    try:
        line.refused(*(update(choice, value=value) for value in ("three", "", "x" * 10**4, 1, True, None, ["two"])))
        assert choice.value == "one"
        line.use(choice, "two")
        until(lambda: choice.value == "two", "a choice")
    finally:
        choice.remove()


def test_what_is_hidden_or_disabled_or_gone_cannot_be_used(device, line):
    gui = device.panel.gui
    folder = gui.add_folder("Folder")
    with folder, gui.add_folder("Within"):
        switch = gui.add_checkbox("Switch", False)
    other = gui.add_text("Text", "old")
    try:
        line.refused(update(other, value="new"))
        for thing, name, value in ((switch, "visible", False), (switch, "disabled", True), (folder, "visible", False)):
            setattr(thing, name, value)
            line.refused(update(switch, value=True))
            setattr(thing, name, not value)
        assert switch.value is False and other.value == "old"
        line.use(switch, True)
        until(lambda: switch.value, "a switch")
    finally:
        folder.remove()
        other.remove()
    line.refused(update(switch, value=False), {"type": "GuiUpdateMessage", "uuid": "no", "updates": {"value": True}})


def test_who_has_no_camera_does_nothing(device):
    before = state(device)
    with Line(device, camera=False) as line:
        line.refused(update(device.panel.speed, value=20))
    assert state(device) == before


@pytest.mark.parametrize(
    "wrong",
    [
        {"position": (math.nan, 0.0, 0.0)},
        {"position": (math.inf, 0.0, 0.0)},
        {"position": (1e9, 0.0, 0.0)},
        {"position": (0.0, 0.0)},
        {"position": "abc"},
        {"wxyz": (0.0, 0.0, 0.0, 0.0)},
        {"fov": 0.0},
        {"fov": math.nan},
        {"image_width": -1},
        {"image_width": 2**40},
        {"near": 0.0},
        {"camera_cb": []},
    ],
)
def test_cameras_have_sound_numbers(device, line, wrong):
    line.refused({**CAMERA, **wrong})
    line.send({**CAMERA, "position": (0, 1, 2), "image_width": 20})
    until(lambda: line.client.camera.image_width == 20, "a camera")
    assert line.client.camera.position == pytest.approx([0.0, 1.0, 2.0])


@pytest.fixture
def gizmo(device):
    made = device.page.server.scene.add_transform_controls("/gizmo", translation_limits=((-5.0, 5.0),) * 3)
    made.phases = []

    async def moved(event):
        made.phases.append((event.phase, tuple(event.target.position), tuple(event.target.wxyz)))

    made.on_update(moved)
    yield made
    made.remove()


START = {"type": "TransformControlsDragStartMessage", "name": "/gizmo", "owner": ""}
END = {"type": "TransformControlsDragEndMessage", "name": "/gizmo", "owner": ""}


def moved_to(*position, wxyz=(1, 0, 0, 0), **more):
    return {
        "type": "TransformControlsUpdateMessage", "name": "/gizmo", "owner": "", "position": position, "wxyz": wxyz,
        **more,
    }  # fmt: skip


def test_a_handle_is_taken_moved_and_let_go(device, line, gizmo):
    line.refused(moved_to(1, 2, 3), END, {**START, "name": "/none"}, {**START, "owner": "x"})
    line.send(START)
    line.send(moved_to(1, 2, 3))
    until(lambda: len(gizmo.phases) == 2, "a handle that is moved")
    with Line(device) as other:
        other.refused(moved_to(0, 0, 0), END)
    line.refused(
        moved_to(5.1, 0, 0), moved_to(math.nan, 0, 0), moved_to(0, 0), moved_to(0, 0, 0, wxyz=(0, 0, 0, 0)),
        moved_to(0, 0, 0, wxyz=(math.nan, 0, 0, 1)), moved_to(0, 0, 0, visible=False), moved_to("a", 0, 0),
    )  # fmt: skip
    gizmo.visible = False
    line.refused(START, moved_to(0, 0, 0))
    # What has been taken can always be let go.
    line.send(END)
    until(lambda: len(gizmo.phases) == 3, "an end")
    line.refused(END)
    assert [each[0] for each in gizmo.phases] == ["start", "update", "end"]
    assert tuple(gizmo.position) == (1.0, 2.0, 3.0) and tuple(gizmo.wxyz) == (1.0, 0.0, 0.0, 0.0)


def test_a_handle_that_is_held_is_let_go_with_its_page(device, gizmo):
    with Line(device) as line:
        line.send(START)
        line.send(moved_to(1, 2, 3))
        until(lambda: len(gizmo.phases) == 2, "a handle that is moved")
    until(lambda: [each[0] for each in gizmo.phases] == ["start", "update", "end"], "an end")


def test_a_handle_that_only_turns_stays_where_it_is(line, gizmo):
    gizmo.disable_axes = gizmo.disable_sliders = True
    turned = (0.0, 1.0, 0.0, 0.0)
    line.send(START)
    line.send(moved_to(1, 2, 3, wxyz=turned))
    until(lambda: len(gizmo.phases) == 2, "a handle that is turned")
    assert gizmo.phases[-1] == ("update", (0.0, 0.0, 0.0), turned)


def test_a_tool_is_let_go_by_whom_it_was_taken(device, line):
    scene = device.page.server.scene
    thing, bare = scene.add_box("/thing"), scene.add_box("/bare")
    phases = []

    async def dragged(event):
        phases.append((event.phase, event.end_position))

    thing.on_drag("left")(dragged)
    try:
        line.refused(
            {**DRAG, "phase": "update"}, {**DRAG, "phase": "end"}, {**DRAG, "name": "/bare"}, {**DRAG, "name": "/none"},
            {**DRAG, "end_position": (math.nan, 0.0, 0.0)}, {**DRAG, "phase": "wait"}, {**DRAG, "modifier": "no"},
            {**DRAG, "instance_index": 1}, {**DRAG, "owner": "0"}, {**DRAG, "more": 1},
        )  # fmt: skip
        line.send(DRAG)
        line.send({**DRAG, "phase": "update", "end_position": (1, 2, 3)})
        # As no page does: that would leave the tool taken.
        line.send({**DRAG, "phase": "end", "button": "right", "modifier": "shift"})
        until(lambda: [phase for phase, _ in phases] == ["start", "update", "end"], "a drag")
        assert phases[1][1] == (1.0, 2.0, 3.0)
        thing.visible = False
        line.refused(DRAG)
    finally:
        thing.remove()
        bare.remove()


def all_kinds():
    from viser._messages import Message

    return sorted({each.__name__ for each in Message.get_subclasses()} - KINDS)


def test_every_other_kind_of_message_is_dropped(device, line, monkeypatch):
    from viser.infra._infra import WebsockMessageHandler

    handled = []
    original = WebsockMessageHandler._handle_incoming_message

    async def handle(self, client_id, message):
        handled.append(type(message).__name__)
        await original(self, client_id, message)

    monkeypatch.setattr(WebsockMessageHandler, "_handle_incoming_message", handle)
    before = state(device)
    kinds = all_kinds()
    assert {"ShareUrlRequest", "FileTransferStartUpload", "GuiButtonHoldMessage", "SceneNodeClickMessage"} <= set(kinds)
    line.refused(*({"type": kind, "uuid": device.panel.home._impl.uuid} for kind in kinds))
    line.refused(
        {"type": "ShareUrlRequest"}, {"type": "ShareUrlDisconnect"}, {}, [], 7, "text", None, {"type": 7}, {"type": []},
        {
            "type": "FileTransferStartUpload", "source_component_uuid": device.panel.speed._impl.uuid,
            "transfer_uuid": "a", "filename": "b", "mime_type": "c", "part_count": 0, "size_bytes": 0,
        },
    )  # fmt: skip
    assert handled == [] and state(device) == before


@pytest.mark.parametrize(
    "raw",
    [b"\xc1", b"", b"\x82\xa4type", b"\x81\xa4type\xa1\xff", b"\x82\xa1z" + b"\x91" * 10000, b"\x81\xa1"],
)
def test_bytes_that_are_no_message_close_their_connection_alone(device, line, raw, capfd):
    with Line(device) as other:
        other.send(raw)
        assert other.close_code() == 1007
        number = other.client.client_id
        until(lambda: number not in device.page.server.get_clients(), "a page that is gone")
    line.use(device.panel.see_through, True)
    until(lambda: device.panel.see_through.value, "a switch")
    line.use(device.panel.see_through, False)
    until(lambda: not device.panel.see_through.value, "a switch")
    assert "Traceback" not in capfd.readouterr().err


def test_text_and_long_messages_close_their_connection_alone(device, line):
    with Line(device) as other:
        other.socket.send("text")
        assert other.close_code() == 1007
    with Line(device) as other:
        other.send(b"\x91" * 2**16)
        assert other.close_code() == 1009
    line.refused(update(device.panel.speed, value=0))


def test_the_log_has_one_line_for_a_connection(device, caplog):
    caplog.set_level(logging.WARNING)
    with Line(device) as line:
        line.refused(*[{"type": "ShareUrlRequest"}] * 5)
    ours = [each for each in caplog.records if each.name == messages.__name__]
    assert len(ours) == 1 and "left out" in ours[0].getMessage()


WORDS = st.sampled_from(
    "type uuid updates value update_cb is_button removed name owner phase wxyz position start end left update".split()
)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | WORDS | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(WORDS | st.integers(0, 9), inner, max_size=4),
    max_leaves=8,
)


@given(st.binary(max_size=60) | ANYTHING.map(msgspec.msgpack.encode))
def test_no_bytes_are_more_than_a_message_or_nothing(raw):
    with contextlib.suppress(messages.Malformed):
        found = messages.read_message(raw)
        assert found is None or isinstance(found, messages.Struct)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_message_changes_more_than_values_within_limits(device, data):
    panel = device.panel
    controls = [panel.jaws, panel.speed, panel.gizmo, panel.see_through, panel.home]
    valid = data.draw(
        st.sampled_from([CAMERA, DRAG, START, END, moved_to(0, 0, 0), *(update(each, value=1) for each in controls)])
    )
    keys = st.sampled_from(sorted(valid)) | WORDS
    said = {**valid, **data.draw(st.dictionaries(keys, ANYTHING, max_size=3))}
    if "updates" in valid and data.draw(st.booleans()):
        said = {**valid, "updates": {"value": data.draw(ANYTHING), **data.draw(st.dictionaries(WORDS, ANYTHING))}}
    before = state(device)
    with Line(device) as line:
        line.send(said)
        line.refused({"type": "ShareUrlRequest"})
    after = state(device)
    for each in (before, after):
        for control in each.values():
            value = control.pop("value")
            kind, least, most = (type(value), *(control["props"].get(end) for end in ("min", "max")))
            assert kind in (bool, int, float) and (least is None or least <= value <= most)
    assert after == before
    assert np.isfinite(panel.key_speed)
