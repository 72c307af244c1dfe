// @ts-check
/** The map and the timeline of the page. Colours are the page's own, so that they follow light and dark. */

/** @param {string} name */
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** A context in CSS pixels, cleared. @param {HTMLCanvasElement} canvas */
function clean(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const scale = globalThis.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
  if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/**
 * The world from above: its bounds, where the camera has been, what it sees, and where it was when something was fetched.
 * @param {HTMLCanvasElement} canvas
 * @param {import("./camera.js").FlyCamera} camera
 * @param {{ trail: number[][], fetched: { at: number[], share: number | undefined }[] }} seen
 */
export function drawMap(canvas, camera, { trail, fetched }) {
  const { context, width, height } = clean(canvas);
  const [east, north] = camera.extent;
  const scale = 0.42 * Math.min(width / Math.max(east, 1e-9), height / Math.max(north, 1e-9));
  const at = (/** @type {number[]} */ [x, y]) => /** @type {const} */ ([width / 2 + x * scale, height / 2 - y * scale]);
  context.strokeStyle = colour("line");
  context.strokeRect(...at([-east, north]), 2 * east * scale, 2 * north * scale);
  for (const { at: place, share } of fetched) {
    context.fillStyle = colour(share === undefined ? "quiet" : share >= 0.5 ? "predicted" : "worst");
    const [x, y] = at(place);
    context.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  context.strokeStyle = colour("quiet");
  context.beginPath();
  trail.forEach((place, i) => (i ? context.lineTo(...at(place)) : context.moveTo(...at(place))));
  context.stroke();
  const here = at(camera.onMap(camera.position));
  const half = 0.5 * camera.fov * 1.6;
  const towards = (/** @type {number} */ aside, /** @type {number} */ px) =>
    /** @type {const} */ ([
      here[0] + px * Math.sin(camera.yaw + aside),
      here[1] - px * Math.cos(camera.yaw + aside),
    ]);
  context.fillStyle = colour("sight");
  context.beginPath();
  context.moveTo(...here);
  context.lineTo(...towards(-half, 60));
  context.lineTo(...towards(half, 60));
  context.fill();
  context.fillStyle = colour("text");
  context.beginPath();
  context.arc(...here, 3, 0, 7);
  context.fill();
}

/**
 * The last minute: bytes received as bars against the largest, quality as a line from 0 to 1.
 * @param {HTMLCanvasElement} canvas
 * @param {{ bytes: number, quality: number | null }[]} samples two a second, the latest last
 */
export function drawTimeline(canvas, samples) {
  const { context, width, height } = clean(canvas);
  const step = width / 120;
  const most = Math.max(1, ...samples.map(({ bytes }) => bytes));
  const left = width - samples.length * step;
  context.fillStyle = colour("bytes");
  samples.forEach(({ bytes }, i) => {
    const tall = (0.9 * height * bytes) / most;
    context.fillRect(left + i * step, height - tall, Math.max(1, step - 1), tall);
  });
  context.strokeStyle = colour("predicted");
  context.lineWidth = 2;
  context.beginPath();
  let isDrawn = false;
  samples.forEach(({ quality }, i) => {
    if (quality === null) return;
    const [x, y] = [left + (i + 0.5) * step, height - 2 - (height - 4) * quality];
    if (isDrawn) context.lineTo(x, y);
    else context.moveTo(x, y);
    isDrawn = true;
  });
  context.stroke();
  context.lineWidth = 1;
}
