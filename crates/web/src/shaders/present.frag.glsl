uniform sampler2D left;
uniform sampler2D right;
uniform vec4 area;        // of the canvas, pixels from the bottom left: x, y, width, height
uniform float split;
out vec4 colour;

vec3 average(sampler2D picture, vec2 place) {
    vec2 size = vec2(textureSize(picture, 0));
    vec2 per_pixel = size / area.zw;
    ivec2 most = textureSize(picture, 0) - 1;
    if (per_pixel.x <= 1.0 && per_pixel.y <= 1.0) {
        return texelFetch(picture, clamp(ivec2(place * size), ivec2(0), most), 0).rgb;
    }
    ivec2 count = ivec2(clamp(ceil(per_pixel), 1.0, 8.0));
    vec3 sum = vec3(0.0);
    for (int j = 0; j < count.y; j++) {
        for (int i = 0; i < count.x; i++) {
            vec2 within = (vec2(i, j) + 0.5) / vec2(count) - 0.5;
            ivec2 texel = clamp(ivec2(place * size + within * per_pixel), ivec2(0), most);
            sum += srgb_decode(texelFetch(picture, texel, 0).rgb);
        }
    }
    return srgb_encode(sum / float(count.x * count.y));
}

void main() {
    vec2 place = (gl_FragCoord.xy - area.xy) / area.zw;
    place.y = 1.0 - place.y;
    colour = vec4(place.x < split ? average(left, place) : average(right, place), 1.0);
}
