// @ts-check
/** The page: flies through a world, and shows what is fetched, why, and what it makes of the view. */

import { FlyCamera } from "./camera.js";
import { drawMap, drawTimeline } from "./charts.js";
import { Foresight } from "../foresight.js";
import { selfTest } from "./self_test.js";

/** Rows of the table; the trail and the dots on the map. */
const [ROWS, TRAIL, DOTS] = [30, 600, 2000];
/** From one renewal of the figures to the next, ms. */
const RENEW_MS = 500;
/** Seconds there and back when it flies by itself. */
const PERIOD_S = 60;

const parameters = new URLSearchParams(location.search);
/** @param {string} id @returns {any} */
const element = (id) => document.getElementById(id);
const map = /** @type {HTMLCanvasElement} */ (element("map"));

/** @type {Foresight | null} */
let client = null;
/** @type {FlyCamera | null} */
let camera = null;
/** What the page remembers of the session. */
let seen = fresh();

function fresh() {
  return {
    /** @type {number[][]} */ trail: [],
    /** @type {{ at: number[], share: number | undefined }[]} */ fetched: [],
    /** @type {Map<number, { fetch: any, state: string, began: number, took: number | null }>} */ rows: new Map(),
    /** @type {{ bytes: number, quality: number | null }[]} */ samples: [],
    /** @type {any} */ estimates: null,
    wait: "",
    received: 0,
    began: performance.now(),
  };
}

const text = (/** @type {string} */ id, /** @type {string} */ value) => {
  if (element(id).textContent !== value) element(id).textContent = value;
};
const megabytes = (/** @type {number} */ bytes) => `${(bytes / 1e6).toFixed(1)} MB`;

/** @param {{ world: string, memoryBytes: number, policy?: string }} settings */
function begin(settings) {
  client?.stop();
  seen = fresh();
  camera = null;
  const began = new Foresight({
    server: new URL("../", location.href).href,
    token: parameters.get("token") ?? undefined,
    decode: ({ uri }, bytes) => ({ uri, bytes: bytes.length }),
    ...settings,
  });
  client = began;
  const on = (/** @type {string} */ type, /** @type {(detail: any) => void} */ act) =>
    began.addEventListener(type, (event) => {
      if (began === client) act(/** @type {CustomEvent} */ (event).detail);
    });
  on("welcome", (welcome) => {
    camera ??= new FlyCamera(welcome.bounds, welcome.up);
    text("status", `Connected to ${welcome.world}: ${welcome.representations} representations, policy ${welcome.policy}.`);
  });
  on("connection", ({ state, reason }) => {
    if (state === "closed") text("status", `No connection: ${reason}`);
  });
  on("error", ({ message }) => text("status", `The server says: ${message}`));
  on("switch", ({ driving }) => text("status", driving ? "The server drives." : "The server does not drive."));
  on("fetch", (fetch) => {
    seen.rows.delete(fetch.rep);
    seen.rows.set(fetch.rep, { fetch, state: "requested", began: performance.now(), took: null });
    for (const oldest of seen.rows.keys()) {
      if (seen.rows.size <= ROWS) break;
      seen.rows.delete(oldest);
    }
    if (camera) seen.fetched.push({ at: camera.onMap(/** @type {any} */ (camera.position)), share: fetch.predicted_share });
    if (seen.fetched.length > DOTS) seen.fetched.shift();
  });
  const becomes = (/** @type {string} */ type, /** @type {string} */ state) => on(type, ({ rep }) => {
    const row = seen.rows.get(rep);
    if (!row) return;
    row.state = state;
    if (state === "shown") row.took = performance.now() - row.began;
  });
  becomes("responded", "arriving");
  becomes("arrived", "decoding");
  becomes("show", "shown");
  becomes("cancel", "cancelled");
  becomes("discard", "discarded");
  becomes("failed", "failed");
  on("estimates", (estimates) => { seen.estimates = estimates; });
  on("wait", ({ because }) => { seen.wait = because ?? ""; });
  began.start();
  return began;
}

