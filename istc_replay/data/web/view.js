// Starts Rerun's viewer on the canvas and lets the buttons of the page set its time.
"use strict";

const status_line = document.getElementById("status");
const canvas = document.getElementById("scene");
const ARRIVAL_MS = 120000;

function say(text) {
  status_line.textContent = text;
  status_line.hidden = text === "";
}

// --- the request that sets the time, in the viewer's own encoding (protobuf) ---

function varint(value) {
  const bytes = [];
  for (let rest = BigInt.asUintN(64, BigInt(value)); ; rest >>= 7n) {
    if (rest < 128n) return [...bytes, Number(rest)];
    bytes.push(Number(rest & 127n) | 128);
  }
}

const field = (number, bytes) => [...varint((number << 3) | 2), ...varint(bytes.length), ...bytes];

function time_request(instant_ns) {
  const timeline = field(1, new TextEncoder().encode("scenario_time"));
  const time = [8, ...varint(instant_ns)];
  const paused = [(5 << 3) | 0, 1];
  return new Uint8Array(field(6, [...field(2, timeline), ...field(3, time), ...paused]));
}

const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

async function set_time(viewer, instant_ns) {
  // Refused until the recording has arrived.
  for (const began = Date.now(); ; await pause(200)) {
    try {
      return await viewer.viewer_control(time_request(instant_ns));
    } catch (error) {
      if (viewer.has_panicked()) throw new Error(viewer.panic_message());
      if (Date.now() - began > ARRIVAL_MS) throw error;
    }
  }
}

// --- the page ---

async function start() {
  if (location.protocol === "file:") {
    say("The scene needs a web server: run “python -m http.server --bind 127.0.0.1” in this folder, open http://127.0.0.1:8000/.");
    return;
  }
  say("Loading the viewer…");
  await wasm_bindgen({ module_or_path: fetch("re_viewer_bg.wasm") });
  const query = new URLSearchParams(location.search);
  const viewer = new wasm_bindgen.WebHandle({
    url: [new URL("view.rrd", location.href).href],
    render_backend: query.get("renderer"),
    theme: query.get("theme") ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"),
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
  });
  name_inputs();
  await viewer.start(canvas);
  window.viewer = viewer;
  for (const button of document.querySelectorAll("button[data-ns]")) {
    button.disabled = false;
    button.addEventListener("click", () => {
      history.replaceState(null, "", "#ns=" + button.dataset.ns);
      set_time(viewer, button.dataset.ns).catch(fail);
    });
  }
  const asked = /^#ns=(-?\d{1,19})$/.exec(location.hash);
  await set_time(viewer, asked ? asked[1] : document.body.dataset.ns);
  say("");
  document.body.dataset.ready = "yes";
  watch(viewer);
}

// The viewer takes typed text by an input of its own, which has no name for those who hear the page.
function name_inputs() {
  new MutationObserver(() => {
    for (const input of document.querySelectorAll("input:not([aria-label])"))
      input.setAttribute("aria-label", "Text typed into the scene");
  }).observe(document.documentElement, { childList: true, subtree: true });
}

function watch(viewer) {
  if (viewer.has_panicked()) fail(new Error(viewer.panic_message()));
  else setTimeout(watch, 1000, viewer);
}

function fail(error) {
  document.body.dataset.failed = "yes";
  say("The viewer stopped: " + String(error && error.message ? error.message : error).slice(0, 300) +
    " Try the address with ?renderer=webgl, or open view.rrd in Rerun.");
}

start().catch(fail);
