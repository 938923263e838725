"""The page explains the task, the layout and the controls, on large screens and small ones."""

from __future__ import annotations

import io

import numpy as np
import pytest
from browsers import open_browser
from web_helpers import HUSH, PATIENCE, SEEN_AT, click, mesh, new_page, steady, wait_for

from spatula_env.teleop.web import WebSession
from spatula_env.teleop.web.scene_display import SHINING
from spatula_env.teleop.web.session import task_ids

pytest.importorskip("viser", reason="the extra web is not installed")
pytest.importorskip("minari", reason="the extra data is not installed")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(900)]

SIZES = {"phone": (390, 844), "small": (800, 600), "large": (1280, 800)}
TASKS = [f"Spatula/{name}-v0" for name in ("Press", "Retract", "Fissure", "Clamp", "Palpate")]

LAYOUT = """() => {
  const box = (each) => (({ left, top, right, bottom }) => [left, top, right, bottom])(each.getBoundingClientRect());
  const canvas = document.querySelector("canvas");
  const top = document.querySelector("#root .sp-top");
  const panel = top.closest('[style*="position: fixed"]') ?? top;
  return {
    canvas: box(canvas), panel: box(panel), foot: box(document.getElementById("sp-foot")),
    wide: document.documentElement.scrollWidth, tall: document.documentElement.scrollHeight,
    over: [...document.querySelectorAll(".sp, .sp *")].filter(
      (each) => each.clientWidth > 0 && each.scrollWidth > each.clientWidth + 1 && !each.closest(".scale")
    ).map((each) => each.outerHTML),
    small: [...document.querySelectorAll(".sp *")].filter(
      (each) => each.clientHeight > 0 && parseFloat(getComputedStyle(each).fontSize) < 11
    ).length,
  };
}"""
EXTENT = """(name) => {
  const { nodeRefFromName, camera, canvas } = window.__viserMutable;
  let position = null;
  nodeRefFromName[name]?.traverse((each) => { position ??= each.geometry?.attributes?.position ?? null; });
  if (position === null) return null;
  const box = canvas.getBoundingClientRect();
  const seen = [...Array(position.count).keys()].map((index) =>
    camera.position.clone().fromBufferAttribute(position, index).project(camera));
  const across = seen.map((place) => box.left + (0.5 + 0.5 * place.x) * box.width);
  const down = seen.map((place) => box.top + (0.5 - 0.5 * place.y) * box.height);
  return [Math.min(...across), Math.min(...down), Math.max(...across), Math.max(...down)];
}"""
AXES = """() => Object.values(window.__viserTestpoints?.uplots ?? {}).map(
  ({ chart }) => chart.axes.map((axis) => axis._found?.[1] > 0 && axis._values?.length > 1))"""
SCHEME = "() => document.documentElement.dataset.mantineColorScheme"


@pytest.fixture(scope="module")
def browser():
    with open_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    with WebSession(TASKS[0], port=0, dataset=folder, seed=0, env_kwargs={"engine": "batch"}) as made:
        yield made


def visit(browser, session, size="large", **options):
    width, height = SIZES[size]
    opened = new_page(browser, viewport={"width": width, "height": height}, **options)
    opened.set_default_timeout(1000.0 * PATIENCE)
    opened.goto(session.url)
    wait_for(opened, lambda: mesh(opened, "/organ"), "the organ in the page")
    wait_for(opened, lambda: session._status.text == "Practice", "an episode")
    wait_for(opened, lambda: opened.evaluate(HUSH) == 0, "no notification")
    return opened


@pytest.fixture(scope="module")
def page(browser, session):
    opened = visit(browser, session)
    errors = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    opened.context.close()
    assert errors == []


