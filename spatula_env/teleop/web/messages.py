"""Validation of the messages that pages send to viser: few kinds, and only values that a control or handle accepts.

viser trusts any message as if its own page had sent it: a message can set any attribute of a control, callbacks
included. So viser gets each connection wrapped in a guard, which passes on only what a user can do on the page,
re-encoded from the checked data. Everything else is dropped.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

logger = logging.getLogger(__name__)

LONGEST_NAME = 200
"""Greatest number of characters in a name, an id or a choice."""
UNIT_TOLERANCE = 1e-2
"""Greatest deviation of a quaternion's norm from 1."""
ROUNDING = 1e-6
"""Tolerance beyond a slider's ends, as a share of its range, because pages count in steps."""

Name = Annotated[str, Meta(max_length=LONGEST_NAME)]
Length = Annotated[float, Meta(ge=-1e6, le=1e6)]
Component = Annotated[float, Meta(ge=-1.0 - UNIT_TOLERANCE, le=1.0 + UNIT_TOLERANCE)]
Pixels = Annotated[int, Meta(ge=0, le=2**16)]
Vector = tuple[Length, Length, Length]
Quaternion = tuple[Component, Component, Component, Component]
Modifier = Literal["cmd/ctrl", "alt", "shift", "cmd/ctrl+alt", "cmd/ctrl+shift", "alt+shift", "cmd/ctrl+alt+shift"]
# The nodes of the scene are shared by all pages; nodes of a single page are not used here.
Everybody = Literal[""]


class Camera(Struct, tag="ViewerCameraMessage", forbid_unknown_fields=True, frozen=True):
    """A page's camera."""

    wxyz: Quaternion
    position: Vector
    fov: Annotated[float, Meta(gt=0.0, lt=math.pi)]
    near: Annotated[float, Meta(gt=0.0, le=1e6)]
    far: Annotated[float, Meta(gt=0.0, le=1e6)]
    image_height: Pixels
    image_width: Pixels
    look_at: Vector
    up_direction: Vector


class Updates(Struct, forbid_unknown_fields=True, frozen=True):
    """The only attribute of a control that a user can change."""

    value: bool | int | float | Name


class ControlUpdate(Struct, tag="GuiUpdateMessage", forbid_unknown_fields=True, frozen=True):
    """A control was used."""

    uuid: Name
    updates: Updates


class GizmoStart(Struct, tag="TransformControlsDragStartMessage", forbid_unknown_fields=True, frozen=True):
    """A drag of a handle has begun."""

    name: Name
    owner: Everybody = ""


class GizmoUpdate(Struct, tag="TransformControlsUpdateMessage", forbid_unknown_fields=True, frozen=True):
    """A handle was dragged."""

    name: Name
    wxyz: Quaternion
    position: Vector
    owner: Everybody = ""


class GizmoEnd(Struct, tag="TransformControlsDragEndMessage", forbid_unknown_fields=True, frozen=True):
    """A handle was released."""

    name: Name
    owner: Everybody = ""


class Drag(Struct, tag="SceneNodeDragMessage", forbid_unknown_fields=True, frozen=True):
    """A tool was grabbed, dragged or released."""

    phase: Literal["start", "update", "end"]
    name: Name
    instance_index: None
    start_position: Vector
    start_screen_pos: tuple[Length, Length]
    end_position: Vector
    end_screen_pos: tuple[Length, Length]
    button: Literal["left", "middle", "right"]
    modifier: Modifier | None
    owner: Everybody = ""


Message = Camera | ControlUpdate | GizmoStart | GizmoUpdate | GizmoEnd | Drag

_DECODER = msgspec.msgpack.Decoder(Message)


class Malformed(ValueError):
    """Bytes that are not a valid message."""


def read_message(raw: bytes | str) -> Message | None:
    """Decode a message from a page.

    Args:
        raw: The message as received.

    Returns:
        The message; None if it is of a kind that this page does not send.

    Raises:
        Malformed: If it is not valid MessagePack.
    """
    if isinstance(raw, str):
        raise Malformed("text")
    try:
        found: Message = _DECODER.decode(raw)
        return found
    except msgspec.ValidationError:
        return None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise Malformed(str(error)) from error


class MessageFilter:
    """Guards the connections of a page by wrapping them.

    Attributes:
        dropped: Number of messages that a user of the page could not have sent.
        server: viser's server; None until there is one.
    """

    def __init__(self) -> None:
        """Start without a server."""
        self.dropped = 0
        self.server: Any = None

    def guard(self, connection: ServerConnection) -> GuardedConnection:
        """Wrap a connection for viser."""
        return GuardedConnection(connection, self)

    def client(self, connection: GuardedConnection) -> Any:
        """Viser's handle of the client at the other end; None before its first message about the camera."""
        if self.server is None:
            return None
        lines = self.server._websock_server._live_connections
        number = next((number for number, line in list(lines.items()) if line is connection), None)
        return self.server.get_clients().get(number)


