"""The page in a browser: it shows the state of the simulation, and mouse and keyboard move the tool."""

from __future__ import annotations

import time

import numpy as np
import pytest
from browsers import open_browser
from web_helpers import HUSH, PATIENCE, SEEN_AT, click, mesh, new_page, steady, until, wait_for

from spatula_env.teleop.web import WebDevice, WebSession

pytest.importorskip("viser", reason="the extra web is not installed")
minari = pytest.importorskip("minari", reason="the extra data is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(900)]

SIZE = {"width": 800, "height": 480}


@pytest.fixture(scope="module")
def browser():
    with open_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("datasets")


@pytest.fixture(scope="module")
def session(folder):
    with WebSession("Spatula/Press-v0", port=0, dataset=folder, seed=0) as made:
        yield made


@pytest.fixture
def page(browser, session):
    opened = new_page(browser, viewport=SIZE)
    opened.set_default_timeout(1000.0 * PATIENCE)
    errors, dropped = [], session.device.page.messages.dropped
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(session.url)
    wait_for(opened, lambda: mesh(opened, "/organ"), "the organ in the page")
    wait_for(opened, lambda: session._status.text == "Practice", "an episode")
    # That there is no graphics card is said right over the tool.
    wait_for(opened, lambda: opened.evaluate(HUSH) == 0, "no notification")
    yield opened
    opened.close()
    assert errors == []
    # All that the page itself says may be said.
    assert session.device.page.messages.dropped == dropped


def nodes(session):
    return np.array(session.env.unwrapped.simulation.nodes)


def vertices(session):
    """What has to be drawn first of the organ: its nodes, in another order."""
    found = nodes(session)
    return session.device._display._surface.place(found)[: len(found)]


def new_episode(page, session):
    before = session.env.unwrapped.goal
    click(page, "New episode")
    wait_for(page, lambda: (session.env.unwrapped.goal != before).any(), "a new episode")
    count = session.device._sequence
    wait_for(page, lambda: session.device._sequence > count + 2, "steps of it")
    assert session.env.unwrapped._episodes.info["force"][0] == 0.0


def test_a_key_presses_the_organ_and_the_page_shows_it(page, session):
    new_episode(page, session)
    before, air = nodes(session), session.device._grip.copy()
    rest = mesh(page, "/organ", len(before))
    assert rest["visible"] and rest["smooth"]
    page.keyboard.down("KeyQ")
    wait_for(page, lambda: np.abs(nodes(session) - before).max() > 0.3, "an organ that is pressed")
    page.keyboard.up("KeyQ")
    wait_for(page, lambda: not session.device.page.operator_input.keys, "a key that is let go")
    grip = session.device._grip.copy()
    # Straight down, and it stays there.
    assert grip[:2] == pytest.approx(air[:2], abs=1e-9) and grip[2] < air[2] - 0.005
    # What the page draws is what physics has.
    wait_for(
        page,
        lambda: np.abs(mesh(page, "/organ", len(before))["points"] - vertices(session)).max() < 0.05,
        "the same organ on both sides",
    )
    shown = mesh(page, "/organ", len(before))["points"]
    moved = np.linalg.norm(shown - rest["points"], axis=1)
    assert moved.max() > 0.3
    # Where it is pressed it gives way, and elsewhere much less.
    assert np.median(moved) < 0.5 * moved.max()
    # What is pressed has colours of pressure, and the panel says how much.
    wait_for(page, lambda: any((mesh(page, f"/pressure/{band}") or {}).get("visible") for band in range(10)), "colours")
    wait_for(
        page, lambda: "kPa" in page.get_by_text("Peak pressure", exact=True).locator("..").inner_text(), "the panel"
    )
    for label in ("Contact force", "2.67", "4.0"):
        assert page.get_by_text(label, exact=True).first.is_visible()
    assert session.device._grip == pytest.approx(grip, abs=1e-9)


def test_keys_do_not_move_the_camera_and_text_moves_no_tool(page, session):
    camera = "() => window.__viserMutable.camera.matrixWorld.elements.slice()"
    # It goes to its first view when the page has told its size.
    steady(page)
    before = page.evaluate(camera)
    place = session.device._grip.copy()
    page.keyboard.down("KeyD")
    wait_for(page, lambda: session.device._grip[0] > place[0] + 0.003, "the tool goes to the right")
    page.keyboard.up("KeyD")
    assert page.evaluate(camera) == pytest.approx(before)
    page.evaluate("() => document.body.insertAdjacentHTML('beforeend', '<input id=text>')")
    page.locator("#text").focus()
    page.keyboard.down("KeyA")
    page.keyboard.up("KeyA")
    assert page.locator("#text").input_value() == "a"
    # Something is held by no key that was typed.
    assert not session.device.page.operator_input.keys


def test_the_mouse_drags_the_tool(page, session):
    new_episode(page, session)
    place = session.device._grip.copy()
    page.get_by_text("View and speed").click()
    page.get_by_text("Handles to drag by").click()
    steady(page)
    x, y = page.evaluate(SEEN_AT, "/tool/0")
    page.mouse.move(x, y)
    wait_for(page, lambda: mesh(page, "/tool/0"), "the tool in the page")
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(x + 8 * step, y)
        page.wait_for_timeout(60)
    wait_for(page, lambda: session.device._grip[0] > place[0] + 0.004, "the tool follows to the right")
    # Sideways on the screen it stays at its height.
    assert session.device._grip[2] == pytest.approx(place[2], abs=1.5e-3)
    for step in range(1, 7):
        page.mouse.move(x + 64, y + 8 * step)
        page.wait_for_timeout(60)
    wait_for(page, lambda: session.device._grip[2] < place[2] - 0.003, "the tool follows downwards")
    page.mouse.up()
    wait_for(page, lambda: session.device.page.operator_input.target is None, "the mouse lets go")
    page.get_by_text("Handles to drag by").click()
    page.get_by_text("View and speed").click()


def test_an_episode_is_recorded_from_the_page(page, session, folder):
    saved = session.saved
    click(page, "Record an episode")
    wait_for(page, lambda: session._status.text == "Ready", "recording")
    wait_for(page, lambda: page.get_by_role("button", name="New episode").count() == 0, "the buttons for it")
    page.keyboard.down("ArrowDown")
    wait_for(page, lambda: session._status.text.startswith("Recording"), "an episode")
    page.get_by_text("Recording").wait_for()
    page.wait_for_timeout(500)
    page.keyboard.up("ArrowDown")
    click(page, "Success")
    wait_for(page, lambda: session.saved == saved + 1, "saving")
    page.get_by_text("Saved").first.wait_for()
    dataset = minari.MinariDataset(folder / "spatula/press/web-v0/data")
    number = dataset.total_episodes - 1
    (about,) = dataset.storage.get_episode_metadata([number])
    assert (about["operator"], about["device"], bool(about["operator_success"])) == ("human", "web", True)
    (episode,) = dataset.iterate_episodes([number])
    assert len(episode.actions) >= 5
    assert episode.actions[0].tolist() == pytest.approx([0.0, -0.3, 0.0])


def test_another_task_is_chosen_on_the_page(page, session):
    page.get_by_label("Task").or_(page.locator("input[value='Spatula/Press-v0']")).first.click()
    page.get_by_role("option", name="Spatula/Clamp-v0").click()
    wait_for(page, lambda: session.env is not None and session.env.spec.id == "Spatula/Clamp-v0", "another task")
    wait_for(page, lambda: mesh(page, "/tool/1"), "two jaws in the page")
    # The keys go to the tool again, and not to the list.
    place = session.device._grip.copy()
    page.keyboard.down("KeyE")
    wait_for(page, lambda: session.device._grip[2] > place[2] + 0.002, "the tool goes up")
    page.keyboard.up("KeyE")
    session._choice.value = "Spatula/Press-v0"
    session._ask("task")
    wait_for(page, lambda: session.env is not None and session.env.spec.id == "Spatula/Press-v0", "the first task")
    wait_for(page, lambda: mesh(page, "/tool/1") is None, "one tool in the page")


def test_a_page_that_is_closed_stops_the_tool(browser, session):
    page = new_page(browser, viewport=SIZE)
    page.goto(session.url)
    wait_for(page, lambda: mesh(page, "/organ"), "the organ in the page")
    place = session.device._grip.copy()
    page.keyboard.down("KeyE")
    wait_for(page, lambda: session.device._grip[2] > place[2] + 0.001, "the tool goes up")
    page.close()
    until(lambda: session._status.text == "Paused", "standing still")
    place = session.device._grip.copy()
    time.sleep(0.3)
    assert session.device._grip == pytest.approx(place, abs=0.0)
    assert session.device.read().rate.tolist() == [0.0, 0.0, 0.0]


def test_the_page_asks_for_its_token(browser):
    with WebDevice(port=0, token="open sesame!") as device:
        page = new_page(browser, viewport=SIZE)
        page.set_default_timeout(1000.0 * PATIENCE)
        page.goto(device.url.partition("?")[0])
        page.get_by_placeholder("token").fill("open sesame?")
        page.get_by_role("button", name="Open").click()
        page.get_by_text("needs its token").wait_for()
        assert not device.page.operator_input.present
        page.get_by_placeholder("token").fill("open sesame!")
        page.get_by_role("button", name="Open").click()
        page.get_by_role("button", name="Finish").wait_for()
        assert "sesame" not in page.url
        wait_for(page, lambda: device.page.operator_input.present, "somebody who looks")
        page.get_by_role("button", name="Finish").click()
        wait_for(page, lambda: "finish" in device.read().buttons, "the button")
        page.close()
