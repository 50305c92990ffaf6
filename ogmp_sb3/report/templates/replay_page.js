// Plays a recording: clock, controls, camera, and charts in step with the scene.

const DATA = JSON.parse(document.getElementById("data").textContent);
const TYPES = {float32: Float32Array, uint16: Uint16Array, uint32: Uint32Array};
const REST = 1.0;  // s at the end of an episode, before it begins anew
const SETTLE = 0.25;  // s over which the camera follows the robot's height and sideways motion
const AZIMUTH = 1.85, ELEVATION = 0.28;  // rad: where the camera begins,
const DISTANCE = 6.2, AIM = [0.3, 0, -0.2];  // heights of the robot's base: and how far, and the middle from the base
const NARROW = 1.0;  // width over height of a scene, below which the camera steps back
const find = (id) => document.getElementById(id);

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

function complain(text) {
  find("no-scene").hidden = false;
  find("no-scene").textContent = text;
}

class Replay {
  constructor(buffer) {
    const array = (number) => {
      const {start, type, shape} = DATA.arrays[number];
      return new TYPES[type](buffer, start, shape.reduce((product, length) => product * length, 1));
    };
    const mesh = ({vertices, faces}) => ({vertices: array(vertices), faces: array(faces)});
    this.recording = {
      robot: {...DATA.robot, meshes: DATA.robot.meshes.map(mesh)},
      ghost: array(DATA.ghost),
      ghostColour: DATA.ghost_colour,
      bound: DATA.bound && mesh(DATA.bound),
      box: mesh(DATA.box),
      dot: mesh(DATA.dot),
    };
    this.episodes = DATA.episodes.map((episode) => ({
      ...episode,
      robot: episode.robot === null ? null : array(episode.robot),
      ghost: array(episode.ghost),
      base: array(episode.base),
      speed: array(episode.speed),
      deviation: array(episode.deviation),
      plan: array(episode.plan),
      plans: episode.plans.map(array),
      charts: episode.charts.map(array),
      target: smooth(array(episode.base)),
      duration: (episode.steps - 1) * DATA.control_dt,
    }));
    const names = [...new Set(DATA.episodes.flatMap((episode) => episode.modes.map((mode) => mode.name)))];
    this.modeColours = Object.fromEntries(names.map((name, i) => [name, `var(--mode-${i % 6})`]));
    this.rate = 1;
    const {height} = DATA.robot;
    this.aim = AIM.map((value) => value * height);
    this.camera = {azimuth: AZIMUTH, elevation: ELEVATION, distance: DISTANCE * height, shift: [0, 0, 0]};
    this.show = {ghost: true, plan: true, bound: true};
    this.follow = true;
    this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.makeScene();
    find("scene").addEventListener("webglcontextlost", (event) => event.preventDefault());  // as on a phone that slept
    find("scene").addEventListener("webglcontextrestored", () => { this.makeScene(); this.layOut(); });
    this.charts = DATA.charts.map((chart) => new ChartView(chart));
    this.addControls();
    addCamera(find("scene"), this.camera);
    this.choose(0);
    const watcher = new ResizeObserver(() => this.layOut());
    watcher.observe(find("view"));
    watcher.observe(find("charts"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layOut());
    this.goToLink();
    addEventListener("hashchange", () => this.goToLink());
    this.last = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  makeScene() {
    try {
      this.scene = new Scene(find("scene"), this.recording);
    } catch (error) {
      complain(`This browser cannot draw the scene (${error.message}); the charts play without it.`);
    }
  }

  // A link to a moment: #2@1.5 is the second episode, held at 1.5 s.
  goToLink() {
    const link = location.hash.match(/^#(\d+)(?:@([\d.]+))?$/);
    if (!link || !this.episodes[link[1] - 1]) return;
    this.choose(link[1] - 1);
    if (link[2]) {
      this.time = Math.min(Number(link[2]), this.episode.duration);
      this.playing = false;
    }
  }

  choose(number) {
    this.episode = this.episodes[number];
    this.time = 0;
    const duration = this.episode.duration;
    find("scrub").max = duration;
    find("detail").textContent = this.episode.detail;
    for (const [i, tab] of [...find("episodes").children].entries()) tab.setAttribute("aria-selected", i === number);
    const modes = this.episode.modes.map((mode, i) => {
      const end = this.episode.modes[i + 1]?.start ?? this.episode.steps - 1;
      const from = mode.start * DATA.control_dt, to = end * DATA.control_dt;
      return {...mode, steps: end - mode.start, from, to, colour: this.modeColours[mode.name]};
    });
    this.modes = modes;
    find("modes").replaceChildren(...modes.map((mode) => {
      const part = document.createElement("span");
      part.style.cssText = `flex: ${mode.steps} 0 0; background: ${mode.colour}`;
      part.textContent = mode.name;
      part.title = mode.text;
      part.addEventListener("click", () => { this.time = mode.from; });
      return part;
    }));
    this.charts.forEach((chart, i) => chart.open(this.episode, this.episode.charts[i], modes));
  }

  tick(now) {
    const passed = Math.min(Math.max((now - this.last) / 1000, 0), 0.1);  // the first frame may be of before the start
    this.last = now;
    if (this.playing && !this.held) {
      this.time += passed * this.rate;
      if (this.time > this.episode.duration + REST * this.rate) this.time = 0;
    }
    this.drawMoment();
    requestAnimationFrame((later) => this.tick(later));
  }

  drawMoment() {
    const {episode, camera, show, follow, playing} = this, time = Math.min(this.time, episode.duration);
    const drawn = JSON.stringify([episode.name, time, camera, show, follow, playing]);
    if (drawn === this.drawn) return;  // a page at rest costs nothing
    this.drawn = drawn;
    const steps = time / DATA.control_dt;
    const step = Math.min(Math.floor(steps + 1e-9), episode.steps - 1), next = Math.min(step + 1, episode.steps - 1);
    const share = Math.min(Math.max(steps - step, 0), 1);
    const target = between(episode.target, 3, step, next, share);
    if (this.scene) {
      const moment = {
        robot: episode.robot && posesBetween(episode.robot, 7 * DATA.robot.bodies, step, next, share),
        ghost: posesBetween(episode.ghost, 7, step, next, share),
        plan: episode.plans[episode.plan[step]],
        ground: episode.ground,
        inside: DATA.rho === null || episode.deviation[step] <= DATA.rho,
      };
      if (follow || !this.target) this.target = target;
      const at = this.target.map((value, i) => value + this.aim[i] + camera.shift[i]);
      const eye = eyeOf(camera, at, this.scene.canvas.width / this.scene.canvas.height);
      this.scene.draw(moment, {eye, target: at, brightness: this.brightness, show});
    }
    const mode = this.modes.findLast((part) => part.start <= step);
    find("mode").textContent = mode.text;
    find("mode").style.setProperty("--own", mode.colour);
    find("figures").textContent = `x ${fixed(episode.base[3 * step], 1)} m  ·  ${episode.speed[step].toFixed(2)} m/s`;
    find("time").textContent = `${time.toFixed(2)} s`;
    find("ended").textContent = step === episode.steps - 1 ? episode.ended : "";
    find("ended").classList.toggle("fell", episode.fell);
    if (!this.held) find("scrub").value = time;
    find("play").setAttribute("aria-pressed", this.playing);
    find("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    this.charts.forEach((chart) => chart.point(step, time));
  }

  // Brings everything to the size and the colours that it has now.
  layOut() {
    const scale = Math.min(devicePixelRatio, 2), canvas = find("scene");
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * scale));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * scale));
    this.brightness = Number(getComputedStyle(document.documentElement).getPropertyValue("--brightness"));
    this.charts.forEach((chart) => chart.draw());
    this.drawn = null;
    this.drawMoment();
  }

