// The camera of the view drawn by the service: an input camera that orbits the scene's pivot and zooms.

import { add, column, dot, turned, vertical } from "./vectors.js";

const MOST_UP = (80 * Math.PI) / 180; // closer to the vertical left and right would swap

/** Azimuth, elevation and zoom relative to an input camera, of index `view`. */
export class Orbit {
  constructor(cameras, near, far) {
    this.cameras = cameras;
    this.pivotDepth = Math.sqrt(near * far);
    this.up = vertical(cameras);
    this.reset(0);
  }

  reset(view) {
    this.view = view;
    this.azimuth = 0;
    this.elevation = 0;
    this.zoom = 1;
  }

  get moved() {
    return this.azimuth !== 0 || this.elevation !== 0 || this.zoom !== 1;
  }

  /** Orbit by degrees to the right and upwards; a `factor` above 1 zooms in. */
  move(right, up, factor = 1) {
    const radians = Math.PI / 180;
    this.azimuth = ((this.azimuth + right + 540) % 360) - 180;
    const above = Math.asin(Math.max(-1, Math.min(1, -dot(column(this.cameras[this.view].c2w, 2), this.up))));
    const wanted = Math.max(-MOST_UP, Math.min(MOST_UP, above + (this.elevation + up) * radians));
    this.elevation = (wanted - above) / radians;
    this.zoom = Math.max(0.2, Math.min(5, this.zoom * factor));
  }

  /** The camera, as `GET /render` reads it. */
  camera() {
    const { c2w, ...lens } = this.cameras[this.view];
    const radians = Math.PI / 180;
    const [right, down, ahead] = [0, 1, 2].map((i) => column(c2w, i));
    const pivot = add(column(c2w, 3), ahead, this.pivotDepth);
    const turn = (v) => turned(turned(v, right, -this.elevation * radians), this.up, this.azimuth * radians);
    const axes = [right, down, ahead].map(turn);
    const centre = add(pivot, axes[2], -this.pivotDepth / this.zoom);
    return { ...lens, c2w: [0, 1, 2].map((i) => [axes[0][i], axes[1][i], axes[2][i], centre[i]]).concat([[0, 0, 0, 1]]) };
  }
}
