// Runs in the page before the viewer does. It tells the server which keys are held, and takes these keys from the viewer,
// which would move its camera by them; it repeats itself ten times a second, so that silence means something. And it
// fits the viewer's page to small screens, to the system's colours, and to what it should say when the server is gone.
"use strict";

(() => {
  const PERIOD = 100; // ms
  const SHORTEST = 30; // ms between two words about frames
  const LOOKING = 250; // ms between two looks at what the viewer has drawn
  const GONE = 1500; // ms without a connection before that is said
  const PHONE = "(max-width: 36em)"; // where the viewer has its panel below the picture
  const held = new Set();
  let frames = 0; // that have been drawn: the server sends no more than can be drawn
  let told = 0;
  let wanted = new Set(); // codes of keys that the server wants to know of
  let socket = null;

  // Hands.

  const tell = () => {
    if (socket !== null && socket.readyState === WebSocket.OPEN) {
      socket.send(JSON.stringify({ keys: [...held], hidden: document.hidden, frames }));
      told = performance.now();
    }
  };

  const letGo = () => {
    held.clear();
    tell();
  };

  const blur = () => {
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  };

  // Where letters and numbers are typed, they are no commands.
  const typing = (target) =>
    target instanceof HTMLElement &&
    (target.isContentEditable ||
      target instanceof HTMLTextAreaElement ||
      (target instanceof HTMLInputElement && !target.readOnly && ["text", "number", "search"].includes(target.type)));

  let lost = null; // since when there is no connection
  const connect = () => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/spatula/hand`);
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (Array.isArray(message.keys)) wanted = new Set(message.keys);
      if (message.blur) blur();
    };
    socket.onopen = () => {
      lost = null;
      tell();
    };
    socket.onclose = () => {
      held.clear();
      lost ??= performance.now();
      setTimeout(connect, 1000);
    };
  };

  window.addEventListener(
    "keydown",
    (event) => {
      if (typing(event.target) && ["Enter", "Escape"].includes(event.code)) setTimeout(blur);
      if (!wanted.has(event.code) || event.ctrlKey || event.metaKey || event.altKey || typing(event.target)) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      if (!held.has(event.code)) {
        held.add(event.code);
        tell();
      }
    },
    { capture: true },
  );
  // Also where the release goes to a text field: a key that is not held must not be taken for one.
  window.addEventListener(
    "keyup",
    (event) => {
      if (held.delete(event.code)) tell();
    },
    { capture: true },
  );
  // A button or a slider that was clicked does not keep the keys, nor does a field that is left for the picture. Who goes
  // from one to the next by the tabulator key is left alone.
  window.addEventListener("pointerup", () => setTimeout(() => typing(document.activeElement) || blur()), {
    capture: true,
  });
  window.addEventListener("pointerdown", (event) => event.target instanceof HTMLCanvasElement && blur(), {
    capture: true,
  });
  window.addEventListener("blur", letGo);
  window.addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", letGo);
  const onFrame = () => {
    frames += 1;
    if (performance.now() - told > SHORTEST) tell();
    requestAnimationFrame(onFrame);
  };

  // Looks. `--sp-below` is what is below the viewer: what the keys do or, on a phone, the panel.

  const STYLE = `
    :root { --sp-below: 0px; }
    #root { height: calc(100dvh - var(--sp-below)) !important; }
    .sp { font: 13px/1.4 system-ui, sans-serif; padding: 2px 14px 6px 10px; overflow-wrap: break-word; }
    .sp b { font-weight: 600; }
    .sp .n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
    .sp div > .n { float: right; }
    .sp .bar { position: relative; height: 14px; margin: 2px 0 1px; border-radius: 4px; background: #8884;
      overflow: hidden; }
    .sp .bar i { position: absolute; left: 0; top: 0; bottom: 0; }
    .sp .bar u { position: absolute; top: 0; bottom: 0; width: 2px; margin-left: -1px; box-shadow: 0 0 0 1px #fffa; }
    .sp .scale { position: relative; height: 15px; font-size: 11px; opacity: .85; margin-bottom: 4px; }
    .sp .scale span { position: absolute; white-space: nowrap; }
    .sp .state { font-size: 16px; font-weight: 600; padding: 2px 0; }
    .sp .dot { color: #e03131; }
    .sp .small { font-size: 12px; opacity: .85; }
    .sp .task { margin: 6px 0; padding-left: 8px; border-left: 3px solid #3b82d6; }
    .sp table.goal { width: 100%; border-collapse: collapse; }
    .sp table.goal th { font-size: 11px; font-weight: 400; opacity: .8; text-align: left; padding: 0; }
    .sp table.goal th.n { text-align: right; }
    .sp table.goal td { padding: 1px 0 1px 8px; vertical-align: top; }
    .sp .colors { display: flex; flex-wrap: wrap; gap: 0 10px; font-size: 11px; margin: 0 0 4px; }
    .sp .colors i { display: inline-block; width: 9px; height: 9px; margin-right: 4px; border-radius: 50%; }
    .sp table.goal td:first-child { padding-left: 0; width: 1em; }
    .sp tr.ok td:first-child, .sp tr.ok b { color: #2b8a3e; }
    .sp .hold { position: relative; margin: 4px 0 2px; border-radius: 4px; background: #8883; overflow: hidden; }
    .sp .hold i { position: absolute; inset: 0 auto 0 0; background: #2b8a3e66; }
    .sp .hold span { position: relative; padding: 0 6px; font-size: 12px; }
    .sp .success { margin: 4px 0 2px; padding: 3px 8px; border-radius: 4px; background: #2b8a3e; color: #fff;
      font-weight: 600; }
    .sp .legend { display: flex; flex-wrap: wrap; gap: 0 12px; font-size: 11px; }
    .sp .key i { display: inline-block; width: 20px; margin-right: 4px; vertical-align: middle; }
    .sp-keys > div { font-size: 12px; line-height: 20px; }
    .sp-keys > div > span { margin-left: 8px; white-space: nowrap; }
    @media (max-width: 60em) { .sp-keys > div { font-size: 11px; line-height: 18px; } }
    .sp-keys kbd { display: inline-block; min-width: 1.5em; padding: 0 3px; margin-right: 2px; border: 1px solid #8888;
      border-radius: 3px; font: 11px/15px system-ui, sans-serif; text-align: center; }
    .sp-keys .touch { display: none; }
    @media (pointer: coarse) { .sp-keys .touch { display: block; } .sp-keys .keys, .sp-keys .mouse { display: none; } }
    #sp-foot { position: fixed; left: 0; right: 0; bottom: 0; z-index: 20; padding: 2px 0;
      background: var(--mantine-color-body, Canvas); color: var(--mantine-color-text, CanvasText);
      border-top: 1px solid #8884; }
    #sp-foot .sp { padding: 0 10px; }
    #sp-foot:empty { display: none; }
    body:has(#sp-foot:not(:empty)) #root .sp-keys { display: none; }
    #sp-lost { position: fixed; left: 0; right: 0; top: 0; z-index: 400; padding: 8px 14px; background: #c92a2a;
      color: #fff; font: 600 14px/1.4 system-ui, sans-serif; text-align: center; }
    #sp-lost[hidden] { display: none; }
    [data-mantine-color-scheme="dark"] .sp tr.ok td:first-child, [data-mantine-color-scheme="dark"] .sp tr.ok b {
      color: #69db7c; }
    [data-mantine-color-scheme="dark"] .sp .dot { color: #ff6b6b; }
    @media ${PHONE} {
      #sp-foot { display: none; }
      #root .sp-keys { display: block !important; }
      .sp-sheet { width: 100% !important; max-height: min(52%, 28em) !important; }
      .sp-sheet [style*="width: 20em"] { width: 100% !important; }
    }`;

  const make = (name) => {
    const made = document.createElement("div");
    made.id = name;
    document.body.append(made);
    return made;
  };

  const RESENDS = 8; // times that the camera is told anew after the picture has got another size
  let sized = "";
  let resends = 0;

  let foot = null;
  let banner = null;
  let letters = null; // what is printed on keys, by their codes
  const NAMED = { KeyA: 1, KeyD: 1, KeyE: 1, KeyI: 1, KeyJ: 1, KeyK: 1, KeyL: 1, KeyO: 1, KeyQ: 1, KeyS: 1, KeyU: 1,
    KeyW: 1, Period: 1, Comma: 1 };

  const label = (keys) => {
    if (letters === null) return;
    for (const key of keys.querySelectorAll("kbd[data-code]")) {
      const printed = NAMED[key.dataset.code] && letters.get(key.dataset.code);
      if (printed) key.textContent = printed.toUpperCase();
    }
  };

  // What the keys do is always there, also where the panel is folded away.
  const showKeys = () => {
    const keys = document.querySelector("#root .sp-keys");
    if (keys === null) return;
    if (foot.dataset.source === keys.innerHTML) return;
    foot.dataset.source = keys.innerHTML;
    const copy = keys.cloneNode(true);
    label(copy);
    foot.replaceChildren(copy);
  };

  const fit = () => {
    const top = document.querySelector("#root .sp-top");
    const sheet = matchMedia(PHONE).matches ? top?.closest('[style*="position: fixed"]') : null;
    if (sheet) sheet.classList.add("sp-sheet");
    const below = (sheet ?? document.querySelector(".sp-sheet") ?? foot).offsetHeight;
    document.documentElement.style.setProperty("--sp-below", `${below}px`);
    // The viewer tells its camera when that moves, and not always when its picture has another size.
    const { canvas, sendCamera } = window.__viserMutable ?? {};
    const size = canvas ? `${canvas.clientWidth}x${canvas.clientHeight}` : "";
    if (size !== sized) [sized, resends] = [size, RESENDS];
    if (resends > 0 && sendCamera) {
      resends -= 1;
      sendCamera();
    }
    if (top?.dataset.title && document.title !== top.dataset.title) document.title = top.dataset.title;
  };

  const sayLost = () => {
    banner.hidden = lost === null || performance.now() - lost < GONE;
    if (banner.hidden) return;
    banner.textContent =
      "Disconnected: the program that serves this page has ended, or cannot be reached. What you see is old. Trying again …";
  };

  // The switch for dark colours belongs to this page alone. It follows the system until it is clicked by a person.
  const DARK = matchMedia("(prefers-color-scheme: dark)");
  let seen = null; // the switch that was set last
  let chosen = null;
  const choose = () => {
    const name = [...document.querySelectorAll("#root label")].find((each) => each.textContent === "Dark colours");
    const box = name && document.getElementById(name.htmlFor);
    if (!box || box === seen) return;
    seen = box;
    box.addEventListener("change", (event) => event.isTrusted && (chosen = box.checked));
    if (box.checked !== (chosen ?? DARK.matches)) box.click();
  };
  DARK.addEventListener("change", () => {
    if (chosen === null && seen && seen.checked !== DARK.matches) seen.click();
  });

  // What shows the goal shines through what hides it.
  const shine = () => {
    const nodes = window.__viserMutable?.nodeRefFromName ?? {};
    for (const name in nodes) {
      if (!name.startsWith("/through/")) continue;
      nodes[name]?.traverse?.((each) => {
        if (each.material && each.material.depthTest) {
          each.material.depthTest = each.material.depthWrite = false;
          each.renderOrder = 5;
        }
      });
    }
  };

  // Where a plot is given its size and data at once, it forgets to find the ticks of its axes.
  const drawAxes = () => {
    for (const { chart } of Object.values(window.__viserTestpoints?.uplots ?? {})) {
      if (chart.width > 0 && chart.axes.some((axis) => axis.show && axis._found?.[1] === 0)) chart.redraw(true, true);
    }
  };

  const look = () => {
    showKeys();
    drawAxes();
    fit();
    sayLost();
    choose();
    shine();
  };

  const dress = () => {
    const style = document.createElement("style");
    style.textContent = STYLE;
    document.head.append(style);
    foot = make("sp-foot");
    banner = make("sp-lost");
    banner.hidden = true;
    banner.setAttribute("role", "alert");
    navigator.keyboard?.getLayoutMap?.().then(
      (map) => {
        letters = map;
        foot.dataset.source = "";
      },
      () => {},
    );
    look();
    setInterval(look, LOOKING);
    window.addEventListener("resize", fit);
  };

  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", dress);
  else dress();
  setInterval(tell, PERIOD);
  requestAnimationFrame(onFrame);
  connect();
})();