  addControls() {
    const scrub = find("scrub");
    const toggle = () => {
      if (!this.playing && this.time >= this.episode.duration) this.time = 0;
      this.playing = !this.playing;
    };
    const seek = (time) => {
      this.time = Math.min(Math.max(time, 0), this.episode.duration);
    };
    find("play").addEventListener("click", toggle);
    scrub.addEventListener("input", () => { this.held = true; seek(Number(scrub.value)); });
    scrub.addEventListener("change", () => { this.held = false; });
    find("rate").addEventListener("change", (event) => { this.rate = Number(event.target.value); });
    for (const name of ["ghost", "plan", "bound"]) {
      find(name).addEventListener("change", (event) => { this.show[name] = event.target.checked; });
    }
    find("bound").parentElement.hidden = DATA.bound === null;
    find("ghost").parentElement.hidden = this.episodes.every((episode) => episode.robot === null);
    find("follow").addEventListener("change", (event) => { this.follow = event.target.checked; });
    for (const [i, tab] of [...find("episodes").children].entries()) {
      tab.addEventListener("click", () => { this.choose(i); this.playing = true; });
    }
    for (const chart of this.charts) chart.onSeek = seek;
    addEventListener("click", (event) => {  // by a pointer: the space bar is for the clock again
      if (event.detail > 0 && event.target.closest("button, #shown")) document.activeElement.blur();
    });
    addEventListener("keydown", (event) => {
      if (event.target.closest("button, select, input:not([type=range])") || event.ctrlKey || event.metaKey || event.altKey) return;
      const moves = {ArrowLeft: -DATA.control_dt, ArrowRight: DATA.control_dt};
      if (event.key === " ") toggle();
      else if (event.key in moves) { this.playing = false; seek(this.time + moves[event.key]); }
      else return;
      event.preventDefault();
    });
  }
}

