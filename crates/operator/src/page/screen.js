// State in, keys out. The page decides nothing: it shows what the recorder says, and asks it for what is pressed.

import { MapView } from "./map.js";
import { Cameras } from "./cameras.js";

const HOLD_MS = 900;
const SILENT_MS = 3000;
const RETRY_MS = 700;
const QUICK_NOTES = ["Door moved", "People here", "Glass or mirror", "Repeat this part"];
const LACKS = { far: "only seen from far away", unfaced: "not seen by a camera", "one-sided": "seen from one side only" };
const ASKS = {
  needed: "It is shown on the scanner's terminal.",
  wrong: "Wrong PIN. It is shown on the scanner's terminal.",
  barred: "Too many wrong PINs. Wait a minute.",
};
const MARKS = { good: "✓", warning: "!", bad: "✕", unknown: "·" };

const $ = (id) => document.getElementById(id);
const map = new MapView($("map"));
const cameras = new Cameras($("cameras"));
let socket = null;
let lastHeard = performance.now();
let state = null;

// ---- connection

function connect() {
  // Of a page that came by TLS, wss: it lies beside the page.
  socket = new WebSocket(new URL("live", location.href).href.replace(/^http/, "ws"), "lsfb.operator.v1");
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    lastHeard = performance.now();
    $("offline").hidden = true;
    if (typeof data !== "string") {
      if (!cameras.take(data)) map.take(data);
      $("map-empty").hidden = !map.empty;
      return;
    }
    const message = JSON.parse(data);
    if (message.pin) askPin(message.pin);
    else if ("answer" in message) answered(message);
    else show(message);
  };
  socket.onclose = () => {
    // The whole map comes again with the next connection.
    setTimeout(connect, RETRY_MS);
  };
}

setInterval(() => {
  cameras.age();
  const waiting = $("ask").open;
  if (!waiting && performance.now() - lastHeard > SILENT_MS) $("offline").hidden = false;
}, 500);

function send(message) {
  if (socket?.readyState !== WebSocket.OPEN) return toast("No connection", "bad");
  socket.send(JSON.stringify(message));
}

let pinOfLink = new URLSearchParams(location.hash.slice(1)).get("pin");

function askPin(what) {
  if (what === "right") return $("ask").close();
  if (pinOfLink) {
    socket.send(JSON.stringify({ pin: pinOfLink }));
    pinOfLink = null;
    return;
  }
  $("ask-why").textContent = ASKS[what] ?? ASKS.needed;
  $("ask-pin").value = "";
  if (!$("ask").open) $("ask").showModal();
}
$("ask").addEventListener("cancel", (e) => e.preventDefault());
$("ask").querySelector("form").addEventListener("submit", (e) => {
  e.preventDefault();
  $("ask-why").textContent = "Checking …";
  socket.send(JSON.stringify({ pin: $("ask-pin").value.trim() }));
});

function answered({ answer, error, said }) {
  if (error) toast(error, "bad");
  else if (said) toast(said, "good");
  if (answer === "start" || answer === "stop") $("run").disabled = false;
}

let toastTimer = 0;
function toast(words, level) {
  $("toast").textContent = words;
  $("toast").dataset.level = level;
  $("toast").hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { $("toast").hidden = true; }, level === "bad" ? 6000 : 2500);
}

// ---- state

const PHASES = { ready: "READY", starting: "STARTING", recording: "RECORDING", stopping: "STOPPING" };

function show(next) {
  if (state?.phase !== "starting" && next.phase === "starting") cameras.clear();
  state = next;
  document.body.dataset.phase = state.phase;
  // A recording that ended badly is not "ready": nobody should press START without having read why.
  const failed = state.phase === "ready" && state.message_level === "bad";
  document.body.dataset.failed = String(failed);
  const recording = state.phase === "recording";
  $("phase-word").textContent = failed ? "FAILED" : PHASES[state.phase];
  $("clock").textContent = recording ? clock(state.recording_s) : "";
  $("file").textContent = state.file || " ";
  showTiles();
  showAlarm();
  showGoBack();
  showStreams();
  const run = $("run");
  const does = recording || state.phase === "stopping" ? "stop" : "start";
  if (run.dataset.does !== does || run.dataset.phase !== state.phase || run.dataset.failed !== String(failed)) {
    run.dataset.does = does;
    run.dataset.phase = state.phase;
    run.dataset.failed = String(failed);
    run.innerHTML = does === "stop" ? "STOP<small>hold for a second</small>" : failed ? "START AGAIN" : "START";
    run.disabled = state.phase === "starting" || state.phase === "stopping";
  }
  $("note").disabled = $("point").disabled = !recording;
  $("walked").textContent = `${state.path_m.toFixed(0)} m walked`;
  const { seen_m2, good_m2 } = state.coverage;
  $("covered").textContent = seen_m2 > 0 ? `${Math.round((100 * good_m2) / seen_m2)} % well covered` : "";
  // They are recorded; the map lacks them.
  $("skipped").textContent = state.skipped_scans > 0 ? `${count(state.skipped_scans)} scans skipped` : "";
  showLoops();
  map.state(state.pose, state.coverage.go_back, state.control_points, state.unseen, state.loops);
}

