// Runs in the page before the viewer does: tells the server which keys are held, and takes these keys from the viewer,
// which would move its camera by them. It repeats itself ten times a second, so that silence means something.
"use strict";

(() => {
  const PERIOD = 100; // ms
  const SHORTEST = 30; // ms between two words about frames
  const held = new Set();
  let frames = 0; // that have been drawn: the server sends no more than can be drawn
  let told = 0;
  let wanted = new Set(); // codes of keys that the server wants to know of
  let socket = null;

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

  // Where letters and numbers are typed, they are no commands.
  const typing = (target) =>
    target instanceof HTMLElement &&
    (target.isContentEditable ||
      target instanceof HTMLTextAreaElement ||
      (target instanceof HTMLInputElement && !target.readOnly && ["text", "number", "search"].includes(target.type)));

  const connect = () => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/spatula/hand`);
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (Array.isArray(message.keys)) wanted = new Set(message.keys);
      if (message.blur && document.activeElement instanceof HTMLElement) document.activeElement.blur();
    };
    socket.onopen = tell;
    socket.onclose = () => {
      held.clear();
      setTimeout(connect, 1000);
    };
  };

  window.addEventListener(
    "keydown",
    (event) => {
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
  window.addEventListener("blur", letGo);
  window.addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", letGo);
  const onFrame = () => {
    frames += 1;
    if (performance.now() - told > SHORTEST) tell();
    requestAnimationFrame(onFrame);
  };

  setInterval(tell, PERIOD);
  requestAnimationFrame(onFrame);
  connect();
})();
