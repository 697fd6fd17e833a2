#version 300 es
layout(location = 0) in vec4 clip;
layout(location = 1) in vec2 place;
out vec2 uv;
void main() {
    uv = place;
    gl_Position = clip;
}
