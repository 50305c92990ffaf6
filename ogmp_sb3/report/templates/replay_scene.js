// Draws a robot, its ghost, the ground, the oracle's plan and the bound with WebGL 2. World: x forward, z up, metres.
// A pose is a position and a quaternion wxyz, 7 numbers; a matrix is 16 numbers, column by column.

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
uniform mat4 model, camera, light;
out vec3 world, across, lit;
void main() {
  vec4 place = model * vec4(position, 1.0);
  world = place.xyz;
  across = mat3(model) * normal;
  lit = (light * place).xyz * 0.5 + 0.5;
  gl_Position = camera * place;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 world, across, lit;
uniform vec4 colour;
uniform vec3 eye, sun;
uniform float brightness;
uniform int kind;  // 0: solid, 1: ground, 2: ghost, 3: bound
uniform sampler2DShadow shade;
out vec4 pixel;
const vec2 FOG = vec2(7.0, 17.0);  // m from the camera: where the ground begins to fade, and is gone
const vec2 LINE = vec2(0.5, 0.006);  // m between lines across the ground, and half their width
float sunlight() {
  if (any(lessThan(lit, vec3(0.0))) || any(greaterThan(lit, vec3(1.0)))) return 1.0;
  float sum = 0.0;
  for (int i = 0; i < 9; i++) {
    sum += texture(shade, vec3(lit.xy + vec2(i % 3 - 1, i / 3 - 1) / 1400.0, lit.z - 0.0015));
  }
  return sum / 9.0;
}
void main() {
  vec3 n = normalize(across), towards = normalize(eye - world);
  if (!gl_FrontFacing) n = -n;
  float rim = pow(1.0 - abs(dot(n, towards)), 2.0), alpha = colour.a;
  if (kind >= 2) {
    alpha *= kind == 2 ? mix(0.55, 2.6, rim) : 1.0;
    vec3 flat_colour = kind == 2 ? mix(colour.rgb, vec3(1.0), 0.12 * n.z) : colour.rgb;
    pixel = vec4(flat_colour, 1.0) * min(alpha, 1.0);
    return;
  }
  float sunny = max(dot(n, sun), 0.0) * sunlight();
  vec3 sky = mix(vec3(0.50, 0.48, 0.46), vec3(0.62, 0.65, 0.70), 0.5 + 0.5 * n.z);
  vec3 seen = colour.rgb * brightness * (sky + vec3(0.62, 0.58, 0.52) * sunny);
  if (kind == 0) {
    float shine = pow(max(dot(reflect(-sun, n), towards), 0.0), 24.0);
    seen += 0.12 * brightness * shine + 0.05 * rim;
  } else {
    float off = abs(fract(world.x / LINE.x + 0.5) - 0.5) * LINE.x, soft = 0.0014 * distance(eye, world);
    float line = n.z > 0.9 ? 1.0 - smoothstep(LINE.y, LINE.y + soft, off) : 0.0;
    seen *= 1.0 - 0.24 * line / (1.0 + 40.0 * soft);
    alpha = 1.0 - smoothstep(FOG.x, FOG.y, distance(eye, world));
  }
  pixel = vec4(min(seen, 1.0), 1.0) * alpha;
}`;

const SHADE_VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
uniform mat4 model, camera;
void main() { gl_Position = camera * model * vec4(position, 1.0); }`;

const SHADE_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;

const SOLID = 0, GROUND = 1, GHOST = 2, BOUND = 3;
const SUN = unit([-0.42, -0.46, 0.9]);
const SHADE_SIZE = 1024, SHADE_REACH = 3.4;  // texels, heights of the robot's base around it in which shadows fall
const FIELD = 0.66;  // rad: the vertical field of view
const CREASE = Math.cos(0.6);  // faces that meet at less than 0.6 rad are shaded as one
const GHOST_ALPHA = 0.2, ALONE_ALPHA = 0.6, BOUND_ALPHA = 0.17, DOT = 0.011;  // m: radius of the knots of the plan
const INSIDE = [0.2, 0.67, 0.35], OUTSIDE = [0.86, 0.2, 0.16];

class Scene {
  // recording: what replay_page.js has read; throws where there is no WebGL 2
  constructor(canvas, recording) {
    const gl = canvas.getContext("webgl2", {antialias: true, alpha: true, premultipliedAlpha: true});
    if (!gl) throw new Error("no WebGL 2");
    this.canvas = canvas;
    this.gl = gl;
    this.program = program(gl, VERTEX, FRAGMENT);
    this.shadeProgram = program(gl, SHADE_VERTEX, SHADE_FRAGMENT);
    const {robot, ghost, bound, box, dot, ghostColour} = recording;
    const meshes = robot.meshes.map((mesh) => this.mesh(mesh.vertices, mesh.faces));
    this.geoms = robot.geoms.map((geom) => (
      {body: geom.body, mesh: meshes[geom.mesh], place: matrix(geom.pose), colour: [...geom.colour, 1]}
    ));
    this.ghostBodies = matrices(ghost);
    this.ghostColour = ghostColour;
    this.bound = bound && this.mesh(bound.vertices, bound.faces);
    this.reach = SHADE_REACH * robot.height;
    this.box = this.mesh(box.vertices, box.faces);
    this.dot = this.mesh(dot.vertices, dot.faces);
    this.makeShade();
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.polygonOffset(1, 2);
  }

  // Draws one moment.
  // moment: robot (poses of the bodies, or null), ghost (pose of its base), plan (points), ground, inside (the bound)
  // view: eye, target, brightness, show (ghost, plan, bound)
  draw(moment, view) {
    const gl = this.gl, canvas = this.canvas;
    const bodies = moment.robot && matrices(moment.robot);
    const base = matrix(moment.ghost), ghost = this.ghostBodies.map((body) => multiply(base, body));
    const ground = moment.ground.map((box) => scaled(box.centre, box.half));
    const light = lightMatrix(view.target, this.reach);

    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadeBuffer);
    gl.viewport(0, 0, SHADE_SIZE, SHADE_SIZE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.shadeProgram.program);
    this.at = this.shadeProgram.at;
    gl.uniformMatrix4fv(this.at.camera, false, light);
    this.drawBodies(bodies ?? ghost);
    for (const place of ground) this.drawMesh(this.box, place);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program.program);
    this.at = this.program.at;
    gl.uniformMatrix4fv(this.at.camera, false, cameraMatrix(view.eye, view.target, canvas.width / canvas.height));
    gl.uniformMatrix4fv(this.at.light, false, light);
    gl.uniform3fv(this.at.eye, view.eye);
    gl.uniform3fv(this.at.sun, SUN);
    gl.uniform1f(this.at.brightness, 1);
    if (bodies) this.drawBodies(bodies, SOLID);
    if (view.show.plan) {
      for (let i = 0; i < moment.plan.length; i += 3) {
        const place = scaled(moment.plan.subarray(i, i + 3), [DOT, DOT, DOT]);
        this.drawMesh(this.dot, place, SOLID, [...this.ghostColour, 1]);
      }
    }
    gl.enable(gl.BLEND);
    gl.uniform1f(this.at.brightness, view.brightness);
    gl.enable(gl.CULL_FACE);  // or the edges of a box would shine through another whose top is as high
    moment.ground.forEach((box, i) => this.drawMesh(this.box, ground[i], GROUND, [...box.colour, 1]));
    gl.disable(gl.CULL_FACE);
    if (this.bound && view.show.bound) {
      gl.depthMask(false);
      const place = matrix([...moment.ghost.slice(0, 3), 1, 0, 0, 0]);
      this.drawMesh(this.bound, place, BOUND, [...(moment.inside ? INSIDE : OUTSIDE), BOUND_ALPHA]);
      gl.depthMask(true);
    }
    if (!bodies) this.drawGhost(ghost, ALONE_ALPHA);
    else if (view.show.ghost) this.drawGhost(ghost, GHOST_ALPHA);
    gl.disable(gl.BLEND);
  }

  // Only the nearest surface of the ghost is seen, and where it coincides with the robot's, the robot's is.
  drawGhost(ghost, alpha) {
    const gl = this.gl, colour = [...this.ghostColour, alpha];
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.colorMask(false, false, false, false);
    this.drawBodies(ghost, GHOST, colour);
    gl.colorMask(true, true, true, true);
    gl.depthFunc(gl.LEQUAL);
    this.drawBodies(ghost, GHOST, colour);
    gl.depthFunc(gl.LESS);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  drawBodies(bodies, kind, colour) {
    for (const geom of this.geoms) {
      this.drawMesh(geom.mesh, multiply(bodies[geom.body], geom.place), kind, colour ?? geom.colour);
    }
  }

  drawMesh(mesh, place, kind, colour) {
    const gl = this.gl, at = this.at;
    gl.uniformMatrix4fv(at.model, false, place);
    if (at.colour) {
      gl.uniform1i(at.kind, kind);
      gl.uniform4fv(at.colour, colour);
    }
    gl.bindVertexArray(mesh.corners);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
  }

  // Uploads triangles with the normals of their corners.
  mesh(vertices, faces) {
    const gl = this.gl, corners = gl.createVertexArray();
    gl.bindVertexArray(corners);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, withNormals(vertices, faces), gl.STATIC_DRAW);
    for (const place of [0, 1]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, 12 * place);
    }
    return {corners, count: faces.length};
  }

  makeShade() {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADE_SIZE, SHADE_SIZE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    this.shadeBuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadeBuffer);
    const texture = gl.getParameter(gl.TEXTURE_BINDING_2D);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
    gl.drawBuffers([gl.NONE]);
  }
}