class ChartView {
  constructor(chart) {
    this.lines = chart.lines;
    this.element = find("chart").content.firstElementChild.cloneNode(true);
    this.element.querySelector("figcaption b").textContent = chart.title;
    this.values = chart.lines.map((line) => {
      const entry = document.createElement("span");
      entry.className = `key ${line.style}`;
      entry.textContent = line.name;
      return entry.appendChild(document.createElement("output"));
    });
    const keys = this.values.map((value) => value.parentElement).reverse();
    this.element.querySelector(".keys").append(...keys);
    this.canvas = this.element.querySelector("canvas");
    this.cursor = this.element.querySelector(".cursor");
    const seek = (event) => {
      if (event.buttons & 1) this.onSeek(this.episode.duration * (event.offsetX - this.left) / this.width);
    };
    this.canvas.addEventListener("pointerdown", seek);
    this.canvas.addEventListener("pointermove", seek);
    find("charts").append(this.element);
  }

  open(episode, values, modes) {
    this.episode = episode;
    this.modes = modes;
    const steps = episode.steps;
    this.series = this.lines.map((_, i) => values.subarray(i * steps, (i + 1) * steps));
    this.draw();
  }

  // The whole episode; only the cursor moves while it plays.
  draw() {
    const {canvas, episode} = this, scale = devicePixelRatio, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!episode || !width) return;
    canvas.width = width * scale;
    canvas.height = height * scale;
    const style = getComputedStyle(this.element), colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    pen.font = `11px ${style.fontFamily}`;
    const seen = this.series.flatMap((line) => [...line].filter(Number.isFinite));
    const least = Math.min(...seen), span = Math.max(...seen) - least || 1;
    const low = least - 0.12 * span, high = least + 1.06 * span;
    this.left = 34;
    this.width = width - this.left - 6;
    const top = 6, bottom = height - 18;
    const x = (time) => this.left + this.width * time / episode.duration;
    const y = (value) => bottom - (bottom - top) * (value - low) / (high - low);
    for (const mode of this.modes) {
      pen.globalAlpha = 0.1;
      pen.fillStyle = colour(mode.colour.slice(6, -1));
      pen.fillRect(x(mode.from), top, x(mode.to) - x(mode.from), bottom - top);
    }
    pen.globalAlpha = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of ticksIn(low, high, 4)) {
      pen.fillStyle = colour("line");
      pen.fillRect(this.left, Math.round(y(value)), this.width, 1);
      pen.fillStyle = colour("soft");
      pen.fillText(String(value).replace("-", "−"), this.left - 5, y(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const second of ticksIn(0, episode.duration, 6)) {
      pen.fillText(second === 0 ? "0 s" : String(second), x(second), bottom + 4);
    }
    for (const [i, line] of this.lines.entries()) {
      pen.strokeStyle = pen.fillStyle = colour(line.style);
      if (line.style === "ground") {
        this.series[i].forEach((value, step) => {
          const from = x(step * DATA.control_dt), to = x(Math.min((step + 1) * DATA.control_dt, episode.duration));
          if (Number.isFinite(value)) pen.fillRect(Math.floor(from), y(value), Math.ceil(to) - Math.floor(from), bottom - y(value));
        });
        continue;
      }
      pen.lineWidth = line.style === "robot" ? 1.8 : 1.4;
      pen.setLineDash(line.style === "limit" ? [5, 4] : []);
      pen.lineJoin = "round";
      pen.beginPath();
      let gap = true;
      this.series[i].forEach((value, step) => {
        if (Number.isFinite(value)) pen[gap ? "moveTo" : "lineTo"](x(step * DATA.control_dt), y(value));
        gap = !Number.isFinite(value);
      });
      pen.stroke();
    }
    this.cursor.style.top = `${canvas.offsetTop + top}px`;
    this.cursor.style.height = `${bottom - top}px`;
  }

  point(step, time) {
    if (this.width === undefined) return;
    const place = this.canvas.offsetLeft + this.left + this.width * time / this.episode.duration;
    this.cursor.style.transform = `translateX(${place}px)`;
    this.values.forEach((output, i) => {
      const value = this.series[i][step];
      output.textContent = Number.isFinite(value) ? fixed(value, 2) : "–";
    });
  }
}

