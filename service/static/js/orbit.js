// The camera of the view that the service draws: an input's camera, turned about the scene's pivot and moved along its axis.

import { add, column, dot, turned, vertical } from "./vectors.js";

const MOST_UP = (80 * Math.PI) / 180; // nearer to the vertical right and left would change places

/** A scene's cameras and pivot, and where the looker is; `view` is an input's index. */
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

  /** Degrees to the right and upwards; `factor` above 1 comes nearer. */
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
