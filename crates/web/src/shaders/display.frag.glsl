DECLARE_LAYERS
uniform sampler2DArray emission;
uniform sampler2D taps_x;
uniform sampler2D taps_y;
uniform ivec2 slots;      // first drawn slice, number of drawn slices
uniform ivec4 places;     // points per axis of the pupil; table rows per part; parts along x, y
uniform float on_disc[81];
uniform ivec2 lenslets;   // columns, rows
uniform float gain;
uniform float black;
uniform bool dropped;     // rays that miss a layer are left out
uniform int rows;
out vec4 colour;

#if FORMATION == 0
#define NEUTRAL 1.0
#define JOIN *=
#else
#define NEUTRAL 0.0
#define JOIN +=
#endif

vec3 read(sampler2DArray layer, vec4 x, vec4 y, int slice) {
    vec3 top = texelFetch(layer, ivec3(int(x.x), int(y.x), slice), 0).rgb;
    if (x.z == 0.0 && y.z == 0.0) return top;
    vec3 right = texelFetch(layer, ivec3(int(x.y), int(y.x), slice), 0).rgb;
    vec3 below = texelFetch(layer, ivec3(int(x.x), int(y.y), slice), 0).rgb;
    vec3 across = texelFetch(layer, ivec3(int(x.y), int(y.y), slice), 0).rgb;
    return mix(mix(top, right, x.z), mix(below, across, x.z), y.z);
}

#define MEET(N, LAYER) \
    if (x[N].x < 0.0 || y[N].x < 0.0) { counts = counts && !dropped; } \
    else { met JOIN black + (1.0 - black) * read(LAYER, x[N], y[N], slice); }

// rgb: light of a pixel's part times the part's area; a: the area. 0 if the part's ray is left out.
vec4 part_of(ivec2 at, ivec2 table) {
    // where the ray hits, alike in all frames
    vec4 x[LAYERS + DIRECTIONAL], y[LAYERS + DIRECTIONAL];
    for (int n = 0; n < LAYERS + DIRECTIONAL; n++) {
        x[n] = texelFetch(taps_x, ivec2(at.x, table.x + n), 0);
        y[n] = texelFetch(taps_y, ivec2(at.y, table.y + n), 0);
    }
    float share = x[0].w * y[0].w;
    if (share == 0.0) return vec4(0.0);
    vec3 sum = vec3(0.0);
    bool counts = true;
    for (int m = 0; m < slots.y; m++) {
        int slice = slots.x + m;
        vec3 met = vec3(NEUTRAL);
        MEET_LAYERS
#if FORMATION == 2
        vec3 turned = sin(1.5707963267948966 * met);
        met = turned * turned;
#endif
#if DIRECTIONAL
        vec4 across = x[LAYERS], down = y[LAYERS];
        counts = counts && across.x > -1.5 && down.x > -1.5;
        vec3 lit = vec3(0.0);
        if (across.x >= 0.0 && down.x >= 0.0) {
            ivec2 texel = ivec2(across.y, down.y) * lenslets + ivec2(across.x, down.x);
            lit = texelFetch(emission, ivec3(texel, slice), 0).rgb;
        }
#if FORMATION == 1
        met += lit;
#else
        met *= lit;
#endif
#endif
        sum += met;
    }
    return counts && slots.y > 0 ? share * vec4(sum / float(slots.y), 1.0) : vec4(0.0);
}

// Mean light of a pixel, seen from a point of the pupil.
vec3 seen(ivec2 at, ivec2 place) {
    vec4 sum = vec4(0.0);
    for (int j = 0; j < places.w; j++) {
        for (int i = 0; i < places.z; i++) {
            sum += part_of(at, (place * places.zw + ivec2(i, j)) * places.y);
        }
    }
    return sum.a > 0.0 ? sum.rgb / sum.a : vec3(0.0);
}

void main() {
    // the tables count rows from the top
    ivec2 at = ivec2(gl_FragCoord.x, rows - 1 - int(gl_FragCoord.y));
    vec3 sum = vec3(0.0);
    float count = 0.0;
    for (int j = 0; j < places.x; j++) {
        for (int i = 0; i < places.x; i++) {
            if (on_disc[j * places.x + i] > 0.0) {
                sum += seen(at, ivec2(i, j));
                count += 1.0;
            }
        }
    }
    colour = vec4(srgb_encode(gain * sum / count), 1.0);
}