let loopsShown = 0;
function showLoops() {
  const { loop_count: found, loops } = state;
  $("loops").textContent = found > 0 ? `${count(found)} ${found === 1 ? "loop" : "loops"}` : "";
  // Nothing moves: the map is put right at home.
  if (found > loopsShown && loops.length > 0) toast(`Place recognised: the live map is ${length(loops.at(-1).off_m)} off here`, "good");
  loopsShown = found;
}

function tile(id, level, value, small) {
  const item = $(`tile-${id}`);
  item.dataset.level = level;
  item.querySelector("i").textContent = level === "unknown" ? "" : MARKS[level];
  item.querySelector(".value").textContent = value;
  item.querySelector("small").textContent = small;
}

function showTiles() {
  const { sync, storage, battery, lost, streams } = state;
  const spread = sync.spread_ms;
  tile("sync", sync.level, spread === null ? "–" : duration(spread), spread === null ? "" : sync.level === "good" ? "in sync" : "out of sync");
  const losing = streams.filter((s) => s.lost > 0).map((s) => s.name);
  const live = streams.length > 0;
  tile("lost", lost > 0 ? "bad" : live ? "good" : "unknown", live ? count(lost) : "–", losing.join(", "));
  tile("disk", storage?.level ?? "unknown",
    storage ? (storage.full_in_s === null ? bytes(storage.free_bytes) : roughly(storage.full_in_s)) : "–",
    storage ? (storage.full_in_s === null ? "free" : bytes(storage.free_bytes)) : "");
  $("tile-battery").hidden = false;
  tile("battery", battery?.level ?? "unknown", battery ? `${Math.round(battery.percent)} %` : "–", battery ? (battery.charging ? "charging" : "") : "none");
}

let alarmed = "";
function showAlarm() {
  const problems = state.streams.filter((s) => s.problem).map((s) => ({ level: s.level, text: `${s.name}: ${s.problem}` }));
  if (state.sync.problem) problems.push({ level: state.sync.level, text: state.sync.problem });
  if (state.storage?.problem) problems.push({ level: state.storage.level, text: state.storage.problem });
  if (state.tracking_problem) problems.push({ level: "warning", text: state.tracking_problem });
  if (state.message) problems.push({ level: state.message_level, text: state.message });
  const worst = problems.some((p) => p.level === "bad") ? "bad" : problems.some((p) => p.level === "warning") ? "warning" : "good";
  // The worst first: what does not fit is the least of it.
  const rank = { bad: 0, warning: 1 };
  problems.sort((a, b) => (rank[a.level] ?? 2) - (rank[b.level] ?? 2));
  const text = problems.slice(0, 3).map((p) => p.text).join("\n");
  const alarm = $("alarm");
  alarm.hidden = !text;
  alarm.dataset.level = worst;
  if (alarm.textContent !== text) alarm.textContent = text;
  if (worst === "bad" && text !== alarmed) navigator.vibrate?.([300, 100, 300]);
  alarmed = worst === "bad" ? text : "";
}

function showGoBack() {
  const { pose, coverage } = state;
  const list = $("go-back");
  list.replaceChildren(...(pose ? coverage.go_back : []).map((spot, i) => {
    const [dx, dy] = [spot.x_m - pose.x_m, spot.y_m - pose.y_m];
    // Up is straight ahead.
    const turn = pose.yaw_rad - Math.atan2(dy, dx);
    const item = document.createElement("li");
    item.append(
      span("number", String(i + 1)), span("arrow", "⬆"), span("far", `${Math.hypot(dx, dy).toFixed(0)} m`), span("why", LACKS[spot.reason] ?? ""),
    );
    item.querySelector(".arrow").style.transform = `rotate(${turn}rad)`;
    return item;
  }));
}

function showStreams() {
  $("streams").replaceChildren(...state.streams.map((s) => {
    const item = document.createElement("li");
    item.dataset.level = s.level;
    item.append(span("mark", MARKS[s.level]), span("name", s.name), span("rate", `${s.rate_hz.toFixed(1)} Hz`));
    const words = s.problem || (s.lost > 0 ? `${s.lost} lost` : "");
    if (words) item.append(span("problem", words));
    return item;
  }));
}