def take(page, session, task):
    """Have a task on the page, and a new episode of it."""
    if session.env is None or session.env.spec.id != task:
        session._choice.value = task
        session._ask("task")
        wait_for(page, lambda: session.env is not None and session.env.spec.id == task, "another task")
        name = task.partition("/")[2].partition("-")[0]
        wait_for(page, lambda: page.title() == f"{name} – Spatula", "the task's name")
    else:
        before = session.env.unwrapped.goal
        session._ask("reset")
        wait_for(page, lambda: (session.env.unwrapped.goal != before).any(), "a new episode")
    count = session.device._sequence
    wait_for(page, lambda: session.device._sequence > count + 3, "steps of it")
    page.wait_for_timeout(300)


def resize(page, size):
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    seen = []

    def settled():
        page.wait_for_timeout(150)
        now = page.evaluate(LAYOUT)
        seen.append(now["canvas"])
        fits = now["panel"][2] <= width and (
            now["panel"][0] <= 1 if size == "phone" else now["canvas"][3] > 0.8 * height
        )
        return fits and len(seen) > 3 and seen[-1] == seen[-2] == seen[-3]

    wait_for(page, settled, "a picture of that size")


def info(session):
    return session.env.unwrapped._episodes.info


@pytest.mark.parametrize("task", TASKS)
def test_it_says_what_is_asked_how_near_it_is_and_what_hands_can_do(page, session, task):
    take(page, session, task)
    made = session.env.unwrapped
    names = made.control.names
    criteria = made.task.criteria(made._episodes.achieved[0], made.goal)

    def rows():
        return page.locator(".sp-top tr").all_inner_texts()[1:]

    def codes():
        return page.locator("#sp-foot kbd").evaluate_all("all => all.map((key) => key.dataset.code)")

    wait_for(page, lambda: made.task_description in page.locator(".sp-top").inner_text(), "the sentence")
    wait_for(page, lambda: [row.split("\t")[1] for row in rows()] == [each.name for each in criteria], "the goal")
    assert all(any(unit in row for unit in ("mm", "°", "%", "N", "no grip")) for row in rows())
    assert f"for {made.task.hold_time:g} s" in page.locator(".sp-top .hold").inner_text()
    # Keys of this task only, in sight.
    assert page.locator("#sp-foot").is_visible()
    wait_for(page, lambda: ("Period" in codes()) == ("jaw_speed" in names), "the keys of this task")
    assert ("KeyU" in codes()) == ("rotation_x" in names)
    assert ("KeyI" in codes()) == ("rotation_y" in names) and ("KeyO" in codes()) == ("rotation_z" in names)
    assert {"KeyW", "KeyQ", "Enter"} <= set(codes())
    # Handles to turn it by, and the jaws' slider, where there is something to turn or to open.
    wait_for(page, lambda: (mesh(page, "/turn/x") is not None) == ("rotation_x" in names), "handles to turn it by")
    jaws = page.get_by_text("Jaws [mm]")
    wait_for(page, lambda: (jaws.count() > 0) == ("jaw_speed" in names), "the slider of the jaws")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("task", [TASKS[2], TASKS[3]])
