// @ts-check
/**
 * A client of a Foresight server: it says where the cameras are, fetches what it is told, and lets go what it is told.
 *
 * ```js
 * import { Foresight } from "https://server.example/foresight.js";
 *
 * const client = new Foresight({
 *   server: "https://server.example/",
 *   world: "city",
 *   memoryBytes: 256 << 20,
 *   decode: async ({ uri }, bytes) => parseTile(uri, bytes),   // what you draw; it may take its time
 * });
 * client.addEventListener("show", ({ detail }) => scene.add(detail.content));
 * client.addEventListener("hide", ({ detail }) => { scene.remove(detail.content); detail.content.dispose(); });
 * client.start();
 * function frame() {
 *   client.look({ position, orientation, fov_y, viewport });    // metres, x y z w, radians, pixels
 *   requestAnimationFrame(frame);
 * }
 * frame();
 * ```
 *
 * Everything that happens is told to the server once an animation frame, in one message. When the connection breaks,
 * requests under way go on, and the session is resumed with what is held by then.
 *
 * Events, each with a `detail`: `connection` {state, reason}, `welcome`, `fetch`, `cancel`, `wait`, `estimates`, `switch`
 * and `error` as the server sends them, `responded` and `arrived` {rep, bytes}, `show` and `hide` {rep, content},
 * `failed` {rep, reason}. What is let go while it is being decoded is hidden without having been shown.
 *
 * No dependencies. Needs ES modules, private fields, `fetch` with streams, and WebSocket.
 */

/**
 * @typedef {object} Camera
 * @property {[number, number, number]} position metres in the world
 * @property {[number, number, number, number]} orientation x, y, z, w of the unit quaternion that turns a camera looking
 *   along −z with +y up into the world
 * @property {number} fov_y vertical field of view, radians
 * @property {[number, number]} viewport width and height, pixels
 * @property {number} [weight] how much it counts among several; 1 if absent
 *
 * @typedef {object} Fetch What the server asks for.
 * @property {number} rep
 * @property {string} uri
 * @property {number} wire_bytes
 * @property {number} decoded_bytes
 * @property {number} urgency 0, the most urgent, to 7
 * @property {number} deadline_ns
 * @property {number} [predicted_share]
 * @property {number} [after] decoded after this one
 * @property {number[]} [discard_on_arrival]
 *
 * @typedef {object} Options
 * @property {string} [server] where the server is; the page's own if absent
 * @property {string} world its name there
 * @property {number} memoryBytes for everything that is fetched
 * @property {(fetch: Fetch, bytes: Uint8Array) => unknown} [decode] makes of bytes what is shown; may return a promise
 * @property {"partial" | "atomic"} [refinement] when children may be drawn: beside their parent, or only all at once
 * @property {string} [policy] with its options; the server's default if absent
 * @property {string} [client] name under which the server keeps what it learns of the link
 * @property {string} [token] that the server asks for
 * @property {number} [stallMs] a request fails when nothing comes for so long; 60 s if absent
 *
 * @typedef {object} Held What is requested or there.
 * @property {Fetch} fetch
 * @property {"requested" | "arrived" | "decoding" | "resident"} stage
 * @property {boolean} responded the server has been told of a response
 * @property {boolean} answered a response has come
 * @property {number} received bytes of it so far
 * @property {Uint8Array | null} bytes
 * @property {unknown} content
 * @property {AbortController} controller
 */

/** Version of the messages. */
export const VERSION = 1;

/** Least and longest time until a broken connection is opened again, ms; it doubles from the one to the other. */
const BACK_OFF_MS = [250, 8000];
/** A view is repeated after this time although nothing moves, ms; also how often is looked while the page is hidden. */
const QUIET_MS = 100;
/** From one frame to the next at least, ms: a screen of 240 Hz need not be told of. */
const SPACING_MS = 7;
/** A connection over which nothing comes for so long, although views are sent, is opened anew, ms. */
const SILENCE_MS = 15000;
/** A page that did not run for longer may have messages waiting: silence counts anew, once until something is heard. */
const STALL_MS = 1000;
/** Views wait while more than this waits to be sent, bytes. */
const BACKLOG_BYTES = 1 << 16;
/** Connections to one host that browsers open where HTTP/1.1 is spoken: what is requested beyond them waits. */
const CONNECTIONS = 6;
/** Errors after which another attempt would end the same. */
const FOR_GOOD = ["version", "world", "value", "malformed"];

