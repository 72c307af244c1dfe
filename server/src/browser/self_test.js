// @ts-check
/** `?self-test=SECONDS[&break=SECONDS]`: flies by itself and writes what became of it into the page. */

/**
 * @param {import("../foresight.js").Foresight} client
 * @param {number} seconds how long it flies
 * @param {number | null} breaksAt after how many seconds the connection is broken, if at all
 * @param {HTMLElement} result where a JSON document appears; its `data-state` is `done` then
 */
export async function selfTest(client, seconds, breaksAt, result) {
  const counts = { welcome: 0, fetch: 0, responded: 0, arrived: 0, show: 0, hide: 0, cancel: 0, discard: 0, failed: 0, error: 0, estimates: 0 };
  performance.setResourceTimingBufferSize(100000);
  /** @type {Set<string>} */
  const ordered = new Set();
  /** @type {string[]} */
  const problems = [];
  /** Why connections ended. @type {string[]} */
  const closed = [];
  let [resumed, twice, shares, quality] = [0, 0, 0, /** @type {number | null} */ (null)];
  // Where the contents are: kept, as the session's own welcome is gone while there is no connection.
  let base = "/worlds/";
  for (const type of /** @type {(keyof typeof counts)[]} */ (Object.keys(counts))) {
    client.addEventListener(type, () => { counts[type] += 1; });
  }
  const on = (/** @type {string} */ type, /** @type {(detail: any) => void} */ act) =>
    client.addEventListener(type, (event) => act(/** @type {CustomEvent} */ (event).detail));
  on("welcome", (welcome) => {
    resumed += welcome.resumed ? 1 : 0;
    base = welcome.base ?? base;
  });
  on("connection", ({ state, reason }) => { if (state === "closed") closed.push(reason); });
  on("fetch", (fetch) => {
    ordered.add(fetch.uri);
    twice += client.held.has(fetch.rep) ? 1 : 0;
    shares += fetch.predicted_share >= 0 && fetch.predicted_share <= 1 ? 1 : 0;
  });
  on("estimates", (estimates) => { quality = estimates.quality ?? null; });
  on("error", ({ message }) => problems.push(message));
  on("failed", ({ reason }) => problems.push(reason));
  if (breaksAt !== null) setTimeout(() => client.interrupt(), 1000 * breaksAt);
  await new Promise((resolve) => { setTimeout(resolve, 1000 * seconds); });
  const resident = [...client.held.values()].filter(({ stage }) => stage === "resident");
  // Requests that the browser has made below the world, against those that the server has asked for.
  const root = new URL(base, location.href).href;
  const requests = performance.getEntriesByType("resource").filter(({ name }) => name.startsWith(root));
  const uris = requests.map(({ name }) => name.slice(root.length).replace(/^\//, ""));
  result.textContent = JSON.stringify({
    ...counts,
    resumed,
    twice,
    shares,
    quality,
    problems: problems.slice(0, 20),
    closed,
    connected: client.welcome !== null,
    requests: requests.length,
    not_ordered: uris.filter((uri) => !ordered.has(uri)).length,
    resident: resident.length,
    resident_bytes: resident.reduce((sum, { fetch }) => sum + fetch.decoded_bytes, 0),
    received_bytes: client.receivedBytes,
    used_bytes_max: client.usedBytesMax,
    memory_bytes: client.memoryBytes,
    rows: document.querySelectorAll("#rows tr").length,
  });
  result.hidden = false;
  result.dataset.state = "done";
}