def test_nothing_is_hidden_on_any_screen(page, session, task, size):
    take(page, session, task)
    resize(page, size)
    width, height = SIZES[size]
    seen = page.evaluate(LAYOUT)
    canvas, panel, foot = seen["canvas"], seen["panel"], seen["foot"]
    assert seen["wide"] <= width and seen["tall"] <= height
    # The picture is a good part of the screen, and under nothing.
    assert (canvas[2] - canvas[0]) * (canvas[3] - canvas[1]) > 0.4 * width * height
    if size == "phone":
        assert canvas[3] <= panel[1] + 1 and panel[0] <= 1 and panel[2] >= width - 1
    else:
        assert canvas[2] <= panel[0] + 1 and canvas[3] <= foot[1] + 1
    assert seen["over"] == [] and seen["small"] == 0
    # All that is to be seen at first is in the picture: the goal, too.

    def goal_in_view():
        extents = [found for found in (page.evaluate(EXTENT, f"/goal/{index}") for index in range(3)) if found]
        return extents and all(
            canvas[0] <= left < right <= canvas[2] and canvas[1] <= top < bottom <= canvas[3]
            for left, top, right, bottom in extents
        )

    wait_for(page, goal_in_view, "the goal in the picture")
    x, y = page.evaluate(SEEN_AT, "/tool/0")
    assert canvas[0] <= x <= canvas[2] and canvas[1] <= y <= canvas[3]
    wait_for(page, lambda: all(all(axes) for axes in page.evaluate(AXES)), "axes of the plot")
    if size == "phone":
        page.get_by_text("Spatula", exact=True).first.click()
        wait_for(page, lambda: page.evaluate(LAYOUT)["canvas"][3] > canvas[3] + 150, "a larger picture")
        page.get_by_text("Spatula", exact=True).first.click()
        wait_for(page, lambda: page.evaluate(LAYOUT)["canvas"][3] < canvas[3] + 20, "the panel again")
    resize(page, "large")


def test_keys_work_after_a_click_on_buttons_and_sliders(page, session):
    take(page, session, TASKS[0])
    click(page, "New episode")
    slider = page.locator("[role=slider]").last
    if not slider.is_visible():
        page.get_by_text("View and speed").click()
    wait_for(page, slider.is_visible, "the slider")
    box = slider.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    speed, place = session.device.panel.speed.value, session.device._grip.copy()
    page.keyboard.down("ArrowRight")
    wait_for(page, lambda: session.device._grip[0] > place[0] + 0.002, "the tool goes to the right")
    page.keyboard.up("ArrowRight")
    assert session.device.panel.speed.value == speed
    # A number that was typed is no more in the keys' way.
    field = page.locator("#root input[inputmode=numeric], #root input[inputmode=decimal]").last
    field.fill("20")
    field.press("Enter")
    wait_for(page, lambda: session.device.panel.speed.value == 20, "another speed")
    place = session.device._grip.copy()
    page.keyboard.down("KeyA")
    wait_for(page, lambda: session.device._grip[0] < place[0] - 0.001, "the tool goes to the left")
    page.keyboard.up("KeyA")


def test_the_mouse_turns_the_blade(page, session):
    take(page, session, TASKS[2])

    before = session.device._orientation.copy()
    steady(page)
    # Somewhere on the arc, which lies between the axes y and z.
    x, y = page.evaluate("""() => {
      const { nodeRefFromName, camera, canvas } = window.__viserMutable;
      const node = nodeRefFromName["/turn/x"];
      let line = null;
      node.traverse((each) => { if (each.isLine2 || each.type === "Line2") line ??= each; });
      const place = line.geometry.attributes.instanceStart;
      const index = Math.floor(place.count / 2);
      const point = camera.position.clone().set(place.getX(index), place.getY(index), place.getZ(index));
      const seen = line.localToWorld(point).project(camera);
      const box = canvas.getBoundingClientRect();
      return [box.left + (0.5 + 0.5 * seen.x) * box.width, box.top + (0.5 - 0.5 * seen.y) * box.height];
    }""")
    page.mouse.move(x, y)
    page.wait_for_timeout(300)
    page.mouse.down()
    for step in range(1, 13):
        page.mouse.move(x - 4 * step, y - 3 * step)
        page.wait_for_timeout(60)
    wait_for(page, lambda: session.device.page.operator_input.orientation is not None, "an orientation to turn to")
    wait_for(page, lambda: np.abs(session.device._orientation - before).max() > 0.03, "a blade that turns")
    page.mouse.up()
    wait_for(page, lambda: session.device.page.operator_input.orientation is None, "the mouse lets go")