export class Foresight extends EventTarget {
  /** @type {Options} */ #options;
  /** @type {URL} */ #server;
  /** @type {Map<number, Held>} */ #held = new Map();
  /** @type {object[]} */ #queue = [];
  /** @type {WebSocket | null} */ #socket = null;
  /** The welcome of the session, while its connection stands. @type {any} */ #welcome = null;
  /** @type {string | null} */ #session = null;
  /** What the latest hello said is resident. @type {Set<number>} */ #greeted = new Set();
  #greetedAt = 0;
  /** When the session began, ms of the page's clock, and what had been received by then. */
  #epoch = 0;
  #epochBytes = 0;
  #received = 0;
  #toldBytes = [-1, -1];
  /** @type {Camera[]} */ #cameras = [];
  #moved = false;
  #sentAt = 0;
  #heardAt = 0;
  /** When the last frame was, and whether a stall since the last message is excused. */
  #ranAt = 0;
  #excused = false;
  #attempts = 0;
  #running = false;
  /** @type {any[]} */ #timers = [];
  #animation = 0;
  #used = 0;
  #usedMax = 0;
  /** Least time from order to response of late, ms. */
  #latency = 1000;

  /** @param {Options} options */
  constructor(options) {
    super();
    this.#options = { refinement: "partial", stallMs: 60000, decode: (_, bytes) => bytes, ...options };
    this.#server = new URL(options.server ?? "/", globalThis.location?.href);
  }

