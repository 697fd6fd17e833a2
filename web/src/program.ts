// Makes programs of WebGL2 from the texts of two shaders.
import { Problem } from "./problem.js";

/** Compiles and links two shaders. If this fails, it throws a Problem with the driver's message. */
export function link(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Problem(`WebGL2 does not draw: ${gl.getProgramInfoLog(program)}`, "Use another browser.", false);
  return program;
}