function program(gl, vertex, fragment) {
  const linked = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(linked, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(linked);
  if (!gl.getProgramParameter(linked, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(linked));
  const at = {};
  for (let i = 0; i < gl.getProgramParameter(linked, gl.ACTIVE_UNIFORMS); i++) {
    const {name} = gl.getActiveUniform(linked, i);
    at[name] = gl.getUniformLocation(linked, name);
  }
  return {program: linked, at};
}

// Corners of triangles as position and normal. A normal is the mean of those faces around that meet without a crease.
function withNormals(vertices, faces) {
  const count = faces.length / 3, normals = new Float64Array(faces.length), unitNormals = new Float64Array(faces.length);
  const first = new Uint32Array(vertices.length / 3 + 1);
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => vertices.subarray(3 * faces[3 * f + k], 3 * faces[3 * f + k] + 3));
    const n = cross(minus(b, a), minus(c, a));
    normals.set(n, 3 * f);
    unitNormals.set(unit(n), 3 * f);
  }
  for (const vertex of faces) first[vertex + 1]++;
  for (let v = 1; v < first.length; v++) first[v] += first[v - 1];
  const around = new Uint32Array(faces.length), next = first.slice();
  for (let i = 0; i < faces.length; i++) around[next[faces[i]]++] = Math.floor(i / 3);
  const corners = new Float32Array(6 * faces.length);
  for (let i = 0; i < faces.length; i++) {
    const vertex = faces[i], own = 3 * Math.floor(i / 3), sum = [0, 0, 0];
    for (let k = first[vertex]; k < first[vertex + 1]; k++) {
      const other = 3 * around[k];
      let cosine = 0;
      for (let j = 0; j < 3; j++) cosine += unitNormals[own + j] * unitNormals[other + j];
      if (cosine > CREASE) for (let j = 0; j < 3; j++) sum[j] += normals[other + j];
    }
    corners.set(vertices.subarray(3 * vertex, 3 * vertex + 3), 6 * i);
    corners.set(unit(sum), 6 * i + 3);
  }
  return corners;
}

