// A top view of the cameras and their frusta between near and far.

import { colourOf, digits, make } from "./dom.js";
import { add, column, cross, dot, minus, unit, vertical } from "./vectors.js";

const SIZE = 240;
const LETTER = 12; // px, font size of the numbers
const BESIDE = [[6, 12], [6, -4], [-6, 12], [-6, -4], [6, 24], [6, -16], [-6, 24], [-6, -16]]; // positions of a number relative to its camera

/** Two horizontal axes: to the right, and ahead of the first camera. */
function ground(cameras) {
  const up = vertical(cameras);
  const first = column(cameras[0].c2w, 2);
  const level = add(first, up, -dot(first, up));
  const ahead = unit(Math.hypot(...level) > 1e-6 ? level : column(cameras[0].c2w, 0));
  return { right: cross(ahead, up), ahead };
}

/** An SVG of the frusta between near and far, from above; the first camera looks upwards. */
export function plan(cameras, near, far) {
  const { right, ahead } = ground(cameras);
  const origin = column(cameras[0].c2w, 3);
  const place = (point) => [dot(minus(point, origin), right), dot(minus(point, origin), ahead)];
  const shapes = cameras.map((camera) => {
    const centre = column(camera.c2w, 3);
    const ray = (u) => {
      const x = (u - camera.cx) / camera.fx;
      return add(column(camera.c2w, 2), column(camera.c2w, 0), x);
    };
    const at = (u, depth) => place(add(centre, ray(u), depth));
    const shown = Math.min(far, 6 * near);
    return { centre: place(centre), corners: [at(0, near), at(0, shown), at(camera.width, shown), at(camera.width, near)] };
  });
  const points = shapes.flatMap((shape) => [shape.centre, ...shape.corners]);
  const [low, high] = [Math.min, Math.max].map((end) => [0, 1].map((i) => end(...points.map((point) => point[i]))));
  const scale = (SIZE - 24) / Math.max(high[0] - low[0], high[1] - low[1], 1e-30);
  const pixel = ([x, y]) => [
    SIZE / 2 + (x - (low[0] + high[0]) / 2) * scale,
    SIZE / 2 - (y - (low[1] + high[1]) / 2) * scale,
  ];
  const path = (list) => list.map((point) => pixel(point).map((value) => value.toFixed(1)).join(",")).join(" ");
  const label = `Plan of ${cameras.length} cameras from above, with what they see between depths ${digits(near)} and ${digits(far)}`;
  const svg = make("svg:svg", { viewBox: `0 0 ${SIZE} ${SIZE}`, role: "img", "aria-label": label, class: "plan" });
  const numbers = []; // placed so far
  shapes.forEach((shape, index) => {
    const colour = colourOf(index);
    const [x, y] = pixel(shape.centre);
    svg.append(
      make("svg:polygon", { points: path(shape.corners), fill: colour, "fill-opacity": 0.15, stroke: colour }),
      make("svg:polyline", { points: path([shape.corners[0], shape.centre, shape.corners[3]]), fill: "none", stroke: colour }),
      make("svg:circle", { cx: x, cy: y, r: 4, fill: colour }),
    );
    numbers.push(free(x, y, String(index), numbers));
  });
  numbers.forEach(({ left, base, text }) => svg.append(make("svg:text", { x: left, y: base, fill: "currentColor", "font-size": LETTER }, text)));
  return svg;
}

/** The first position beside a camera that overlaps no other number, else the first of all. */
function free(x, y, text, others) {
  const wide = 0.65 * LETTER * text.length;
  const places = BESIDE.map(([right, down]) => ({ left: right > 0 ? x + right : x + right - wide, base: y + down, wide, text }));
  const taken = (one) => others.some((other) => Math.abs(one.base - other.base) < LETTER && one.left < other.left + other.wide && other.left < one.left + one.wide);
  return places.find((one) => !taken(one)) ?? places[0];
}