// A number as text, never "-0.0".
function fixed(value, digits) { return value.toFixed(digits).replace(/^-(0\.0*)$/, "$1").replace("-", "−"); }

// Round values in a range, about so many.
function ticksIn(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough - 1e-12);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({length: last - first + 1}, (_, i) => Number(((first + i) * step).toPrecision(6)));
}

// Where the camera looks: with the robot along the track, and smoothly after it otherwise, without lag.
function smooth(base) {
  const target = Float32Array.from(base), keep = Math.exp(-DATA.control_dt / SETTLE), count = base.length / 3;
  for (const axis of [0, 1, 2]) {
    const share = axis === 0 ? 0.6 : keep;
    for (let i = 1; i < count; i++) target[3 * i + axis] += share * (target[3 * i - 3 + axis] - target[3 * i + axis]);
    for (let i = count - 2; i >= 0; i--) target[3 * i + axis] += share * (target[3 * i + 3 + axis] - target[3 * i + axis]);
  }
  return target;
}

function between(values, size, step, next, share) {
  return Array.from({length: size}, (_, i) => (1 - share) * values[size * step + i] + share * values[size * next + i]);
}

// Poses on the way from one control step to the next; quaternions go the shorter way.
function posesBetween(poses, size, step, next, share) {
  const mixed = new Float32Array(size);
  for (let pose = 0; pose < size; pose += 7) {
    const a = size * step + pose, b = size * next + pose;
    let cosine = 0;
    for (let i = 3; i < 7; i++) cosine += poses[a + i] * poses[b + i];
    for (let i = 0; i < 7; i++) {
      mixed[pose + i] = (1 - share) * poses[a + i] + (i > 2 && cosine < 0 ? -share : share) * poses[b + i];
    }
    const length = Math.hypot(...mixed.subarray(pose + 3, pose + 7));
    for (let i = 3; i < 7; i++) mixed[pose + i] /= length;
  }
  return mixed;
}

function eyeOf({azimuth, elevation, distance}, target, aspect) {
  const away = distance * Math.max(1, NARROW / aspect), flat = away * Math.cos(elevation);
  return [
    target[0] - flat * Math.cos(azimuth), target[1] - flat * Math.sin(azimuth), target[2] + away * Math.sin(elevation),
  ];
}

// Drag turns the camera, two fingers or the wheel change its distance, two fingers or the right button shift it.
function addCamera(canvas, camera) {
  const fingers = new Map();
  const shift = (dx, dy) => {
    const size = camera.distance / canvas.clientHeight, {azimuth, elevation, shift: by} = camera;
    by[0] -= size * (dx * Math.sin(azimuth) - dy * Math.sin(elevation) * Math.cos(azimuth));
    by[1] += size * (dx * Math.cos(azimuth) + dy * Math.sin(elevation) * Math.sin(azimuth));
    by[2] += size * dy * Math.cos(elevation);
  };
  const zoom = (factor) => { camera.distance = Math.min(Math.max(camera.distance * factor, 0.6), 12); };
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { zoom(Math.exp(event.deltaY / 800)); event.preventDefault(); }, {passive: false});
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const dx = event.clientX - finger.x, dy = event.clientY - finger.y, before = fingers.size === 2 ? spread() : 0;
    Object.assign(finger, {x: event.clientX, y: event.clientY});
    if (fingers.size === 2) {
      zoom(before / spread());
      shift(dx / 2, dy / 2);
    } else if (event.buttons & 2) shift(dx, dy);
    else {
      camera.azimuth -= dx / 150;
      camera.elevation = Math.min(Math.max(camera.elevation + dy / 150, -0.2), 1.5);
    }
  });
}

unpacked(find("recording").textContent)
  .then((buffer) => new Replay(buffer))
  .catch((error) => complain(`This browser cannot read the recording (${error.message}).`));
