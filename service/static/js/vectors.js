// 3-vectors as arrays, and columns of pose matrices.

export const add = (a, b, scale = 1) => a.map((value, i) => value + scale * b[i]);
export const minus = (a, b) => add(a, b, -1);
export const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));
export const column = (pose, i) => [pose[0][i], pose[1][i], pose[2][i]];

/** The mean up direction of cameras; that of the first if they cancel, as they do for the service. */
export function vertical(cameras) {
  const down = cameras.map((camera) => column(camera.c2w, 1)).reduce((sum, one) => add(sum, one));
  return unit((Math.hypot(...down) > 1e-2 * cameras.length ? down : column(cameras[0].c2w, 1)).map((value) => -value));
}

/** `v` rotated by `angle` (radians) about a unit axis (Rodrigues' formula). */
export function turned(v, axis, angle) {
  const cosine = Math.cos(angle), sine = Math.sin(angle);
  const across = cross(axis, v), along = dot(axis, v);
  return v.map((value, i) => value * cosine + across[i] * sine + axis[i] * along * (1 - cosine));
}