function minus(a, b) { return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]; }
function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function unit(a) {
  const length = Math.hypot(a[0], a[1], a[2]) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
}

function matrix([px, py, pz, w, x, y, z]) {
  return Float32Array.of(
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    px, py, pz, 1,
  );
}
function matrices(poses) {
  return Array.from({length: poses.length / 7}, (_, i) => matrix(poses.subarray(7 * i, 7 * i + 7)));
}
function scaled([px, py, pz], [sx, sy, sz]) {
  return Float32Array.of(sx, 0, 0, 0, 0, sy, 0, 0, 0, 0, sz, 0, px, py, pz, 1);
}
function multiply(a, b) {
  const product = new Float32Array(16);
  for (let column = 0; column < 16; column += 4) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) product[column + row] += a[4 * k + row] * b[column + k];
    }
  }
  return product;
}
function lookAt(eye, target) {
  const back = unit(minus(eye, target)), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
  return Float32Array.of(
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
  );
}
function cameraMatrix(eye, target, aspect) {
  const near = 0.05, far = 60, scale = 1 / Math.tan(FIELD / 2);
  const projection = Float32Array.of(
    scale / aspect, 0, 0, 0, 0, scale, 0, 0,
    0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0,
  );
  return multiply(projection, lookAt(eye, target));
}
function lightMatrix(target, reach) {
  const away = 3.5 * reach, eye = target.map((value, i) => value + away * SUN[i]), near = 0.5 * reach, far = 6.5 * reach;
  const r = 1 / reach, d = 1 / (near - far);
  const projection = Float32Array.of(r, 0, 0, 0, 0, r, 0, 0, 0, 0, 2 * d, 0, 0, 0, (far + near) * d, 1);
  return multiply(projection, lookAt(eye, target));
}
