// @ts-check
/**
 * A camera that flies: by the keyboard, or by itself over the world from edge to edge.
 *
 * @typedef {[number, number, number]} Vector
 */

/** @type {(a: Vector, b: Vector) => number} */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vector, b: Vector) => Vector} */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** Σ of vectors times numbers. @type {(...terms: [Vector, number][]) => Vector} */
const sum = (...terms) => {
  /** @type {Vector} */
  const out = [0, 0, 0];
  for (const [v, s] of terms) for (let i = 0; i < 3; i += 1) out[i] += v[i] * s;
  return out;
};
/** @type {(v: Vector) => Vector} */
const unit = (v) => sum([v, 1 / Math.sqrt(dot(v, v))]);

/** The unit quaternion x, y, z, w that turns camera space (right, up, back) into these directions.
 * @type {(right: Vector, up: Vector, back: Vector) => [number, number, number, number]} */
function quaternion([a, b, c], [d, e, f], [g, h, i]) {
  // The largest of the four is taken from the diagonal, the others from it.
  const squares = [1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i];
  const largest = squares.indexOf(Math.max(...squares));
  const s = 2 * Math.sqrt(squares[largest]);
  const [yz, zx, xy] = [f - h, g - c, b - d];
  const [YZ, ZX, XY] = [f + h, g + c, b + d];
  const of = [
    [s / 4, XY / s, ZX / s, yz / s],
    [XY / s, s / 4, YZ / s, zx / s],
    [ZX / s, YZ / s, s / 4, xy / s],
    [yz / s, zx / s, xy / s, s / 4],
  ][largest];
  const length = Math.hypot(...of);
  return /** @type {any} */ (of.map((x) => x / length));
}

export class FlyCamera {
  /** @type {Set<string>} */
  keys = new Set();

  /** @param {[Vector, Vector]} bounds corners of the world @param {Vector} up away from its ground */
  constructor([least, greatest], up) {
    this.up = unit(up);
    this.centre = sum([least, 0.5], [greatest, 0.5]);
    const aside = /** @type {Vector} */ (Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
    this.north = unit(cross(this.up, aside));
    this.east = cross(this.north, this.up);
    // Half the world's extent along a direction, by its corners.
    const half = sum([greatest, 0.5], [least, -0.5]);
    const along = (/** @type {Vector} */ v) => v.reduce((all, x, i) => all + Math.abs(x * half[i]), 0);
    this.extent = [along(this.east), along(this.north), along(this.up)];
    this.reach = Math.max(1e-3, Math.min(this.extent[0], this.extent[1]));
    this.fov = 1;
    /** Metres per second. */
    this.speed = this.reach / 15;
    this.place(-0.9, 0);
  }

  /** Puts it over the middle line, `along` of the way from the centre to the north edge, and lets it look that way.
   * @param {number} along @param {number} yaw radians to the east */
  place(along, yaw) {
    const height = this.extent[2] + 0.1 * this.reach;
    this.position = sum([this.centre, 1], [this.north, along * this.extent[1]], [this.up, height]);
    this.yaw = yaw;
    this.pitch = -0.35;
  }

  /** Flies by itself: to the north edge and back within `period` seconds, looking left and right.
   * @param {number} seconds @param {number} period */
  glide(seconds, period) {
    const phase = (seconds / period) * 2 * Math.PI;
    this.place(-0.9 * Math.cos(phase), 0.6 * Math.sin(3 * phase) + (Math.sin(phase) < 0 ? Math.PI : 0));
  }

  /** Moves by the keys that are held down. @param {number} seconds since the last step */
  step(seconds) {
    const has = (/** @type {string[]} */ ...keys) => (keys.some((key) => this.keys.has(key)) ? 1 : 0);
    const turn = 1.2 * seconds;
    this.yaw += turn * (has("ArrowRight") - has("ArrowLeft"));
    this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + turn * (has("ArrowUp") - has("ArrowDown"))));
    const metres = this.speed * seconds * (has("ShiftLeft", "ShiftRight") ? 4 : 1);
    const { ahead, right } = this.axes();
    this.position = sum(
      [this.position, 1],
      [ahead, metres * (has("KeyW") - has("KeyS"))],
      [right, metres * (has("KeyD") - has("KeyA"))],
      [this.up, metres * (has("KeyE") - has("KeyQ"))],
    );
  }

  /** Directions of the camera in the world. */
  axes() {
    const level = sum([this.north, Math.cos(this.yaw)], [this.east, Math.sin(this.yaw)]);
    const right = sum([this.east, Math.cos(this.yaw)], [this.north, -Math.sin(this.yaw)]);
    const ahead = sum([level, Math.cos(this.pitch)], [this.up, Math.sin(this.pitch)]);
    return { ahead, right, level };
  }

  /** As a message has it. @param {number} width @param {number} height pixels */
  view(width, height) {
    const { ahead, right } = this.axes();
    const orientation = quaternion(right, cross(right, ahead), sum([ahead, -1]));
    return { position: this.position, orientation, fov_y: this.fov, viewport: /** @type {any} */ ([width, height]) };
  }

  /** Metres east and north of the centre. @param {Vector} point */
  onMap(point) {
    const from = sum([point, 1], [this.centre, -1]);
    return [dot(from, this.east), dot(from, this.north)];
  }
}
