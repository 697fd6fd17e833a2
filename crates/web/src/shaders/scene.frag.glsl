uniform sampler2DArray layer;
uniform ivec2 slots;      // first frame slice, number of slices; none: the plain colour
uniform vec4 tint;
in vec2 uv;
out vec4 colour;
void main() {
    if (slots.y == 0) {
        colour = tint;
        return;
    }
    ivec2 size = textureSize(layer, 0).xy;
    ivec2 at = clamp(ivec2(uv * vec2(size)), ivec2(0), size - 1);
    vec3 sum = vec3(0.0);
    for (int m = 0; m < slots.y; m++) sum += texelFetch(layer, ivec3(at, slots.x + m), 0).rgb;
    vec2 edge = min(uv, 1.0 - uv) / max(fwidth(uv), vec2(1e-6));
    bool frame = min(edge.x, edge.y) < 1.5;
    colour = frame ? vec4(0.55, 0.62, 0.7, 1.0) : vec4(srgb_encode(sum / float(slots.y)), tint.a);
}
