// Plays a recorded camera path in real time before a viewer, and records what the viewer asks for.
//
// Contents live on one origin, /world/content/REP, so that a viewer's limit per server holds. The connection is taken to
// carry a number of requests at once that the case sets: over HTTP/2 the 100 streams that a server should allow at least
// (RFC 9113, 6.5.2), over HTTP/1.1 Chromium's 6. What is asked for beyond that waits in the browser, first come first
// served. This server speaks HTTP/1.1: each request goes to the least busy of 17 names of this machine, 6 connections each.

const HOSTS = 17;
let streamsMax = 6 * HOSTS;
const busy = new Array(HOSTS).fill(0);
const waiting = [];
const requests = [];
let streams = 0;
let start = performance.now();
const seconds = () => (performance.now() - start) / 1000;

function contentOf(url) {
  const found = /^\/world\/content\/(\d+)$/.exec(new URL(url, location.href).pathname);
  return found ? Number(found[1]) : null;
}

// A connection for a request that is sent now; `end` is called when it is over, and lets the next one go.
function connect(rep) {
  const host = busy.indexOf(Math.min(...busy));
  busy[host] += 1;
  let over = false;
  const end = () => {
    if (over) return;
    over = true;
    busy[host] -= 1;
    const next = waiting.shift();
    if (next) next();
    else streams -= 1;
  };
  return { url: `http://c${host}.localhost:${location.port}/world/content/${rep}`, end };
}

async function turn(signal) {
  if (streams < streamsMax) {
    streams += 1;
    return;
  }
  await new Promise((resolve, reject) => {
    waiting.push(resolve);
    signal?.addEventListener('abort', () => {
      const place = waiting.indexOf(resolve);
      if (place >= 0) waiting.splice(place, 1);
      reject(signal.reason);
    });
  });
}

const fetchAsIs = window.fetch.bind(window);
window.fetch = async (input, init) => {
  const rep = typeof input === 'string' || input instanceof URL ? contentOf(input) : null;
  if (rep === null) return fetchAsIs(input, init);
  requests.push([seconds(), rep]);
  await turn(init?.signal);
  const { url, end } = connect(rep);
  init?.signal?.addEventListener('abort', end);
  try {
    const response = await fetchAsIs(url, init);
    const whole = response.arrayBuffer.bind(response);
    response.arrayBuffer = () => whole().finally(end);
    return response;
  } catch (error) {
    end();
    throw error;
  }
};

// The viewer that uses these has at most 18 under way: none waits.
const openAsIs = XMLHttpRequest.prototype.open;
XMLHttpRequest.prototype.open = function (method, url, ...rest) {
  const rep = contentOf(url);
  if (rep === null) return openAsIs.call(this, method, url, ...rest);
  requests.push([seconds(), rep]);
  streams += 1;
  const { url: elsewhere, end } = connect(rep);
  this.addEventListener('loadend', end);
  return openAsIs.call(this, method, elsewhere, ...rest);
};

const post = (to, body) => fetchAsIs(to, { method: 'POST', body });

// `prepare(setup)` makes the viewer and answers a function that shows a frame from a view: position, then quaternion
// (x, y, z, w; the camera looks along -z, with +y up), world space.
export async function play(prepare) {
  try {
    const setup = await (await fetchAsIs('/case.json')).json();
    streamsMax = setup.streams;
    const frame = await prepare(setup);
    // A page's first animation frames come late.
    for (let i = 0; i < 30; i += 1) await new Promise(requestAnimationFrame);
    await post('/start', '');
    start = performance.now();
    let shown = -1;
    let frames = 0;
    let longest = 0;
    let last = 0;
    await new Promise((resolve, reject) => {
      const step = () => {
        try {
          const now = seconds();
          const tick = Math.floor(now * setup.rate + 1e-6);
          if (tick >= setup.views.length) return resolve();
          if (tick > shown) {
            shown = tick;
            frames += 1;
            longest = Math.max(longest, now - last);
            last = now;
            frame(setup.views[tick]);
          }
          setTimeout(step, Math.max(0, ((shown + 1) / setup.rate - seconds()) * 1000));
        } catch (error) {
          reject(error);
        }
      };
      step();
    });
    await post('/result', JSON.stringify({ requests, frames, seconds: seconds(), longest_frame: longest }));
  } catch (error) {
    await post('/failure', String(error?.stack ?? error));
  }
}

window.addEventListener('error', (event) => post('/failure', event.message));
window.addEventListener('unhandledrejection', (event) => post('/failure', String(event.reason?.stack ?? event.reason)));
