// Pointer, wheel and keyboard input as degrees of orbit and a zoom factor.

const DEGREES_PER_PX = 0.3; // a drag over 300 px turns by a quarter
const PER_NOTCH = 0.001;    // of the wheel, in the exponent
const KEYS = {
  ArrowLeft: [-3, 0, 1], ArrowRight: [3, 0, 1], ArrowUp: [0, 3, 1], ArrowDown: [0, -3, 1], "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1],
};

const distance = ([a, b]) => Math.hypot(a.x - b.x, a.y - b.y);

/** Call `move(right, up, factor)` for input on `stage`: one pointer orbits, two zoom; it returns whether it moved. */
export function turnBy(stage, move) {
  const pointers = new Map(); // id -> its last place

  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    stage.classList.add("dragging");
  });
  stage.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const before = pointers.size === 2 ? distance([...pointers.values()]) : 0;
    const [x, y] = [event.clientX - last.x, event.clientY - last.y];
    if (!x && !y) return;
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (pointers.size === 1) move(-x * DEGREES_PER_PX, y * DEGREES_PER_PX, 1);
    else if (before > 0) move(0, 0, distance([...pointers.values()]) / before);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    stage.addEventListener(name, (event) => {
      pointers.delete(event.pointerId);
      stage.classList.toggle("dragging", pointers.size > 0);
    });
  }
  stage.addEventListener("wheel", (event) => {
    if (event.ctrlKey) return; // the browser's, which enlarges the page, also by a pinch on a trackpad
    if (move(0, 0, Math.exp(-event.deltaY * PER_NOTCH))) event.preventDefault();
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    const step = event.ctrlKey || event.metaKey || event.altKey ? null : KEYS[event.key]; // those are the browser's
    if (step && move(...step)) event.preventDefault();
  });
}