def test_the_mouse_closes_the_jaws(page, session):
    take(page, session, TASKS[3])
    before = session.device._width
    thumb = page.locator("[role=slider]").first
    box = thumb.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 6):
        page.mouse.move(x - 8 * step, y)
        page.wait_for_timeout(60)
    page.mouse.up()
    wait_for(page, lambda: session.device._width < before - 0.004, "jaws that close")
    wait_for(page, lambda: session.device.page.operator_input.opening is None, "jaws where they are to be")
    wait_for(page, lambda: abs(1e3 * session.device._width - session.device.panel.jaws.value) < 0.6, "the slider")


def test_a_press_is_done_by_mouse_and_keys(page, session):
    # A blade first: the spatula does not lie as that did.
    take(page, session, TASKS[1])
    take(page, session, TASKS[0])
    turned = "() => window.__viserMutable.nodeRefFromName['/tool/0']?.quaternion.toArray()"
    wait_for(page, lambda: page.evaluate(turned) == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-6), "a level spatula")
    made = session.env.unwrapped
    goal = made.goal

    def hold(key, reached, what):
        page.keyboard.down(key)
        wait_for(page, reached, what)
        page.keyboard.up(key)
        wait_for(page, lambda: not session.device.page.operator_input.keys, "a key that is let go")

    # Roughly to the place by the mouse, and exactly by keys.
    steady(page)
    x, y = page.evaluate(SEEN_AT, "/tool/0")
    session.device._display.set_gizmo(False)
    wait_for(page, lambda: mesh(page, "/tool/0"), "the tool")
    place = session.device._grip.copy()
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 6):
        page.mouse.move(x + np.sign(goal[0] - place[0]) * 6 * step, y)
        page.wait_for_timeout(60)
    wait_for(page, lambda: abs(session.device._grip[0] - place[0]) > 0.001, "the tool follows")
    page.mouse.up()
    wait_for(page, lambda: session.device.page.operator_input.target is None, "the mouse lets go")
    session.device._display.set_gizmo(True)
    session.device.panel.speed.value = 10
    for axis, (less, more) in enumerate((("KeyA", "KeyD"), ("KeyS", "KeyW"))):
        away = goal[axis] - session.device._grip[axis]
        sign = np.sign(away)
        key = more if away > 0.0 else less
        hold(key, lambda a=axis, s=sign: s * (goal[a] - session.device._grip[a]) < 0.0012, "a place")
    hold("KeyQ", lambda: info(session)["depth"][0] > 0.3 * goal[2], "a depth")
    # By small steps, each as long as it takes at that speed: pages of software renderers are late.
    session.device.panel.speed.value = 5
    for _ in range(30):
        if info(session)["is_success"][0]:
            break
        error = goal[2] - info(session)["depth"][0]
        if abs(error) > 0.0007:
            key = "KeyQ" if error > 0.0 else "KeyE"
            page.keyboard.down(key)
            page.wait_for_timeout(min(1000.0 * abs(error) / 0.005, 1000.0))
            page.keyboard.up(key)
        page.wait_for_timeout(900)
    wait_for(page, lambda: info(session)["is_success"][0], "success")
    wait_for(page, lambda: page.locator(".sp-top .success").count() == 1, "which is said")
    assert "Success: held for 0.5 s" in page.locator(".sp-top .success").inner_text()
    assert "✓" in page.locator(".sp-top tr.ok").first.inner_text()


def test_what_was_said_of_an_episode_goes_away_with_the_next(page, session):
    take(page, session, TASKS[0])
    click(page, "Record an episode")
    wait_for(page, lambda: session._status.text == "Ready", "recording")
    wait_for(page, lambda: "Backspace" in page.locator("#sp-foot").inner_text(), "the keys for it")
    click(page, "Discard")
    wait_for(page, lambda: "not kept" in page.locator(".sp-top").inner_text(), "what has become of it")
    wait_for(page, lambda: page.get_by_role("button", name="New episode").count() == 1, "the buttons")
    click(page, "New episode")
    wait_for(page, lambda: "Nothing is recorded" in page.locator(".sp-top").inner_text(), "no word of it")


