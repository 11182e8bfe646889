"use strict";
// The scene in three dimensions: turned by pointer or arrow keys, its parts switched on and off.
(() => {
  const page = window.twinPage, model = page.scene;
  const canvas = document.getElementById("scene-3d");
  if (!canvas || !model) return;
  const note = document.getElementById("scene-3d-note");
  const style = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
  } catch (error) {
    note.textContent = "This browser shows no WebGL: the plan view has the same content.";
    canvas.hidden = true;
    return;
  }
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const colourOf = (level) => new THREE.Color(page.colourOf(level));
  const world = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(45, 1, 0.05, 20 * model.far + 100);
  camera.up.set(0, 0, 1);
  const sky = new THREE.AmbientLight(0xffffff, 1.3), sun = new THREE.DirectionalLight(0xffffff, 2.0);
  sun.position.set(-2, 1.5, 4);
  world.add(sky, sun);
  const groups = {};
  const group = (name, hidden) => {
    groups[name] = new THREE.Group();
    groups[name].visible = !hidden;
    world.add(groups[name]);
    return groups[name];
  };
  const lines = (points, colour, opacity = 1) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
    const material = new THREE.LineBasicMaterial({ color: colour, transparent: opacity < 1, opacity });
    return new THREE.LineSegments(geometry, material);
  };
  const LABEL_PX = 18, sprites = [];
  const label = (text, at, colour) => {
    const face = document.createElement("canvas"), size = 44;
    let c = face.getContext("2d");
    c.font = `600 ${size}px system-ui, sans-serif`;
    face.width = Math.ceil(c.measureText(text).width) + 20;
    face.height = size + 20;
    c = face.getContext("2d");
    c.font = `600 ${size}px system-ui, sans-serif`;
    c.textBaseline = "middle";
    c.lineWidth = 10;
    c.lineJoin = "round";
    c.strokeStyle = "rgba(0,0,0,.8)";
    c.strokeText(text, 10, face.height / 2);
    c.fillStyle = colour;
    c.fillText(text, 10, face.height / 2);
    const sprite = new THREE.Sprite(
      new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(face), depthTest: false, sizeAttenuation: false }));
    sprite.userData.aspect = face.width / face.height;
    sprite.position.set(at[0], at[1], at[2]);
    sprites.push(sprite);
    return sprite;
  };
  // Texts of the same height on every screen, where they do not cover each other.
  const place_labels = () => {
    const { clientWidth: w, clientHeight: h } = canvas;
    const scale = (2 * LABEL_PX * Math.tan((camera.fov * Math.PI) / 360)) / h;
    camera.updateMatrixWorld();
    const labels = [], marks = [];
    for (const sprite of sprites) {
      const at = sprite.position.clone().project(camera);
      sprite.visible = false;
      if (!sprite.parent.visible || Math.abs(at.z) > 1) continue;
      const x = ((at.x + 1) / 2) * w, y = ((1 - at.y) / 2) * h;
      labels.push({ sprite, x, y, width: LABEL_PX * sprite.userData.aspect });
      marks.push([x, y]);
    }
    const box = { l: 0, r: w, t: 0, b: h };
    for (const { sprite, x, y, width, left, middle } of window.placedLabels(labels, marks, box, 30)) {
      sprite.visible = true;
      sprite.scale.set(scale * sprite.userData.aspect, scale, 1);
      sprite.center.set((x - left) / width, (middle - y) / LABEL_PX + 0.5);
    }
  };

  const solids = group("objects");
  for (const item of model.objects) {
    const steps = new Uint16Array(bytes(item.vertices)), places = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++)
      places[i] = item.low[i % 3] + (steps[i] / 65535) * item.span[i % 3];
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
    const faces = bytes(item.faces);
    geometry.setIndex(new THREE.BufferAttribute(item.wide ? new Uint32Array(faces) : new Uint16Array(faces), 1));
    const grey = Math.sqrt(Math.max(0.02, item.reflectance));
    const material = new THREE.MeshLambertMaterial({
      color: new THREE.Color(0.95 * grey, grey, 1.05 * grey), flatShading: true, side: THREE.DoubleSide,
    });
    solids.add(new THREE.Mesh(geometry, material));
  }

  const rig = group("rig"), p = model.rig.position;
  for (let k = 0; k < 3; k++) {
    const a = model.rig.axes.slice(3 * k, 3 * k + 3);
    rig.add(lines([...p, p[0] + 0.8 * a[0], p[1] + 0.8 * a[1], p[2] + 0.8 * a[2]],
      [0xd55e00, 0x009e73, 0x0072b2][k]));
  }
  rig.add(label("rig", p, "#fff"));

  if (model.camera) {
    const corner = (i) => model.camera.slice(3 * i, 3 * i + 3), edges = [];
    for (let i = 1; i <= 4; i++) edges.push(...corner(0), ...corner(i), ...corner(i), ...corner((i % 4) + 1));
    group("camera").add(lines(edges, 0x56b4e9));
  }
  if (model.beam) {
    const { apex, rim, far } = model.beam, n = rim.length / 3, edges = [];
    const at = (i, r) => [0, 1, 2].map((k) => apex[k] + r * rim[3 * (i % n) + k]);
    for (let i = 0; i < n; i++) {
      edges.push(...at(i, far), ...at(i + 1, far));
      if (i % 6 === 0) edges.push(...apex, ...at(i, far));
    }
    group("beam").add(lines(edges, 0x2fbf8f));
    const shells = group("shells", true);
    for (const shell of model.shells || []) {
      const ring = [];
      for (let i = 0; i < n; i++) ring.push(...at(i, shell.range), ...at(i + 1, shell.range));
      shells.add(lines(ring, colourOf(shell.level), 0.9));
    }
  }
  const targets = group("targets");
  for (const target of model.targets) {
    const [x, y, z] = target.position, s = 0.18, v = target.velocity;
    targets.add(lines([x - s, y, z, x + s, y, z, x, y - s, z, x, y + s, z, x, y, z - s, x, y, z + s,
      x, y, z, x + v[0], y + v[1], z + v[2]], 0xff8a3d));
    targets.add(label(target.name, target.position, "#ffb27a"));
  }
  if (model.detections.length) {
    const found = group("detections"), geometry = new THREE.BufferGeometry();
    const places = model.detections.flatMap((d) => d.position);
    const colours = model.detections.flatMap((d) => { const c = colourOf(d.level); return [c.r, c.g, c.b]; });
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(colours), 3));
    found.add(new THREE.Points(geometry, new THREE.PointsMaterial({
      size: 9, sizeAttenuation: false, vertexColors: true, depthTest: false })));
  }

  const forward = model.rig.axes.slice(0, 3), left = model.rig.axes.slice(3, 6);
  const focus = (k) => model.targets.length
    ? model.targets.reduce((sum, t) => sum + t.position[k], 0) / model.targets.length
    : p[k] + 0.5 * model.far * forward[k];
  const middle = [0, 1, 2].map(focus);
  const look_at = middle.map((v, k) => 0.72 * v + 0.28 * p[k]);
  const near = 0.62 * Math.max(1, Math.hypot(...middle.map((v, k) => v - p[k])));
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.enableZoom = false; // the page scrolls, until the view has the focus
  canvas.addEventListener("focus", () => { controls.enableZoom = true; });
  canvas.addEventListener("blur", () => { controls.enableZoom = false; });
  canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
  const draw = () => { place_labels(); renderer.render(world, camera); };
  controls.addEventListener("change", draw);
  const places = {
    reset: [0, 1, 2].map((k) => p[k] - 0.5 * near * forward[k] + 0.8 * near * left[k] + (k === 2 ? 0.9 * near : 0)),
    top: [middle[0] - 1e-3 * forward[0], middle[1] - 1e-3 * forward[1], middle[2] + 3 * near],
    rig: [p[0] - 0.01 * forward[0], p[1] - 0.01 * forward[1], p[2]],
  };
  const look = (name) => {
    camera.position.set(...places[name]);
    const to = name === "rig" ? p.map((v, k) => v + 0.02 * model.far * forward[k]) : name === "top" ? middle : look_at;
    controls.target.set(...to);
    controls.update();
    draw();
  };
  const turn = (about, up) => {
    const offset = camera.position.clone().sub(controls.target), r = offset.length();
    let azimuth = Math.atan2(offset.y, offset.x) + about;
    const polar = Math.min(Math.PI - 0.05, Math.max(0.05, Math.acos(offset.z / r) + up));
    offset.set(r * Math.sin(polar) * Math.cos(azimuth), r * Math.sin(polar) * Math.sin(azimuth), r * Math.cos(polar));
    camera.position.copy(controls.target).add(offset);
    controls.update();
    draw();
  };
  const nearer = (factor) => {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    draw();
  };
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (turns[event.key]) turn(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") nearer(0.85);
    else if (event.key === "-") nearer(1 / 0.85);
    else if (event.key === "0") look("reset");
    else return;
    event.preventDefault();
  });
  for (const button of document.querySelectorAll("[data-look]"))
    button.addEventListener("click", () => look(button.dataset.look));
  for (const button of document.querySelectorAll("[data-part]")) {
    const part = groups[button.dataset.part];
    if (!part) { button.hidden = true; continue; }
    button.setAttribute("aria-pressed", String(part.visible));
    button.addEventListener("click", () => {
      part.visible = !part.visible;
      button.setAttribute("aria-pressed", String(part.visible));
      draw();
    });
  }
  new ResizeObserver(() => {
    const { clientWidth: w, clientHeight: h } = canvas;
    if (!w || !h) return;
    renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
    renderer.setSize(w, h, false);
    camera.aspect = w / h;
    camera.fov = w < h * 1.3 ? 60 : 45;
    camera.updateProjectionMatrix();
    draw();
  }).observe(canvas);
  look("reset");
  canvas.dataset.drawn = "true";
})();