function renew() {
  if (!client) return;
  const { estimates } = seen;
  const bytes = client.receivedBytes - seen.received;
  seen.received = client.receivedBytes;
  seen.samples.push({ bytes, quality: estimates?.quality ?? null });
  if (seen.samples.length > 120) seen.samples.shift();
  element("memory-used").value = client.usedBytes / client.memoryBytes;
  text("memory-text", `${megabytes(client.usedBytes)} of ${megabytes(client.memoryBytes)}`);
  text("received", `${megabytes(client.receivedBytes)}, ${client.held.size} held or requested`);
  text("wait", seen.wait || "–");
  if (estimates) {
    text("quality", estimates.quality === undefined ? "nothing in view" : estimates.quality.toFixed(3));
    text("link", `${((8 * estimates.rate) / 1e6).toFixed(2)} Mbit/s, ${(1e3 * estimates.latency_s).toFixed(0)} ms`);
    text("alpha", estimates.alpha === undefined ? "–" : estimates.alpha.toFixed(2));
    element("timeline").setAttribute("aria-label", `Bytes received, and the quality of the view, now ${estimates.quality}`);
  }
  const why = (/** @type {any} */ { predicted_share: share }) =>
    share === undefined ? "–" : share >= 0.5 ? `predicted ${Math.round(100 * share)} %` : `worst case ${Math.round(100 - 100 * share)} %`;
  const rows = [...seen.rows.values()].reverse().map(({ fetch, state, took }) => {
    const row = document.createElement("tr");
    const cells = [fetch.rep, fetch.uri, (fetch.wire_bytes / 1e3).toFixed(1), fetch.urgency, why(fetch), state, took?.toFixed(0) ?? ""];
    cells.forEach((value, i) => {
      const cell = row.insertCell();
      cell.textContent = String(value);
      if ([0, 2, 3, 6].includes(i)) cell.className = "n";
    });
    return row;
  });
  element("rows").replaceChildren(...rows);
  drawTimeline(element("timeline"), seen.samples);
}

let last = performance.now();
function frame() {
  const now = performance.now();
  const seconds = Math.min(0.1, (now - last) / 1000);
  last = now;
  if (camera && client) {
    if (element("glides").checked) camera.glide((now - seen.began) / 1000, PERIOD_S);
    else camera.step(seconds);
    client.look(camera.view(Math.max(1, map.width), Math.max(1, map.height)));
    seen.trail.push(camera.onMap(/** @type {any} */ (camera.position)));
    if (seen.trail.length > TRAIL) seen.trail.shift();
    drawMap(map, camera, seen);
  }
  requestAnimationFrame(frame);
}

map.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.code === "Tab") return;
  camera?.keys.add(event.code);
  if (camera && event.code !== "ShiftLeft" && event.code !== "ShiftRight") element("glides").checked = false;
  event.preventDefault();
});
map.addEventListener("keyup", (event) => camera?.keys.delete(event.code));
map.addEventListener("blur", () => camera?.keys.clear());
element("interrupt").addEventListener("click", () => client?.interrupt());
element("settings").addEventListener("submit", (/** @type {Event} */ event) => {
  event.preventDefault();
  begin(settings());
});

function settings() {
  return {
    world: element("world").value,
    memoryBytes: Math.max(1, Math.round(Number(element("memory").value) * (1 << 20)) || 1),
    policy: element("policy").value || undefined,
  };
}

async function main() {
  /** @type {Record<string, string>} */
  const headers = parameters.has("token") ? { Authorization: `Bearer ${parameters.get("token")}` } : {};
  const response = await fetch(new URL("../worlds", location.href), { headers });
  if (!response.ok) throw new Error(`the list of worlds: status ${response.status}`);
  const worlds = await response.json();
  element("world").replaceChildren(...worlds.map((/** @type {any} */ { name }) => new Option(name, name)));
  for (const name of ["world", "memory", "policy"]) if (parameters.has(name)) element(name).value = parameters.get(name);
  setInterval(renew, RENEW_MS);
  requestAnimationFrame(frame);
  const test = Number(parameters.get("self-test"));
  if (test > 0) {
    await selfTest(begin(settings()), test, Number(parameters.get("break")) || null, element("result"));
  } else {
    begin(settings());
  }
}

main().catch((error) => text("status", String(error)));