class GuardedConnection:
    """A connection from which viser receives permitted messages only."""

    def __init__(self, connection: ServerConnection, messages: MessageFilter) -> None:
        """Wrap a connection.

        Args:
            connection: The underlying connection.
            messages: The filter that all connections share.
        """
        self._connection, self._messages = connection, messages
        self._warned = False
        self._gizmos: set[str] = set()
        self._drags: dict[str, Drag] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """Wait for the next permitted message.

        Raises:
            websockets.exceptions.ConnectionClosed: If the connection has closed.
        """
        malformed = False
        while True:
            raw = await self._connection.recv()
            if malformed:
                continue
            try:
                message = read_message(raw)
            except Malformed:
                malformed = True
                await self._connection.close(1007, "not understood")
                continue
            allowed = None if message is None else self._allow(message)
            if allowed is not None:
                return msgspec.msgpack.encode(allowed)
            self._drop()

    def _drop(self) -> None:
        self._messages.dropped += 1
        if not self._warned:
            self._warned = True
            logger.warning("a page sent what it may not, or too late; that is left out, and all more of it unsaid")

    def _allow(self, message: Message) -> Message | None:
        """The permitted part of a message; None if nothing of it is permitted."""
        if isinstance(message, Camera):
            return message if _is_unit(message.wxyz) else None
        client = self._messages.client(self)
        if client is None:
            # viser has no client for this connection, because it has not sent its camera yet or has gone.
            return None
        if isinstance(message, ControlUpdate):
            return _allow_control(message, (client.gui, self._messages.server.gui))
        if isinstance(message, Drag):
            return self._allow_drag(message)
        return self._allow_gizmo(message)

    def _allow_gizmo(self, message: GizmoStart | GizmoUpdate | GizmoEnd) -> Message | None:
        name = message.name
        gizmo = self._messages.server.scene._handle_from_transform_controls_name.get(name)
        if isinstance(message, GizmoEnd):
            held = name in self._gizmos
            self._gizmos.discard(name)
            return message if held else None
        if gizmo is None or not gizmo.visible:
            return None
        if isinstance(message, GizmoStart):
            self._gizmos.add(name)
            return message
        if name not in self._gizmos or not _is_unit(message.wxyz):
            return None
        limits = zip(message.position, gizmo.translation_limits, strict=True)
        if not all(least <= value <= most for value, (least, most) in limits):
            return None
        # A handle for rotation only keeps its position, and one for translation only keeps its orientation.
        if gizmo.disable_axes and gizmo.disable_sliders:
            message = msgspec.structs.replace(message, position=tuple(map(float, gizmo.position)))
        if gizmo.disable_rotations:
            message = msgspec.structs.replace(message, wxyz=tuple(map(float, gizmo.wxyz)))
        return message

    def _allow_drag(self, message: Drag) -> Drag | None:
        name = message.name
        node = self._messages.server.scene._handle_from_node_name.get(name)
        seen = node is not None and node.visible and bool(node._impl.drag_cb)
        if message.phase == "start":
            if not seen:
                return None
            self._drags[name] = message
            return message
        begun = self._drags.get(name)
        if begun is None or (message.phase == "update" and not seen):
            return None
        if message.phase == "end":
            del self._drags[name]
        # Keep button and modifier of the start: viser selects the callbacks by them.
        return msgspec.structs.replace(message, button=begun.button, modifier=begun.modifier)


def _allow_control(message: ControlUpdate, interfaces: tuple[Any, ...]) -> ControlUpdate | None:
    """The use of a control, if it exists, is visible and enabled, and accepts the value.

    Args:
        message: The page's message.
        interfaces: viser's interfaces of this page and of all pages.
    """
    handle = next((found for each in interfaces if (found := each._gui_input_handle_from_uuid.get(message.uuid))), None)
    if handle is None or handle.disabled or not _is_shown(handle, interfaces):
        return None
    value = allowed_value(handle, message.updates.value)
    return None if value is None else ControlUpdate(message.uuid, Updates(value))


def allowed_value(handle: Any, value: bool | int | float | str) -> bool | int | float | str | None:
    """The value that a control takes on; None if it does not accept the given one.

    Args:
        handle: viser's handle of a button, a switch, a slider or a choice; the pages have no other controls.
        value: The given value.
    """
    import viser

    if isinstance(handle, viser.GuiButtonHandle):
        return value if value is True else None
    if isinstance(handle, viser.GuiCheckboxHandle):
        return value if isinstance(value, bool) else None
    if isinstance(handle, viser.GuiDropdownHandle):
        return value if isinstance(value, str) and value in handle.options else None
    if isinstance(handle, viser.GuiSliderHandle) and isinstance(value, int | float) and not isinstance(value, bool):
        least, most = handle.min, handle.max
        room = ROUNDING * (most - least)
        # Also rejects NaN, for which every comparison is false.
        if not least - room <= value <= most + room:
            return None
        value = min(max(value, least), most)
        return float(value) if isinstance(handle.value, float) else round(value)
    return None


def _is_shown(handle: Any, interfaces: tuple[Any, ...]) -> bool:
    """Whether a control and all folders that contain it are visible."""
    while handle is not None:
        if not getattr(handle, "visible", True):
            return False
        parent: str = getattr(getattr(handle, "_impl", None), "parent_container_id", "")
        folders: list[Mapping[str, Any]] = [each._container_handle_from_uuid for each in interfaces]
        handle = next((found[parent] for found in folders if parent in found), None)
    return True


def _is_unit(wxyz: Quaternion) -> bool:
    return abs(math.sqrt(sum(each * each for each in wxyz)) - 1.0) <= UNIT_TOLERANCE
