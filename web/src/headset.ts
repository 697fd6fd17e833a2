// Shows the display in a headset, in its true size. Each eye sees the picture for its own position.
import type { Views } from "./others.js";
import { Problem, problemOf } from "./problem.js";
import { link } from "./program.js";
import type { Slope } from "./state.js";

/** Smallest distance from the head to the display, for patterns of parallel views, metres. */
const AWAY_M = 0.7;
/** Smallest distance of an eye from the display at which a picture is drawn, mm. */
const NEAREST_MM = 30;
/** Largest change of an eye's slope that needs no new picture: about a hundredth of a degree. */
const STILL = 2e-4;

const VERTEX = `#version 300 es
uniform mat4 place; uniform vec2 extent; out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  at = vec2(corner.x, 1.0 - corner.y);
  gl_Position = place * vec4((corner - 0.5) * extent, 0.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D picture; in vec2 at; out vec4 colour;
void main() { colour = vec4(texture(picture, at).rgb, 1.0); }`;

/** The newest picture for one eye, and the position for which it was computed. */
interface Eye {
  texture: WebGLTexture;
  slope: Slope;
  distanceMm: number;
  /** True if the texture contains a picture. */
  ready: boolean;
  /** True while a new picture is computed. */
  waits: boolean;
}

/** Position of the display in the room: its centre in metres, and its rotation about the vertical. */
interface Place {
  centre: readonly [number, number, number];
  sine: number;
  cosine: number;
}

/** Opens a session. The promise resolves when the session has ended. */
export async function enter(views: Views): Promise<void> {
  const xr = navigator.xr!;
  // In mixed reality the display stands in the user's own room.
  const mode: XRSessionMode = (await xr.isSessionSupported("immersive-ar")) ? "immersive-ar" : "immersive-vr";
  const gl = document.createElement("canvas").getContext("webgl2", { xrCompatible: true });
  if (!gl) throw new Problem("The headset needs WebGL2, which this browser does not have.", "Use another browser.", false);
  let session: XRSession;
  try {
    session = await xr.requestSession(mode);
  } catch (error) {
    throw new Problem(`The headset did not start: ${problemOf(error, "").message}`, "Check that the headset is connected, and that this page may use the headset.", false);
  }
  try {
    await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
    const room = await session.requestReferenceSpace("local");
    const ended = new Promise<void>((resolve) => session.addEventListener("end", () => resolve()));
    new Theatre(session, room, gl, views).start();
    await ended;
  } finally {
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    views.done();
  }
}

class Theatre {
  private readonly program: WebGLProgram;
  private readonly eyes = new Map<number, Eye>();
  private place: Place | undefined;

  constructor(
    private readonly session: XRSession,
    private readonly room: XRReferenceSpace,
    private readonly gl: WebGL2RenderingContext,
    private readonly views: Views,
  ) {
    this.program = link(gl, VERTEX, FRAGMENT);
    // The trigger of a controller places the display in front of the user again.
    session.addEventListener("select", () => (this.place = undefined));
  }

  start(): void {
    this.session.requestAnimationFrame((_, frame) => this.frame(frame));
  }

  private frame(frame: XRFrame): void {
    this.start();
    const pose = frame.getViewerPose(this.room);
    if (!pose) return;
    this.place ??= before(pose.transform, this.awayM);
    const { gl, session } = this;
    const layer = session.renderState.baseLayer!;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0, 0, 0, session.environmentBlendMode === "opaque" ? 1 : 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    for (const [index, view] of pose.views.entries()) {
      const { x, y, width, height } = layer.getViewport(view)!;
      gl.viewport(x, y, width, height);
      this.draw(this.eye(index), view, this.place);
    }
  }

  private get awayM(): number {
    const { distance_mm, width_mm } = { ...this.views.info.views, ...this.views.info.field };
    return distance_mm === undefined ? Math.max(AWAY_M, (1.5 * width_mm) / 1000) : distance_mm / 1000;
  }

  private draw(eye: Eye, view: XRView, place: Place): void {
    const [right, up, distanceMm] = inDisplay(view.transform.position, place);
    if (distanceMm < NEAREST_MM) return;
    this.update(eye, [right / distanceMm, up / distanceMm], distanceMm);
    if (!eye.ready) return;
    const { gl, program } = this;
    const { width_mm, height_mm } = this.views.info.field;
    const toView = times(view.transform.inverse.matrix, matrixOf(place));
    gl.useProgram(program);
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "place"), false, times(view.projectionMatrix, toView));
    gl.uniform2f(gl.getUniformLocation(program, "extent"), width_mm / 1000, height_mm / 1000);
    gl.bindTexture(gl.TEXTURE_2D, eye.texture);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /**
   * Requests a picture for an eye that has moved. Until the new picture arrives, the display shows
   * the previous picture, at the display's current place.
   */
  private update(eye: Eye, slope: Slope, distanceMm: number): void {
    const moved = Math.hypot(slope[0] - eye.slope[0], slope[1] - eye.slope[1]) > STILL || Math.abs(distanceMm - eye.distanceMm) > 1;
    if (eye.waits || (eye.ready && !moved)) return;
    Object.assign(eye, { waits: true, slope, distanceMm });
    const { gl } = this;
    void this.views
      .picture(slope, distanceMm)
      .then((picture) => {
        gl.bindTexture(gl.TEXTURE_2D, eye.texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
        picture.close();
        eye.ready = true;
      })
      .finally(() => (eye.waits = false))
      .catch(() => this.session.end());
  }

  private eye(index: number): Eye {
    let eye = this.eyes.get(index);
    if (!eye) {
      const { gl } = this;
      eye = { texture: gl.createTexture(), slope: [0, 0], distanceMm: 0, ready: false, waits: false };
      gl.bindTexture(gl.TEXTURE_2D, eye.texture);
      for (const [key, value] of [
        [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
        [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
        [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
        [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      ] as const)
        gl.texParameteri(gl.TEXTURE_2D, key, value);
      this.eyes.set(index, eye);
    }
    return eye;
  }
}

/** Returns a place in front of a head, upright and at the height of the head. */
function before({ matrix, position }: XRRigidTransform, awayM: number): Place {
  // The third column of the head's matrix points backwards.
  const [x, z] = [matrix[8]!, matrix[10]!];
  const length = Math.hypot(x, z) || 1;
  const [sine, cosine] = [x / length, z / length];
  return { centre: [position.x - sine * awayM, position.y, position.z - cosine * awayM], sine, cosine };
}

/** Converts a point of the room to the display's coordinates: right, up and towards the viewer, mm. */
function inDisplay({ x, y, z }: DOMPointReadOnly, { centre, sine, cosine }: Place): [number, number, number] {
  const [dx, dy, dz] = [x - centre[0], y - centre[1], z - centre[2]];
  return [1000 * (cosine * dx - sine * dz), 1000 * dy, 1000 * (sine * dx + cosine * dz)];
}

/** Returns the matrix from the display's coordinates, in metres, to the room, column by column. */
function matrixOf({ centre, sine, cosine }: Place): Float32Array {
  return Float32Array.of(cosine, 0, -sine, 0, 0, 1, 0, 0, sine, 0, cosine, 0, ...centre, 1);
}

function times(a: Float32Array, b: Float32Array): Float32Array {
  return Float32Array.from({ length: 16 }, (_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[(i % 4) + 4 * k]! * b[4 * Math.floor(i / 4) + k]!, 0));
}
