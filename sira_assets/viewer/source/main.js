// Starts every viewer of the page: decodes what the page carries, joins the controls to the view.
import { HeadView } from "./head.js";

const CAPTIONS = {
  final: "the exported file under the light found in the photo",
  diffuse: "diffuse albedo, the light taken away",
  specular: "reflectance head-on, white is F0 = 0.08",
  normals: "x right, y up, z towards the camera",
  light: "the light alone on the surface, its brightest white",
};
const SMOOTH_MS = 40;
const STEP = 5 * Math.PI / 180;

async function unpacked(node) {
  const text = node.textContent.trim(), bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  node.textContent = "";
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

function hasWebgl() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}

async function start(box) {
  const part = (name) => box.querySelector(`[data-part="${name}"]`);
  const say = (text) => {
    part("status").textContent = text;
    part("status").hidden = !text;
  };
  const give_up = (text) => {
    box.classList.add("still");
    say(text);
  };
  if (!hasWebgl()) return give_up("No 3D view: this browser shows no WebGL 2. The pictures on this page show the same avatar.");
  if (!("DecompressionStream" in window)) return give_up("No 3D view: this browser is older than 2023. The pictures on this page show the same avatar.");

  const form = JSON.parse(part("form").textContent);
  const packed = form.shadows ? new Uint8Array(await unpacked(part("shadows-data"))) : null;
  const canvas = part("canvas"), view = await HeadView.on(canvas, form, await unpacked(part("glb")), packed);
  const { orbit } = view;

  // A slow machine draws fewer pixels while something moves, and all of them when it rests.
  let waiting = true, coarse = 1, resting = 0;
  const resize = (share) => {
    const scale = share * Math.min(window.devicePixelRatio || 1, 2);
    view.resize(Math.max(1, Math.round(canvas.clientWidth * scale)), Math.max(1, Math.round(canvas.clientHeight * scale)));
  };
  const place = () => {
    const there = orbit.atPhoto;
    box.classList.toggle("away", !there);
    part("cut").disabled = !there;
    part("reset").disabled = there;
  };
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      if (coarse < 1) {
        resize(coarse);
        clearTimeout(resting);
        resting = setTimeout(fit, 250);
      }
      view.draw();
      place();
    });
  };
  const fit = () => {
    resize(1);
    view.draw();
  };

  // Light, exposure, maps.
  let relighting = false;
  const relight = () => {
    part("azimuth-value").textContent = `${part("azimuth").value}°`;
    if (relighting) return;
    relighting = true;
    requestAnimationFrame(() => {
      relighting = false;
      view.azimuth = Number(part("azimuth").value) * Math.PI / 180;
      view.shaded = view.canShade && part("shadows").checked;
      view.light();
      redraw();
    });
  };
  const expose = () => {
    const stops = Number(part("exposure").value);
    part("exposure-value").textContent = `${stops > 0 ? "+" : stops < 0 ? "−" : ""}${Math.abs(stops).toFixed(1)} EV`;
    view.expose(stops);
    redraw();
  };
  part("azimuth").addEventListener("input", relight);
  part("exposure").addEventListener("input", expose);
  if (view.canShade) part("shadows").addEventListener("change", relight);
  else part("shadows").closest("label").hidden = true;
  const shown = () => box.querySelector("input[data-map]:checked").value;
  const choose = () => {
    view.show(shown());
    part("caption").textContent = CAPTIONS[shown()];
    const lit = shown() === "final" || shown() === "light";
    part("lighting").classList.toggle("idle", !lit);
    redraw();
  };
  box.querySelectorAll("input[data-map]").forEach((radio) => radio.addEventListener("change", choose));

  // The photo.
  const photo = document.getElementById(part("photo").dataset.from);
  if (photo && !part("photo").hidden) {
    part("photo").src = photo.src;
    const cut = () => box.style.setProperty("--cut", `${part("cut").value}%`);
    part("cut").addEventListener("input", cut);
    cut();
  }

  // Where it is seen from.
  const reset = () => {
    orbit.reset();
    redraw();
  };
  part("reset").addEventListener("click", () => {
    reset();
    canvas.focus({ preventScroll: true });
  });
  part("fill").addEventListener("click", () => { orbit.frame(); redraw(); });
  part("nearer").addEventListener("click", () => { orbit.zoom(1.2); redraw(); });
  part("farther").addEventListener("click", () => { orbit.zoom(1 / 1.2); redraw(); });
  part("relight-reset").addEventListener("click", () => {
    part("azimuth").value = 0;
    part("exposure").value = 0;
    relight();
    expose();
  });
  part("save").addEventListener("click", () => {
    const link = document.createElement("a");
    link.href = view.snapshot(form.camera.width, form.camera.height);
    link.download = `${form.name}_${shown()}.png`;
    link.click();
  });
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const before = fingers.size > 1 ? spread() : null;
    const dx = event.clientX - last.x, dy = event.clientY - last.y;
    last.x = event.clientX;
    last.y = event.clientY;
    const height = canvas.clientHeight;
    if (before) {
      const now = spread();
      if (before.apart > 0 && now.apart > 0) orbit.zoom(now.apart / before.apart);
      orbit.pan((now.x - before.x) / height, (before.y - now.y) / height);
    } else if (event.buttons & 6 || event.shiftKey) {
      orbit.pan(dx / height, -dy / height);
    } else {
      orbit.orbit(-4 * dx / height, 4 * dy / height);
    }
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    // The page scrolls on, unless the view was chosen by a click or the keyboard.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    orbit.zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)));
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const slide = event.shiftKey, keys = {
      ArrowLeft: () => (slide ? orbit.pan(-0.03, 0) : orbit.orbit(-STEP, 0)),
      ArrowRight: () => (slide ? orbit.pan(0.03, 0) : orbit.orbit(STEP, 0)),
      ArrowUp: () => (slide ? orbit.pan(0, 0.03) : orbit.orbit(0, STEP)),
      ArrowDown: () => (slide ? orbit.pan(0, -0.03) : orbit.orbit(0, -STEP)),
      "+": () => orbit.zoom(1.15), "=": () => orbit.zoom(1.15), "-": () => orbit.zoom(1 / 1.15),
      Home: reset, 0: reset,
    };
    if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
    redraw();
  });

  box.view = view;
  choose();
  expose();
  // The first picture is small: it takes as long as the shader takes to compile.
  view.resize(16, 16);
  await view.time();
  resize(1);
  coarse = Math.min(1, Math.max(0.25, Math.sqrt(SMOOTH_MS / (await view.time()))));
  let seen = canvas.clientWidth;
  new ResizeObserver(() => {
    if (canvas.clientWidth !== seen) fit();
    seen = canvas.clientWidth;
  }).observe(canvas);
  waiting = false;
  place();
  say("");
  box.classList.add("ready");
}

for (const box of document.querySelectorAll(".viewer")) {
  start(box).catch((error) => {
    box.classList.add("still");
    const status = box.querySelector('[data-part="status"]');
    status.hidden = false;
    status.textContent = `No 3D view: ${error.message}. The pictures on this page show the same avatar.`;
    console.error(error);
  });
}