function span(name, text) {
  const element = document.createElement("span");
  element.className = name;
  element.textContent = text;
  return element;
}

function clock(secs) {
  const s = Math.floor(secs);
  const two = (n) => String(n).padStart(2, "0");
  return s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}` : `${two(Math.floor(s / 60))}:${two(s % 60)}`;
}

function roughly(secs) {
  const minutes = Math.floor(secs / 60);
  if (minutes >= 6000) return ">99 h";
  if (minutes >= 60) return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")}`;
  return `${minutes} min`;
}

function length(m) {
  return m < 1 ? `${(100 * m).toFixed(0)} cm` : `${m.toFixed(1)} m`;
}

function duration(ms) {
  if (ms >= 1000) return `${(ms / 1000).toFixed(1)} s`;
  return `${ms < 10 ? ms.toFixed(1) : ms.toFixed(0)} ms`;
}

function count(n) {
  if (n < 10000) return String(n);
  return n < 1e6 ? `${Math.floor(n / 1e3)} k` : `${(n / 1e6).toFixed(1)} M`;
}

function bytes(n) {
  return n >= 1e12 ? `${(n / 1e12).toFixed(1)} TB` : n >= 1e9 ? `${(n / 1e9).toFixed(0)} GB` : `${(n / 1e6).toFixed(0)} MB`;
}

// ---- keys

// A start is one press. A stop is held, since nobody wants one from a sleeve.
let held = 0;
const run = $("run");
run.addEventListener("click", () => {
  if (run.dataset.does === "start" && !run.disabled) {
    run.disabled = true;
    send({ command: "start" });
  }
});
function release() {
  clearTimeout(held);
  run.classList.remove("held");
}
run.addEventListener("pointerdown", () => {
  if (run.dataset.does !== "stop" || run.disabled) return;
  run.classList.add("held");
  held = setTimeout(() => {
    release();
    run.disabled = true;
    send({ command: "stop" });
  }, HOLD_MS);
});
for (const end of ["pointerup", "pointerleave", "pointercancel"]) run.addEventListener(end, release);
run.addEventListener("contextmenu", (e) => e.preventDefault());

$("zoom-in").onclick = () => map.zoom(1.5);
$("zoom-out").onclick = () => map.zoom(1 / 1.5);
$("follow").onclick = () => $("follow").setAttribute("aria-pressed", String(map.toggle()));
$("sensors").onclick = () => {
  const shown = document.body.classList.toggle("show-sensors");
  $("sensors").setAttribute("aria-pressed", String(shown));
};

let saying = null;
function say(command) {
  saying = command;
  const note = command === "note";
  $("say-title").textContent = note ? "Note" : "Control point: stand still on it";
  $("say-text").value = note ? "" : `P${(state?.control_points.length ?? 0) + 1}`;
  $("say-quick").replaceChildren(...(note ? QUICK_NOTES : []).map((words) => {
    const key = document.createElement("button");
    key.type = "button";
    key.textContent = words;
    key.onclick = () => { $("say-text").value = words; submit(); };
    return key;
  }));
  $("say").showModal();
  if (!note) $("say-text").select();
}
function submit() {
  const text = $("say-text").value.trim();
  if (!text) return;
  $("say").close();
  send(saying === "note" ? { command: "note", text } : { command: "control-point", name: text });
}
$("note").onclick = () => say("note");
$("point").onclick = () => say("control-point");
$("say-no").onclick = () => $("say").close();
$("say").querySelector("form").addEventListener("submit", (e) => { e.preventDefault(); submit(); });

// ---- the rest

map.onScale = (mPerPx) => {
  const step = [0.5, 1, 2, 5, 10, 20, 50, 100].find((m) => m / mPerPx >= 60) ?? 200;
  $("scale").querySelector("i").style.width = `${step / mPerPx}px`;
  $("scale").querySelector("span").textContent = `${step} m`;
};

// Browsers let only secure pages, and those of the same machine, keep the screen on. Elsewhere the person must set it, and is
// told so until they have said that they know.
const KNOWN = "screen-timeout-known";
async function stayAwake() {
  try {
    await navigator.wakeLock.request("screen");
    $("awake").hidden = true;
  } catch {
    $("awake").hidden = document.hidden || localStorage.getItem(KNOWN) !== null;
  }
}
$("awake-ok").onclick = () => {
  localStorage.setItem(KNOWN, "yes");
  $("awake").hidden = true;
};
document.addEventListener("visibilitychange", () => { if (!document.hidden) stayAwake(); });
stayAwake();
connect();