def test_colours_follow_the_system_until_somebody_chooses(browser, session, page):
    dark = visit(browser, session, "small", color_scheme="dark")
    wait_for(dark, lambda: dark.evaluate(SCHEME) == "dark", "dark colours")
    # Each page has its own.
    assert page.evaluate(SCHEME) == "light"
    wait_for(dark, lambda: all(all(axes) for axes in dark.evaluate(AXES)), "axes of the plot")
    color = dark.locator(".sp-top .state").evaluate("each => getComputedStyle(each).color")
    assert min(int(part) for part in color.strip("rgb()").split(",")) > 150
    dark.get_by_text("View and speed").click()
    dark.get_by_label("Dark colours").click()
    wait_for(dark, lambda: dark.evaluate(SCHEME) == "light", "light colours")
    dark.emulate_media(color_scheme="light")
    dark.emulate_media(color_scheme="dark")
    dark.wait_for_timeout(600)
    assert dark.evaluate(SCHEME) == "light"
    dark.context.close()


def test_a_page_says_when_nobody_serves_it_any_more(browser, tmp_path):
    with WebSession(TASKS[0], port=0, dataset=tmp_path, env_kwargs={"engine": "batch"}) as served:
        left = visit(browser, served, "small")
        assert not left.locator("#sp-lost").is_visible()
    left.locator("#sp-lost").wait_for(state="visible")
    assert "Disconnected" in left.locator("#sp-lost").inner_text()
    left.context.close()


@pytest.fixture(scope="module")
def drawn_page(browser, session):
    opened = visit(browser, session, drawn=True)
    yield opened
    opened.context.close()


def picture(page):
    """(height, width, 3) the canvas as it is seen."""
    from PIL import Image

    left, top, right, bottom = (round(value) for value in page.evaluate(LAYOUT)["canvas"])
    box = {"x": left, "y": top, "width": right - left, "height": bottom - top}
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB"), dtype=float)


def settled_picture(page):
    """The canvas, as soon as two pictures in a row are alike: a busy machine draws late."""
    seen = [picture(page)]

    def alike():
        page.wait_for_timeout(500)
        seen.append(picture(page))
        return (np.abs(seen[-1] - seen[-2]).max(axis=2) > 15.0).mean() < 1e-3

    wait_for(page, alike, "a picture that stays")
    return seen[-1]


@pytest.mark.parametrize("task", TASKS[:3])
def test_a_goal_inside_the_organ_shines_through(drawn_page, session, task):
    page = drawn_page
    take(page, session, task)
    steady(page)
    stage = session.device._display
    stage.set_gizmo(False)
    tested = """() => {
      const found = [];
      for (const [name, node] of Object.entries(window.__viserMutable.nodeRefFromName)) {
        if (!name.startsWith("/through/")) continue;
        node?.traverse((each) => each.material && found.push([each.material.depthTest, each.material.opacity]));
      }
      return found;
    }"""

    def drawn(opacity):
        for ghost in stage._ghosts:
            ghost.opacity = opacity
        wait_for(page, lambda: (found := page.evaluate(tested)) and all(o == opacity for _, o in found), "its opacity")
        wait_for(page, lambda: not any(deep for deep, _ in page.evaluate(tested)), "what is drawn over everything")
        return settled_picture(page)

    shining, plain = drawn(SHINING), drawn(0.01)
    drawn(SHINING)
    stage.set_gizmo(True)
    changed = np.abs(shining - plain).max(axis=2) > 15.0
    # It is seen where nothing of the goal would be, and is greener than what hides it.
    assert changed.sum() > 60
    greener = (shining[..., 1] - shining[..., 0]) - (plain[..., 1] - plain[..., 0])
    assert np.median(greener[changed]) > 15.0


def test_all_tasks_were_tried():
    assert set(TASKS) == set(task_ids())
