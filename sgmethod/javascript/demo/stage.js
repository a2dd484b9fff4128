// A canvas on which an .sg file is drawn at any size: what is seen, in the canvas's own pixels, by a worker.

const [STEP, MOVE, MOST] = [1.25, 0.1, 32]; // of a key: zoom, part of the window; pixels of the screen for one at most

export function newStage(drawer, element, canvas) {
  const context = canvas.getContext("2d");
  const pointers = new Map();
  let bytes = null;
  let size = null; // of the picture
  let scale = 1; // pixels of the canvas for one of the picture
  let centre = [0, 0]; // in the picture
  let isFitted = true;
  let drawn = null; // { canvas, region }: the last view
  let photograph = null;
  let isCompared = false;
  let [isBusy, isStale] = [false, false];
  let asked = 0; // files to show, so far

  const least = () => Math.min(canvas.width / size.width, canvas.height / size.height);

  /** What is seen: a part of the picture, in whole pixels. */
  function region() {
    const ends = ["width", "height"].map((side, i) => {
      const half = canvas[side] / scale / 2;
      return [Math.max(Math.floor(centre[i] - half), 0), Math.min(Math.ceil(centre[i] + half), size[side])];
    });
    return [ends[0][0], ends[1][0], ends[0][1] - ends[0][0], ends[1][1] - ends[1][0]];
  }

  const placeOf = ([x, y, width, height]) => [
    canvas.width / 2 + (x - centre[0]) * scale,
    canvas.height / 2 + (y - centre[1]) * scale,
    width * scale,
    height * scale,
  ];

  function paint() {
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (isCompared && photograph) context.drawImage(photograph, ...placeOf([0, 0, size.width, size.height]));
    else if (drawn) context.drawImage(drawn.canvas, ...placeOf(drawn.region));
  }

  /** Draw what is seen as sharp as it gets; meanwhile the last view stands for it. */
  async function refresh() {
    if (!size) return;
    paint();
    if (isBusy) {
      isStale = true;
      return;
    }
    isBusy = true;
    try {
      const seen = region();
      const file = bytes;
      const { data, width, height } = await drawer.ask("view", { file, region: seen, scale });
      if (file === bytes) {
        const view = new OffscreenCanvas(width, height);
        view.getContext("2d").putImageData(new ImageData(data, width, height), 0, 0);
        drawn = { canvas: view, region: seen };
      }
      paint();
    } finally {
      isBusy = false;
      if (isStale) {
        isStale = false;
        await refresh();
      }
    }
  }

  function place() {
    scale = Math.min(Math.max(scale, least()), MOST);
    isFitted = scale <= least() * 1.001;
    ["width", "height"].forEach((side, i) => {
      const half = canvas[side] / scale / 2;
      const middle = size[side] / 2;
      centre[i] = half >= middle ? middle : Math.min(Math.max(centre[i], half), size[side] - half);
    });
    element.classList.toggle("fitted", isFitted);
    return refresh();
  }

  function zoom(factor, [x, y] = [canvas.width / 2, canvas.height / 2]) {
    if (!size) return;
    const offset = [x - canvas.width / 2, y - canvas.height / 2];
    const next = Math.min(Math.max(scale * factor, least()), MOST);
    centre = centre.map((value, i) => value + offset[i] / scale - offset[i] / next);
    scale = next;
    place();
  }

  function move(x, y) {
    if (!size) return;
    centre = [centre[0] + x / scale, centre[1] + y / scale];
    place();
  }

  function fit() {
    if (!size) return undefined;
    scale = least();
    return place();
  }

  const at = ({ clientX, clientY }) => {
    const { left, top, width } = canvas.getBoundingClientRect();
    return [(clientX - left) * (canvas.width / width), (clientY - top) * (canvas.width / width)];
  };

  new ResizeObserver(() => {
    if (!element.clientWidth) return; // the page is being left
    const ratio = Math.min(devicePixelRatio, 2);
    [canvas.width, canvas.height] = [element.clientWidth, element.clientHeight].map((side) => Math.round(side * ratio));
    if (size) (isFitted ? fit : place)();
  }).observe(element);

  element.addEventListener("wheel", (event) => {
    if (isFitted && event.deltaY > 0 && !event.ctrlKey) return; // the page scrolls on
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), at(event));
  });
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    element.classList.add("moving");
  });
  element.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = at(event);
    pointers.set(event.pointerId, now);
    const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    if (!other) return move(before[0] - now[0], before[1] - now[1]);
    const distance = ([x, y]) => Math.max(Math.hypot(x - other[0], y - other[1]), 1);
    zoom(distance(now) / distance(before), other);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    element.addEventListener(kind, ({ pointerId }) => {
      pointers.delete(pointerId);
      if (!pointers.size) element.classList.remove("moving");
    });
  }
  element.addEventListener("keydown", (event) => {
    const step = MOVE * canvas.width;
    const keys = {
      "+": () => zoom(STEP),
      "=": () => zoom(STEP),
      "-": () => zoom(1 / STEP),
      0: fit,
      ArrowLeft: () => move(-step, 0),
      ArrowRight: () => move(step, 0),
      ArrowUp: () => move(0, -step),
      ArrowDown: () => move(0, step),
    };
    const act = !event.ctrlKey && !event.metaKey && !event.altKey && keys[event.key];
    if (!act || (isFitted && event.key.startsWith("Arrow"))) return;
    event.preventDefault();
    act();
  });

  return {
    fit,
    zoom,
    /** Show a file. Promises that it is drawn; fails if it cannot be decoded. */
    async show(file) {
      const mine = ++asked;
      const check = () => {
        if (mine !== asked) throw Object.assign(new Error("not needed any more"), { isStale: true });
      };
      const found = await drawer.ask("info", { file });
      check();
      const isOther = !size || Math.abs(found.width / found.height - size.width / size.height) > 0.01;
      [bytes, drawn] = [file, isOther ? null : drawn];
      if (drawn) drawn.region = drawn.region.map((value) => value * (found.width / size.width));
      const grown = size ? found.width / size.width : 1;
      size = found;
      centre = centre.map((value) => value * grown);
      scale /= grown;
      await (isOther || isFitted ? fit() : place());
      check();
    },
    /** The photograph that the file shows; null if there is none. */
    setPhotograph(img) {
      photograph = img;
      bytes = drawn = size = null;
      asked++;
      isFitted = true;
      context.clearRect(0, 0, canvas.width, canvas.height);
    },
    compare(isOn) {
      isCompared = isOn;
      if (size) paint();
    },
  };
}