  /** Bytes of memory in use, and the most that ever were: of requests their bytes on the wire, of arrivals those and the
   * decoded ones, then the decoded ones. */
  get usedBytes() { return this.#used; }
  get usedBytesMax() { return this.#usedMax; }
  /** Bytes received so far. */
  get receivedBytes() { return this.#received; }
  get memoryBytes() { return this.#options.memoryBytes; }
  /** The welcome of the session; null while there is no connection. */
  get welcome() { return this.#welcome; }
  /** What is requested or there, by representation. @returns {ReadonlyMap<number, Readonly<Held>>} */
  get held() { return this.#held; }

  /** Connects, and stays connected until `stop`. */
  start() {
    if (this.#running) return;
    this.#running = true;
    const loop = () => {
      this.#frame();
      this.#animation = requestAnimationFrame(loop);
    };
    this.#animation = requestAnimationFrame(loop);
    // A hidden page has no animation frames.
    this.#timers.push(setInterval(() => {
      if (performance.now() - this.#sentAt >= QUIET_MS) this.#frame();
    }, QUIET_MS));
    this.#connect();
  }

  /** Says goodbye: aborts what is under way, and lets go of everything. */
  stop() {
    if (!this.#running) return;
    this.#halt();
    if (this.#welcome) this.#send([{ type: "bye" }]);
    for (const rep of [...this.#held.keys()]) this.#letGo(rep);
    this.#close("stopped");
    this.#session = null;
  }

  #halt() {
    this.#running = false;
    cancelAnimationFrame(this.#animation);
    this.#timers.splice(0).forEach(clearInterval);
  }

  /** Closes the connection; it is opened again as after any break. */
  interrupt() {
    this.#close("interrupted");
    this.#retry();
  }

  /** Where the camera is, or several. Told at the next frame. @param {Camera | Camera[]} cameras */
  look(cameras) {
    this.#cameras = Array.isArray(cameras) ? cameras : [cameras];
    this.#moved = true;
  }

  /** Where the camera will go, by seconds from now in order. @param {{in_s: number, camera: Camera}[]} path */
  announce(path) {
    const now = this.#now();
    const views = path.map(({ in_s, camera }) => ({ t_ns: now + Math.round(in_s * 1e9), camera }));
    this.#tell({ type: "path", views });
  }

  /** Changes memory or policy. @param {{memoryBytes?: number, policy?: string}} change */
  set(change) {
    Object.assign(this.#options, change);
    this.#tell({ type: "settings", memory_bytes: change.memoryBytes, policy: change.policy });
  }

  /** Lets go of something by itself: it may be asked for again. @param {number} rep */
  drop(rep) {
    if (this.#letGo(rep)) this.#event("dropped", rep);
  }

  // --- The connection -------------------------------------------------------------------------------------------------

  #connect() {
    const url = new URL("sessions/socket", this.#server);
    url.protocol = url.protocol.replace("http", "ws");
    const protocols = ["foresight.json.v1"];
    if (this.#options.token) protocols.push(`foresight.token.${base64url(this.#options.token)}`);
    const socket = new WebSocket(url, protocols);
    this.#socket = socket;
    this.#heardAt = performance.now();
    this.#emit("connection", { state: "connecting" });
    socket.onopen = () => this.#greet();
    socket.onmessage = ({ data }) => {
      if (socket !== this.#socket) return;
      this.#heardAt = performance.now();
      this.#excused = false;
      for (const message of JSON.parse(data)) {
        if (socket === this.#socket) this.#obey(message);
      }
    };
    socket.onclose = ({ reason }) => {
      if (socket !== this.#socket) return;
      this.#close(reason || "the connection broke");
      this.#retry();
    };
  }

  #greet() {
    const resident = [...this.#held].filter(([, held]) => held.stage === "resident").map(([rep]) => rep);
    this.#greeted = new Set(resident);
    this.#greetedAt = performance.now();
    const { world, memoryBytes, refinement, policy, client } = this.#options;
    const resume = this.#session ?? undefined;
    this.#send([{
      type: "hello", version: VERSION, world, memory_bytes: memoryBytes, refinement, policy, resume, resident, client,
    }]);
  }

  /** @param {any} welcome */
  #enter(welcome) {
    this.#welcome = welcome;
    this.#session = welcome.session;
    this.#attempts = 0;
    this.#queue = [];
    this.#toldBytes = [-1, -1];
    this.#moved = this.#cameras.length > 0;
    if (!welcome.resumed) {
      this.#epoch = this.#greetedAt;
      this.#epochBytes = this.#received;
    }
    // What the server cannot know is spoken of again, or given up where the session is another.
    for (const [rep, held] of [...this.#held]) {
      if (this.#greeted.has(rep)) continue;
      if (!welcome.resumed || (held.stage === "requested" && !held.responded)) {
        this.#letGo(rep);
        continue;
      }
      this.#event("responded", rep);
      if (held.stage !== "requested") this.#event("arrived", rep);
      if (held.stage === "resident") this.#event("completed", rep);
    }
    this.#emit("connection", { state: "open" });
    this.#emit("welcome", welcome);
  }

  /** @param {string} reason */
  #close(reason) {
    const socket = this.#socket;
    this.#socket = null;
    this.#welcome = null;
    socket?.close();
    this.#emit("connection", { state: "closed", reason });
  }

  #retry() {
    if (!this.#running) return;
    const [least, most] = BACK_OFF_MS;
    const wait = Math.min(most, least * 2 ** this.#attempts) * (0.75 + 0.5 * Math.random());
    this.#attempts += 1;
    const timer = setTimeout(() => {
      this.#timers = this.#timers.filter((other) => other !== timer);
      if (!this.#socket) this.#connect();
    }, wait);
    this.#timers.push(timer);
  }

  /** @param {object[]} messages */
  #send(messages) {
    this.#socket?.send(JSON.stringify(messages));
  }

  /** Time of the session, ns. */
  #now() {
    return Math.max(0, Math.round((performance.now() - this.#epoch) * 1e6));
  }

  /** Tells with the next frame; without a connection there is nobody to tell, and the next welcome makes up for it.
   * @param {object} message */
  #tell(message) {
    if (this.#welcome) this.#queue.push(message);
  }

  /** @param {string} type @param {number} rep @param {object} [more] */
  #event(type, rep, more) {
    this.#tell({ type, t_ns: this.#now(), rep, ...more });
  }

  /** Tells what has happened since the last frame, and then where the cameras are. */
  #frame() {
    const now = performance.now();
    if (now - this.#ranAt > STALL_MS && !this.#excused) [this.#heardAt, this.#excused] = [now, true];
    this.#ranAt = now;
    if (this.#socket && now - this.#heardAt > SILENCE_MS) {
      this.#close(`nothing came for ${SILENCE_MS / 1000} s`);
      this.#retry();
    }
    const isLate = (this.#socket?.bufferedAmount ?? 0) > BACKLOG_BYTES;
    if (!this.#welcome || isLate || now - this.#sentAt < SPACING_MS) return;
    const t_ns = this.#now();
    const messages = this.#queue;
    let inFlight = 0;
    for (const held of this.#held.values()) if (held.stage === "requested") inFlight += held.received;
    const total = this.#received - this.#epochBytes;
    // Of a session that is new, what was received for the last does not count.
    inFlight = Math.min(inFlight, total);
    if (total !== this.#toldBytes[0] || inFlight !== this.#toldBytes[1]) {
      this.#toldBytes = [total, inFlight];
      messages.push({ type: "progress", t_ns, total_bytes: total, in_flight_bytes: inFlight });
    }
    if (this.#cameras.length > 0 && (this.#moved || now - this.#sentAt >= QUIET_MS)) {
      this.#moved = false;
      messages.push({ type: "view", t_ns, cameras: this.#cameras });
    }
    if (messages.length === 0) return;
    this.#queue = [];
    this.#sentAt = now;
    this.#send(messages);
  }

  // --- What the server says -------------------------------------------------------------------------------------------

  /** @param {any} message */
  #obey(message) {
    switch (message.type) {
      case "welcome": return this.#enter(message);
      case "fetch": return this.#fetch(message);
      case "cancel":
      case "discard":
        this.#letGo(message.rep);
        return this.#emit(message.type, message);
      case "error":
        this.#emit("error", message);
        if (message.fatal) {
          const isForGood = !this.#welcome && FOR_GOOD.includes(message.code);
          this.#close(message.message);
          if (isForGood) this.#halt();
          this.#retry();
        }
        return;
      default: return this.#emit(message.type, message);
    }
  }

  /** @param {Fetch} fetch */
  #fetch(fetch) {
    const known = this.#held.get(fetch.rep);
    if (known) {
      // It is there already: said once more.
      known.fetch = fetch;
      if (known.stage !== "requested") this.#event("arrived", fetch.rep);
      if (known.stage === "resident") this.#event("completed", fetch.rep);
      return;
    }
    this.#emit("fetch", fetch);
    if (this.#used + fetch.wire_bytes > this.#options.memoryBytes) {
      return this.#fail(fetch.rep, `${fetch.wire_bytes} bytes do not fit: ${this.#used} are in use`);
    }
    /** @type {Held} */
    const held = {
      fetch, stage: "requested", responded: false, answered: false, received: 0, bytes: null, content: undefined,
      controller: new AbortController(),
    };
    this.#held.set(fetch.rep, held);
    this.#use(fetch.wire_bytes);
    this.#transfer(held);
    // Who waits for a free connection shares the link with those that have one; the server would take the time for
    // latency, and have all the more requested.
    setTimeout(() => {
      if (held.responded || this.#held.get(fetch.rep) !== held) return;
      const waiting = [...this.#held.values()].filter(({ stage, answered }) => stage === "requested" && !answered);
      if (waiting.length > CONNECTIONS) this.#responded(held);
    }, this.#latency);
  }

  /** @param {Held} held */
  #responded(held) {
    if (held.responded) return;
    held.responded = true;
    this.#event("responded", held.fetch.rep);
  }

  /** The address of something to fetch. @param {Fetch} fetch */
  #address(fetch) {
    const base = new URL(this.#welcome?.base ?? "", this.#server);
    if (!base.pathname.endsWith("/")) base.pathname += "/";
    return new URL(fetch.uri, base);
  }

  /** @param {Held} held */
  async #transfer(held) {
    const { fetch: { rep, urgency }, controller } = held;
    /** @type {Record<string, string>} */
    const headers = { "Foresight-Session": this.#session ?? "", Priority: `u=${urgency}` };
    if (this.#options.token) headers.Authorization = `Bearer ${this.#options.token}`;
    /** @type {any} */
    const priority = urgency <= 1 ? "high" : urgency <= 3 ? "auto" : "low";
    let stalled = false;
    /** @type {any} */
    let timer;
    const alive = () => {
      clearTimeout(timer);
      timer = setTimeout(() => { stalled = true; controller.abort(); }, this.#options.stallMs);
    };
    const asked = performance.now();
    try {
      alive();
      const response = await fetch(this.#address(held.fetch), { headers, priority, signal: controller.signal });
      if (!response.ok || !response.body) throw new Error(`status ${response.status}; expected 200`);
      // The least, slowly forgotten.
      this.#latency = Math.min(performance.now() - asked, 1.02 * this.#latency);
      held.answered = true;
      this.#responded(held);
      this.#emit("responded", { rep, bytes: held.fetch.wire_bytes });
      const bytes = new Uint8Array(held.fetch.wire_bytes);
      const reader = response.body.getReader();
      for (;;) {
        alive();
        const { done, value } = await reader.read();
        if (done) break;
        if (held.received + value.length > bytes.length) {
          controller.abort();
          throw new Error(`more than ${bytes.length} bytes; expected ${bytes.length}`);
        }
        bytes.set(value, held.received);
        held.received += value.length;
        this.#received += value.length;
      }
      if (held.received < bytes.length) throw new Error(`${held.received} bytes; expected ${bytes.length}`);
      if (this.#held.get(rep) === held) this.#arrived(held, bytes);
    } catch (error) {
      if (this.#held.get(rep) !== held) return;
      this.#fail(rep, stalled ? `nothing came for ${this.#options.stallMs} ms` : String(error));
    } finally {
      clearTimeout(timer);
    }
  }

  /** The last byte came: what waited for that goes, then it is decoded. @param {Held} held @param {Uint8Array} bytes */
  #arrived(held, bytes) {
    const { rep, wire_bytes, decoded_bytes, discard_on_arrival = [] } = held.fetch;
    this.#event("arrived", rep);
    held.stage = "arrived";
    held.bytes = bytes;
    for (const doomed of discard_on_arrival) if (doomed !== rep) this.#letGo(doomed);
    this.#use(decoded_bytes);
    this.#emit("arrived", { rep, bytes: wire_bytes });
    this.#decode(held);
  }

  /** Decodes, unless what it needs first is not there yet. @param {Held} held */
  async #decode(held) {
    const { rep, after, wire_bytes } = held.fetch;
    if (after !== undefined && after !== null && this.#held.get(after)?.stage !== "resident") return;
    held.stage = "decoding";
    let content;
    try {
      content = await this.#options.decode?.(held.fetch, /** @type {Uint8Array} */ (held.bytes));
    } catch (error) {
      if (this.#held.get(rep) === held) this.#fail(rep, `decoding: ${error}`);
      return;
    }
    if (this.#held.get(rep) !== held) {
      // It was let go meanwhile, before anyone had it.
      return this.#emit("hide", { rep, content });
    }
    held.stage = "resident";
    held.content = content;
    held.bytes = null;
    this.#use(-wire_bytes);
    this.#event("completed", rep);
    this.#emit("show", { rep, content });
    for (const waiting of [...this.#held.values()]) {
      if (waiting.stage === "arrived" && waiting.fetch.after === rep) this.#decode(waiting);
    }
  }

  /** @param {number} rep @param {string} reason */
  #fail(rep, reason) {
    this.#letGo(rep);
    this.#event("failed", rep, { reason });
    this.#emit("failed", { rep, reason });
  }

  /** Frees what is held of a representation, wherever it is. @param {number} rep */
  #letGo(rep) {
    const held = this.#held.get(rep);
    if (!held) return false;
    this.#held.delete(rep);
    const { wire_bytes, decoded_bytes } = held.fetch;
    this.#use(-(held.stage === "resident" ? 0 : wire_bytes) - (held.stage === "requested" ? 0 : decoded_bytes));
    if (held.stage === "requested") held.controller.abort();
    if (held.stage === "resident") this.#emit("hide", { rep, content: held.content });
    return true;
  }

  /** @param {number} bytes */
  #use(bytes) {
    this.#used += bytes;
    this.#usedMax = Math.max(this.#usedMax, this.#used);
  }

  /** @param {string} type @param {unknown} detail */
  #emit(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

/** @param {string} text */
function base64url(text) {
  const bytes = String.fromCharCode(...new TextEncoder().encode(text));
  return btoa(bytes).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}
