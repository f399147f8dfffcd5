// Turns the sticks and buttons of a gamepad into the page's keys: see saver_advisors/viewing/gamepad.py.
(() => {
  if (window.saverGamepad) return;
  const period = PERIOD; // of an action, ms
  const deadZone = 0.15;
  // A stick moves the target by its deflection times an action's way in every period.
  const ways = [
    ["ArrowLeft", "ArrowRight"],
    ["ArrowUp", "ArrowDown"],
    ["PageUp", "PageDown"],
  ];
  const buttons = BUTTONS; // number in the standard layout -> key
  let owed = [0, 0, 0]; // part of a key's way, of each axis, that is still to go
  let held = [];

  function press(key) {
    const code = key === " " ? "Space" : key;
    document.body.dispatchEvent(new KeyboardEvent("keydown", { key, code, bubbles: true }));
  }

  function deflection(pad) {
    const [x, y, , z] = pad.axes;
    const size = Math.hypot(x, y, z);
    if (size < deadZone) return [0, 0, 0];
    return [x, y, z].map((one) => one / Math.max(1, size));
  }

  function say(text) {
    const line = document.getElementById("saver-gamepad");
    if (line && line.textContent !== text) line.textContent = text;
  }

  function poll() {
    if (document.hidden) return;
    const pads = [...navigator.getGamepads()].filter((one) => one !== null);
    const pad = pads.find((one) => one.mapping === "standard");
    if (pad === undefined) {
      say(pads.length ? "Gamepad: its layout is unknown" : "Gamepad: none, or no button was pressed yet");
      owed = [0, 0, 0];
      return;
    }
    say("Gamepad: connected");
    deflection(pad).forEach((amount, axis) => {
      owed[axis] = amount === 0 ? 0 : owed[axis] + amount;
      // A third and two thirds are a whole, whatever their sum in floating point is.
      if (Math.abs(owed[axis]) > 1 - 1e-9) {
        press(ways[axis][owed[axis] > 0 ? 1 : 0]);
        owed[axis] -= Math.sign(owed[axis]);
      }
    });
    const now = pad.buttons.map((one) => one.pressed);
    for (const [number, key] of Object.entries(buttons)) {
      if (now[number] && !held[number]) press(key);
    }
    held = now;
  }

  window.saverGamepad = { poll, timer: setInterval(poll, period) };
})();
