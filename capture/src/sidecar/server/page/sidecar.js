// The page: a phone records a walk beside the rig.

import { Spool } from "./spool.js";
import { Link } from "./link.js";
import { Camera, Motion, SCHEMAS } from "./sensors.js";

// From here on images are left out, and motion never.
const MOST_SPOOLED_BYTES = 512 << 20;
const CHANNELS_PER_PART = 2;
const ask = (selector) => document.querySelector(selector);
const show = (selector, text) => {
  ask(selector).textContent = text;
};

// Each load of the page has a clock of its own, that begins at zero.
const clockId = `performance.now/${crypto.getRandomValues(new Uint32Array(1))[0].toString(16)}`;
const state = { phase: "starting", problem: "" };

function tell(problem) {
  state.problem = problem;
  draw();
}

function invitation() {
  const token = new URLSearchParams(location.hash.slice(1)).get("tok") ?? "";
  if (!/^[0-9a-f]{32}$/.test(token)) return null;
  return Uint8Array.from(token.match(/../g), (digits) => parseInt(digits, 16));
}

function draw() {
  const { spool, link, camera, motion } = state;
  if (!spool) return show("#problem", state.problem);
  const { session } = spool;
  const words = {
    off: "not connected",
    connecting: "connecting …",
    connected: `connected, ${link.roundTripMs?.toFixed(1) ?? "–"} ms round trip`,
    gone: "RIG DISCONNECTED: data is kept here and sent once it is back",
  };
  document.body.dataset.phase = state.phase;
  document.body.dataset.link = link.state;
  show("#link", words[link.state]);
  show("#images", `${camera.images} images${camera.leftOut > 0 ? `, ${camera.leftOut} DROPPED: storage is full` : ""}`);
  show("#samples", `${motion.samples} motion samples`);
  const done = spool.done ? `all ${spool.done.last} messages sent to the rig` : "no walk";
  show("#stored", session ? `${session.stored} of ${session.last} messages sent to the rig` : done);
  show("#spool", `${spool.count} waiting here, ${(spool.bytes / 2 ** 20).toFixed(1)} MiB`);
  show("#problem", [state.problem, link.refusal].filter(Boolean).join(" · "));
  show("#run", { idle: "START", running: "STOP", paused: "CONTINUE", ending: "SENDING …", starting: "…" }[state.phase]);
  ask("#run").disabled = state.phase === "ending" || state.phase === "starting";
  ask("#name").disabled = Boolean(spool.device);
}

async function channels() {
  const { spool } = state;
  await spool.beginPart();
  const first = (spool.session.loads - 1) * CHANNELS_PER_PART + 1;
  const prefix = `/sidecar/${spool.device.name}`;
  const kinds = [
    ["cam0/image", SCHEMAS.image],
    ["imu", SCHEMAS.imu],
  ];
  for (const [n, [topic, schema]] of kinds.entries()) {
    const described = { channel: first + n, topic: `${prefix}/${topic}`, schemaName: schema.name, schema: schema.text, clockId };
    await spool.keepChannel(described);
  }
  return { image: first, imu: first + 1 };
}

// Measures: what there is goes into the spool, whether there is a rig or not.
async function measure() {
  const { spool, camera, motion } = state;
  state.channels = await channels();
  const failures = [];
  for (const sensor of [motion, camera]) {
    try {
      await sensor.start();
    } catch (error) {
      failures.push(error.message);
    }
  }
  state.phase = "running";
  spool.onFailure = (error) => tell(`storage: ${error.message}`);
  tell(failures.join(" · "));
  // Only where there is one, and only while the page is seen.
  navigator.wakeLock?.request("screen").catch(() => {});
}

async function run() {
  const { spool, link, camera, motion } = state;
  const { phase } = state;
  if (phase !== "running") motion.ask();
  state.phase = "starting";
  draw();
  if (phase === "running") {
    camera.stop();
    motion.stop();
    await spool.flush();
    await spool.end();
    state.phase = "ending";
    draw();
    link.start(state.token);
    link.pump();
    return;
  }
  if (!spool.device) {
    const name = ask("#name").value.trim();
    if (!/^[A-Za-z0-9_-]{1,64}$/.test(name)) {
      state.phase = "idle";
      return tell("a name may contain letters, digits, - and _");
    }
    await spool.keepDevice({ name, key: crypto.getRandomValues(new Uint8Array(32)), isPaired: false });
  }
  if (phase === "idle") await spool.begin();
  await measure();
  link.start(state.token);
}

// Another phone has the name: what was measured since is on its topics, and begins again.
async function takeAnotherName() {
  const { spool, camera, motion } = state;
  camera.stop();
  motion.stop();
  await spool.flush();
  await spool.close();
  spool.done = null;
  await spool.keepDevice(null);
  state.phase = "idle";
}

async function open() {
  state.token = invitation();
  // The code is of no use to whoever reads the address later.
  if (state.token) history.replaceState(null, "", location.pathname);
  const spool = await Spool.open();
  await navigator.storage?.persist?.().catch(() => false);
  const link = new Link(spool, clockId);
  const put = (kind) => (timeNs, bytes) => {
    if (kind === "image" && spool.bytes > MOST_SPOOLED_BYTES) return false;
    spool.add(state.channels[kind], timeNs, bytes);
    return true;
  };
  Object.assign(state, { spool, link, camera: new Camera(ask("#video"), put("image")), motion: new Motion(put("imu")) });
  ask("#name").value = spool.device?.name ?? `browser-${crypto.getRandomValues(new Uint16Array(1))[0].toString(16)}`;
  link.onChange = draw;
  spool.onStored = () => {
    link.pump();
    draw();
  };
  link.onRefused = async (code) => {
    // The next invitation pairs it again; what was measured stays.
    if (code === 1) await spool.keepDevice({ ...spool.device, isPaired: false });
    if (code === 3 && !spool.device.isPaired) await takeAnotherName();
    draw();
  };
  link.onFinished = () => {
    state.phase = "idle";
    draw();
  };
  ask("#run").onclick = () => run().catch((error) => tell(error.message));
  state.phase = { true: "ending", false: "paused" }[spool.session?.ended] ?? "idle";
  if (spool.session) link.start(state.token);
  draw();
  setInterval(draw, 1_000);
}

document.addEventListener("visibilitychange", () => {
  if (state.phase === "running") {
    tell(document.hidden ? "PAUSED: browsers stop sensors while the page is hidden" : "the page was hidden for a while, and nothing was recorded");
  }
});
addEventListener("pagehide", () => state.spool?.flush());

if (!navigator.locks || !indexedDB || !crypto.randomUUID) {
  tell("this browser is not supported: update it");
} else {
  // Two windows of one browser would number the same walk.
  navigator.locks.request("lsfb-sidecar", { ifAvailable: true }, async (lock) => {
    if (!lock) return tell("already open in another window of this browser");
    try {
      await open();
    } catch (error) {
      tell(error.message);
    }
    return new Promise(() => {});
  });
}

// For whoever looks into it by the browser's console.
globalThis.sidecar = state;
